"""Batched closed-form Jacobian of a serial chain: the hot kernel of every physical model.

The chain is rewritten once so that each joint moves about or along its own z axis; what lies
between two joints is then a constant rotation and a constant offset, most of whose entries are
zero and cost nothing. Arrays are kept component by component ("structure of arrays") and the
samples are worked through in chunks that fit the cache; there is no loop over samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stiff_protocols.forward_kinematics import checked_positions
from stiff_protocols.types import FloatArray, Robot

CHUNK = 2048
"""Samples a pass: the working set of a six-joint chain then stays in a core's L2 cache."""


@dataclass(frozen=True)
class _Link:
    """What lies between one joint's z-aligned frame and the next one's."""

    rotation: FloatArray  # (3, 3)
    offset: FloatArray  # (3,) m
    prismatic: bool


def jacobian(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the geometric Jacobian at the TCP, base frame.

    Args:
        robot: the serial chain.
        q: (n, n_joints) joint positions, rad or m.

    Returns:
        (n, 6, n_joints): rows 0..2 translation [m/rad or m/m], rows 3..5 rotation.

    Raises:
        DataError: `q` has another number of joints than the robot.
    """
    q = checked_positions(robot, q)
    links, tool = _z_aligned(robot)
    columns = np.empty((6, robot.n_joints, len(q)))
    for start in range(0, len(q), CHUNK):
        part = slice(start, start + CHUNK)
        _fill(columns[:, :, part], links, tool, q[part].T)
    return columns.transpose(2, 0, 1)


def virtual_jacobian(robot: Robot, q: FloatArray) -> FloatArray:
    """Return how the TCP moves with six virtual joints at every joint, base frame.

    They turn about and slide along the axes x, y, z of the joint's moving frame, after the joint's
    own motion; z is the joint's axis. Where the axis lies along one of the URDF frame's, x and y
    do too; else they are any two across it.

    Args:
        robot: the serial chain.
        q: (n, n_joints) joint positions, rad or m.

    Returns:
        (n, 6, n_joints, 6): rows as of `jacobian`; the last index is the virtual joint: turns
        about x, y, z, then slides along x, y, z.

    Raises:
        DataError: `q` has another number of joints than the robot.
    """
    q = checked_positions(robot, q)
    links, tool = _z_aligned(robot)
    columns = np.zeros((6, robot.n_joints, 6, len(q)))
    for start in range(0, len(q), CHUNK):
        part = slice(start, start + CHUNK)
        _fill_virtual(columns[..., part], links, tool, q[part].T)
    return columns.transpose(3, 0, 1, 2)


def kinematic_hessian(rows: FloatArray) -> FloatArray:
    """Return the derivatives of a geometric Jacobian by the joint positions.

    A turn about axis a_i moves all that it carries: column j changes by a_i x J_j for j >= i, and
    the TCP's second derivatives are symmetric; axes do not turn with the joints that they carry
    (Hourtash, "The kinematic Hessian and higher derivatives", 2005).

    Args:
        rows: (n, 6, n_joints) Jacobians as `jacobian` returns them.

    Returns:
        (n, 6, n_joints, n_joints): [:, :, i, j] is dJ_i / dq_j.
    """
    n, _, n_joints = rows.shape
    move, axis = rows[:, :3].transpose(1, 2, 0), rows[:, 3:].transpose(1, 2, 0)
    hessian = np.zeros((6, n_joints, n_joints, n))
    for i in range(n_joints):
        for j in range(i, n_joints):
            _cross(hessian[:3, i, j], axis[:, i], move[:, j])
            hessian[:3, j, i] = hessian[:3, i, j]
            if j > i:
                _cross(hessian[3:, j, i], axis[:, i], axis[:, j])
    return hessian.transpose(3, 0, 1, 2)


def joint_torque(rows: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return J^T w: the torque [N m] (force [N] at a prismatic joint) of the load on each joint.

    Args:
        rows: (n, 6, n_joints) Jacobians at the TCP.
        wrench: (n, 6) N and N m at the TCP, base frame.

    Returns:
        (n, n_joints).
    """
    return np.asarray(np.einsum("nki,nk->ni", rows, wrench))


def unit_deflections(rows: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the deflection by each spring alone at unit compliance: J_v,s (J_s^T w).

    Args:
        rows: (n, 6, n_springs) twist of the TCP by a unit turn (or slide) of each spring.
        wrench: (n, 6) N and N m at the TCP, base frame.

    Returns:
        (n, 3, n_springs) m for a compliance of 1 rad/(N m) (m/N for a slide).
    """
    return np.asarray(rows[:, :3] * joint_torque(rows, wrench)[:, None, :])


def _fill(columns: FloatArray, links: list[_Link], tool: FloatArray, q: FloatArray) -> None:
    """Write the Jacobian of a chunk into `columns` (6, n_joints, n); `q` is (n_joints, n)."""
    origins = np.empty((len(links) + 1, 3, q.shape[1]))
    for joint, (position, frame) in enumerate(_frames(links, tool, q)):
        origins[joint] = position
        if joint < len(links):
            columns[3:, joint] = frame[2]
    for joint, link in enumerate(links):
        axis = columns[3:, joint]
        if link.prismatic:
            columns[:3, joint] = axis
            columns[3:, joint] = 0.0
        else:
            _cross(columns[:3, joint], axis, origins[-1] - origins[joint])


def _fill_virtual(columns: FloatArray, links: list[_Link], tool: FloatArray, q: FloatArray) -> None:
    """Write into zeros `columns` (6, n_joints, 6, n) of a chunk; `q` is (n_joints, n)."""
    origins = np.empty((len(links) + 1, 3, q.shape[1]))
    for joint, (position, frame) in enumerate(_frames(links, tool, q)):
        origins[joint] = position
        if joint < len(links):
            columns[3:, joint, :3] = frame.transpose(1, 0, 2)
    columns[:3, :, 3:] = columns[3:, :, :3]
    for joint in range(len(links)):
        arm = origins[-1] - origins[joint]
        for axis in range(3):
            _cross(columns[:3, joint, axis], columns[3:, joint, axis], arm)


def _frames(
    links: list[_Link], tool: FloatArray, q: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield every joint's moved frame and last the TCP's: origin (3, n), axes (axis, xyz, n).

    `q` is (n_joints, n). The arrays are worked on in place: copy what is to be kept.
    """
    n = q.shape[1]
    frame = np.zeros((3, 3, n))
    frame[0, 0] = frame[1, 1] = frame[2, 2] = 1.0
    position = np.zeros((3, n))
    for joint, link in enumerate(links):
        _advance(position, frame, link.offset)
        frame = _turn(frame, link.rotation)
        if link.prismatic:
            position += q[joint] * frame[2]
        else:
            cosine, sine = np.cos(q[joint]), np.sin(q[joint])
            x_axis = cosine * frame[0] + sine * frame[1]
            frame[1] = cosine * frame[1] - sine * frame[0]
            frame[0] = x_axis
        yield position, frame
    _advance(position, frame, tool)
    yield position, frame


def _advance(position: FloatArray, frame: FloatArray, offset: FloatArray) -> None:
    """Move `position` by a constant offset given in the moving frame."""
    for axis in range(3):
        if offset[axis] != 0.0:
            position += offset[axis] * frame[axis]


def _turn(frame: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the moving frame (3 axes, 3 components, n) turned by a constant rotation."""
    turned = np.zeros_like(frame)
    for new in range(3):
        for old in range(3):
            if rotation[old, new] != 0.0:
                turned[new] += rotation[old, new] * frame[old]
    return turned


def _cross(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Write the cross product of two (3, n) arrays; `numpy.cross` is several times slower."""
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[j], b[k], out=out[i])
        out[i] -= a[k] * b[j]


def _z_aligned(robot: Robot) -> tuple[list[_Link], FloatArray]:
    """Rewrite the chain so that every joint's axis is its frame's z; returns links and tool."""
    links = []
    basis = np.eye(3)  # the previous joint's z-aligned frame, seen from its own URDF frame
    for placement, axis, kind in zip(robot.placements, robot.axes, robot.joint_types, strict=True):
        aligned = _basis_with_z(axis)
        links.append(
            _Link(
                rotation=basis.T @ placement[:3, :3] @ aligned,
                offset=basis.T @ placement[:3, 3],
                prismatic=kind == "prismatic",
            )
        )
        basis = aligned
    return links, basis.T @ robot.tcp


def _basis_with_z(axis: FloatArray) -> FloatArray:
    """Return a right-handed orthonormal basis (columns) whose third axis is `axis`."""
    helper = np.zeros(3)
    helper[np.argmin(np.abs(axis))] = 1.0
    x_axis = np.cross(helper, axis)
    x_axis /= np.linalg.norm(x_axis)
    return np.stack([x_axis, np.cross(axis, x_axis), axis], axis=1)
