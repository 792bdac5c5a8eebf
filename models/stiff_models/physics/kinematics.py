"""Batched kinematics of a serial chain in NumPy: the hot paths of every physical model.

The closed form is `chain.py`'s, written once a robot as a straight-line program; there is no loop
over samples. Arguments, unless a function says otherwise: the `robot`; `q` (n, n_joints) joint
positions, rad or m; `wrench` (n, 6) N and N m at the TCP, base frame; `rows` (n, 6, n_joints)
Jacobians at the TCP. `q` with another number of joints than the robot is a DataError.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from stiff_models.physics.chain import Chain, Component
from stiff_models.physics.straight_line import Program, half_angle, tape_with
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, Robot

Formula = Callable[..., Sequence[Component]]
"""A method of `Chain`."""
PROGRAMS_KEPT = 160  # one a formula and robot; a few hundred steps each


def jacobian(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the geometric Jacobian at the TCP, base frame.

    Returns:
        (n, 6, n_joints): rows 0..2 translation [m/rad or m/m], rows 3..5 rotation.
    """
    q = robot.checked_positions(q)
    columns = np.empty((6, robot.n_joints, len(q)))
    _run(Chain.jacobian, robot, [q], columns.reshape(6 * robot.n_joints, len(q)))
    return columns.transpose(2, 0, 1)


def virtual_jacobian(robot: Robot, q: FloatArray) -> FloatArray:
    """Return how the TCP moves with six virtual joints at every joint, base frame.

    They turn about and slide along the axes x, y, z of the joint's moving frame, after the joint's
    own motion; z is the joint's axis. Where the axis lies along one of the URDF frame's, x and y
    do too; else they are any two across it.

    Returns:
        (n, 6, n_joints, 6): rows as of `jacobian`; the last index is the virtual joint: turns
        about x, y, z, then slides along x, y, z.
    """
    q = robot.checked_positions(q)
    columns = np.empty((6, robot.n_joints, 6, len(q)))
    _run(Chain.virtual_jacobian, robot, [q], columns.reshape(36 * robot.n_joints, len(q)))
    return columns.transpose(3, 0, 1, 2)


def kinematic_hessian(rows: FloatArray) -> FloatArray:
    """Return the derivatives of Jacobians by the joint positions.

    A turn about axis a_i moves all that it carries: column j changes by a_i x J_j for j >= i, and
    the TCP's second derivatives are symmetric; axes do not turn with the joints that they carry
    (Hourtash, "The kinematic Hessian and higher derivatives", 2005).

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
    """Return J^T w, (n, n_joints): the load's torque [N m] (force [N] at a prismatic joint)."""
    return np.asarray(np.einsum("nki,nk->ni", rows, wrench))


def unit_deflections(rows: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the deflection by each spring alone at unit compliance: J_v,s (J_s^T w).

    `rows` (n, 6, n_springs) is the twist of the TCP by a unit turn (or slide) of each spring; the
    result (n, 3, n_springs) is in m for a compliance of 1 rad/(N m), or m/N for a slide.
    """
    return np.asarray(rows[:, :3] * joint_torque(rows, wrench)[:, None, :])


def _cross(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Write the cross product of two (3, n) arrays; `numpy.cross` is several times slower."""
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[j], b[k], out=out[i])
        out[i] -= a[k] * b[j]


def gravity_torque(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the (n, n_joints) torque [N m] (force [N]) of the links' weights on the joints.

    It has the sign of the loads' torque, and so the opposite one of the generalised gravity g(q)
    that drives must balance. Loads and tools that the robot carries are not part of it.
    """
    q = robot.checked_positions(q)
    torque = np.empty((robot.n_joints, len(q)))
    _run(Chain.gravity_torque, robot, [q], torque)
    return np.ascontiguousarray(torque.T)


def virtual_gravity_torque(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the (n, n_joints, 6) torque [N m] and force [N] of the weights on virtual joints.

    Signs as of `gravity_torque`, order as of `virtual_jacobian`.
    """
    q = robot.checked_positions(q)
    torque = np.empty((robot.n_joints, 6, len(q)))
    _run(Chain.virtual_gravity_torque, robot, [q], torque.reshape(6 * robot.n_joints, len(q)))
    return torque.transpose(2, 0, 1)


def joint_deflection(
    robot: Robot, compliance: FloatArray, q: FloatArray, wrench: FloatArray
) -> FloatArray:
    """Return ``J_v diag(c) J^T w``, (n, 3) m, base frame, without the Jacobian.

    `compliance` is (n_joints,) rad/(N m) or m/N.

    Raises:
        DataError: a shape is another one, or a compliance is not finite.
    """
    q = robot.checked_positions(q)
    wrench, springs = np.asarray(wrench, dtype=np.float64), _checked_springs(robot, compliance)
    if wrench.shape != (len(q), 6):
        raise DataError(f"wrench has shape {wrench.shape}, expected ({len(q)}, 6)")
    deflection = np.empty((len(q), 3))
    _run(Chain.deflection, robot, [q, wrench], deflection.T, springs)
    return deflection


def compliance_matrix(robot: Robot, compliance: FloatArray, q: FloatArray) -> FloatArray:
    """Return ``J_v diag(c) J^T``, (n, 3, 6) m/N, then m/(N m), base frame, as above."""
    q = robot.checked_positions(q)
    matrix = np.empty((len(q), 18))
    _run(Chain.compliance_matrix, robot, [q], matrix.T, _checked_springs(robot, compliance))
    return matrix.reshape(-1, 3, 6)


def _checked_springs(robot: Robot, compliance: FloatArray) -> list[float]:
    compliance = np.asarray(compliance, dtype=np.float64)
    if compliance.shape != (robot.n_joints,):
        raise DataError(f"compliance has shape {compliance.shape}, expected ({robot.n_joints},)")
    if not np.isfinite(compliance).all():
        raise DataError(f"compliance is {compliance.tolist()}, expected finite numbers")
    values: list[float] = compliance.tolist()
    return values


def _run(
    formula: Formula,
    robot: Robot,
    columns: Sequence[FloatArray],
    out: FloatArray,
    shared: Sequence[float] = (),
) -> None:
    """Compute a formula of the robot's chain; the other arguments are those of `Program.run`."""
    sizes = [array.shape[1] for array in columns] + ([len(shared)] if len(shared) else [])
    _program(formula, robot, *sizes).run(columns, out, shared)


@lru_cache(PROGRAMS_KEPT)
def _program(formula: Formula, robot: Robot, *sizes: int) -> Program:
    tape, inputs = tape_with(*sizes)
    return Program.of(tape, formula(Chain.of(robot, half_angle), *inputs))
