"""Compute the statics of a serial chain with tilting joints, for many samples.

Each joint has three elastic coordinates. A revolute joint has the torsion about its axis and two
tilts across it. A prismatic joint has the displacement along its axis and the same two tilts. The
motions follow in this order, and then the joint's link. Arrays hold one sample per column. A
joint's frame has its own basis (two cross axes, then the joint's axis), so that every turn mixes
only two columns of the rotation matrix.

SI: rad, N, N m, m. The first coordinate of a prismatic joint is in m, its torque is a force in N.
"""

from __future__ import annotations

import numpy as np

from stiff_protocols.contract.types import FloatArray, Robot


class ElasticChain:
    """A serial chain with three elastic coordinates per joint.

    Args:
        robot: rigid kinematics, masses and TCP.
    """

    def __init__(self, robot: Robot) -> None:
        """Transform every constant into the joints' bases."""
        bases = [_basis(robot, joint) for joint in range(robot.n_joints)]
        previous = [np.eye(3), *bases[:-1]]
        steps = [*zip(previous, robot.placements, bases, strict=True)]
        self.n_joints, self._turns = robot.n_joints, robot.turns
        self._turn = np.stack([b.T @ p[:3, :3] @ a for b, p, a in steps])  # (n_joints, 3, 3)
        self._offset = np.stack([b.T @ p[:3, 3] for b, p, _ in steps])  # (n_joints, 3) m
        centres = zip(bases, robot.centres_of_mass, strict=True)
        self._centre = np.stack([b.T @ centre for b, centre in centres])  # (n_joints, 3) m
        self._weight = robot.masses[:, None] * robot.gravity  # (n_joints, 3) N
        self._tcp = bases[-1].T @ robot.tcp

    def statics(
        self, q: FloatArray, theta: FloatArray, wrench: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return torques and TCP of the chain at `q`, deformed by `theta`, under `wrench`.

        Args:
            q: (n_joints, n) commanded joint positions, rad or m.
            theta: (3 n_joints, n) elastic coordinates, rad or m.
            wrench: (6, n) load at the TCP, force [N] then torque [N m], base frame.

        Returns:
            (3 n_joints, n) torque of load and weight about every elastic axis, N m; a joint's
            torsion first (N along a prismatic joint's axis), then its two tilts. And (3, n)
            position of the TCP in the base frame, m.
        """
        frame = np.repeat(np.eye(3)[:, :, None], q.shape[1], axis=2)  # (column, xyz, n)
        angle = theta.copy()
        angle[::3] += q
        sine, cosine = np.sin(angle), np.cos(angle)
        axes = np.empty((len(theta), 3, q.shape[1]))
        arm, centre = [], []  # joint to joint, and joint to its link's centre of mass
        for joint in range(self.n_joints):
            arm.append(_along(self._offset[joint], frame))
            frame = np.tensordot(self._turn[joint], frame, axes=(0, 0))
            for k, turned in enumerate((2, 0, 1)):  # torsion, then the tilts
                row = 3 * joint + k
                axes[row] = frame[turned]
                if k or self._turns[joint]:
                    _mix(frame, (turned + 1) % 3, (turned + 2) % 3, sine[row], cosine[row])
                else:
                    arm[joint] = arm[joint] + angle[row] * frame[turned]
            centre.append(_along(self._centre[joint], frame))
        lever = _along(self._tcp, frame)
        torque = np.empty((len(axes), wrench.shape[1]))
        force, moment = wrench[:3], wrench[3:] + _cross(lever, wrench[:3])
        for joint in reversed(range(self.n_joints)):  # from the tip, projected on the axes
            weight = self._weight[joint][:, None]
            moment = moment + _cross(centre[joint], weight)
            force = force + weight
            rows = slice(3 * joint, 3 * joint + 3)
            torque[rows] = np.einsum("kcn,cn->kn", axes[rows], moment)
            if not self._turns[joint]:
                torque[3 * joint] = np.einsum("cn,cn->n", axes[3 * joint], force)
            moment = moment + _cross(arm[joint], force)
        return torque, sum(arm[1:], arm[0] + lever)


def _basis(robot: Robot, joint: int) -> FloatArray:
    """Return a right-handed basis (3, 3): two cross axes, then the joint's axis."""
    axis = robot.axes[joint]
    first = np.linalg.svd(axis[None])[2][1]  # any direction across the axis
    return np.column_stack([first, np.cross(axis, first), axis])


def _along(vector: FloatArray, frame: FloatArray) -> FloatArray:
    """Return (3, n) the constant `vector` (3,) of frames (column, xyz, n) in base axes."""
    return np.asarray(np.tensordot(vector, frame, axes=(0, 0)))


def _mix(frame: FloatArray, first: int, second: int, sine: FloatArray, cosine: FloatArray) -> None:
    """Turn frames in place about their third axis, in a right-handed order."""
    turned = cosine * frame[first] + sine * frame[second]
    frame[second] = cosine * frame[second] - sine * frame[first]
    frame[first] = turned


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the (3, n) cross products of (3, n) vectors; np.cross is slow along axis 0."""
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
