"""Kinematics of a serial chain in NumPy, for many joint positions at once.

The closed forms of `chain_formulas.py` are written once per chain as a straight-line program,
without a loop over samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, frozen_array
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import DataError
from stiff_protocols.kinematics.chain_formulas import Chain, ChainGeometry, Component
from stiff_protocols.kinematics.straight_line import Program, half_angle, tape_with

Formula = Callable[..., Sequence[Component]]
"""A method of `Chain`."""
PROGRAMS_KEPT = 160  # one per formula and chain; a few hundred steps each

REACHED_M, REACHED_RAD = 1e-8, 1e-8
"""Tolerance of inverse kinematics at the target pose."""
STEPS = 40
"""Most Newton steps; within reach and away from singularities it takes three to five."""
PATIENCE = 8
"""Number of steps in which the error must halve; else the point is given up."""
LARGEST_TURN = 0.3
"""rad or m, of a joint in one Newton step."""
LENGTH = 0.5
"""m that count as 1 rad in the damping and the condition of a Jacobian."""
AT_TCP = np.empty(0)
"""Levers of points that are the TCP."""


@dataclass(frozen=True, eq=False, repr=False)
class ChainPoses(BriefFields):
    """Poses of a chain's joint frames and TCP at n joint positions, base frame.

    Attributes:
        points: (n, n_joints + 1, 3) origins of the joints' frames after their motion and TCP, m.
        rotations: (n, n_joints, 3, 3) orientation of every joint's frame after its motion.
        rotation: (n, 3, 3) orientation of the tool: of the last joint's frame, or of the mimic
            joint's behind it.
    """

    points: FloatArray
    rotations: FloatArray
    rotation: FloatArray


class SerialChain(ChainGeometry):
    """Kinematics of a serial chain: the base class of `Robot`.

    In the methods, `q` (n, n_joints) holds joint positions, rad or m, and `wrench` (n, 6) N and
    N m at the TCP, base frame. `q` with another number of joints than the chain is a DataError.
    """

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_types)

    def checked_positions(self, q: FloatArray) -> FloatArray:
        """Return joint positions as (n, n_joints) float64; DataError for any other shape."""
        q = np.asarray(q, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != self.n_joints:
            raise DataError(f"q has shape {q.shape}, expected (n, {self.n_joints})")
        return q

    def forward(self, q: FloatArray) -> ChainPoses:
        """Return the poses of the joints' frames and of the TCP."""
        n = self.n_joints
        return ChainPoses(*self._computed(Chain.poses, q, (n + 1, 3), (n, 3, 3), (3, 3)))

    def tcp_position(self, q: FloatArray) -> FloatArray:
        """Return the (n, 3) position of the TCP [m], base frame."""
        return self._computed(Chain.tcp_position, q, (3,))[0]

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Return the geometric Jacobian at the TCP, base frame.

        Returns:
            (n, 6, n_joints): rows 0..2 translation [m/rad or m/m], rows 3..5 rotation.
        """
        return self._computed(Chain.jacobian, q, (6, self.n_joints))[0]

    def virtual_jacobian(self, q: FloatArray) -> FloatArray:
        """Return the TCP's motion by six virtual joints at every joint, base frame.

        They turn about and slide along the axes x, y, z of the joint's moving frame, after the
        joint's own motion; z is the joint's axis. Where the axis lies along one of the URDF
        frame's, x and y do too; else they are any two across it. A mimic joint has none: its frame
        only has the motion that its master gives it.

        Returns:
            (n, 6, n_joints, 6): rows as of `jacobian`; the last index is the virtual joint: turns
            about x, y, z, then slides along x, y, z.
        """
        return self._computed(Chain.virtual_jacobian, q, (6, self.n_joints, 6))[0]

    def gravity_torque(self, q: FloatArray) -> FloatArray:
        """Return the (n, n_joints) torque [N m] (force [N]) of the links' weights on the joints.

        It has the sign of the loads' torque, and so the opposite one of the generalised gravity
        g(q) that drives must balance. Loads and tools that the robot carries are not part of it.
        """
        (torque,) = self._computed(Chain.gravity_torque, q, (self.n_joints,))
        return np.ascontiguousarray(torque)

    def virtual_gravity_torque(self, q: FloatArray) -> FloatArray:
        """Return the (n, n_joints, 6) torque [N m] and force [N] of the weights on virtual joints.

        Signs as of `gravity_torque`, order as of `virtual_jacobian`.
        """
        return self._computed(Chain.virtual_gravity_torque, q, (self.n_joints, 6))[0]

    def joint_deflection(
        self, compliance: FloatArray, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return ``J_v diag(c) J^T w``, (n, 3) m, base frame, without the Jacobian.

        `compliance` is (n_joints,) rad/(N m) or m/N.

        Raises:
            DataError: a shape is another one, or a compliance is not finite.
        """
        q = self.checked_positions(q)
        springs: list[float] = frozen_array(compliance, "compliance", (self.n_joints,)).tolist()
        wrench = np.asarray(wrench, dtype=np.float64)
        if wrench.shape != (len(q), 6):
            raise DataError(f"wrench has shape {wrench.shape}, expected ({len(q)}, 6)")
        deflection = np.empty((len(q), 3))
        program = _program(Chain.deflection, self, self.n_joints, 6, self.n_joints)
        program.run([q, wrench], deflection.T, springs)
        return deflection

    def inverse(
        self,
        position: FloatArray,
        rotation: FloatArray,
        seed: FloatArray,
        free: BoolArray | None = None,
    ) -> tuple[FloatArray, BoolArray]:
        """Return joint positions at which the TCP has each pose, and whether it reaches it.

        Newton's method for n poses at once, with the damping of Sugihara (IEEE Trans. Robotics 27,
        2011), which shrinks with the remaining error. Joint limits are ignored. A pose that is not
        reached gets the last positions of its search.

        Args:
            position: (n, 3) of the TCP, base frame, m.
            rotation: (n, 3, 3) of the last joint's frame.
            seed: (n, n_joints) where to begin, rad or m.
            free: (n_joints,) whether each joint may move; the others stay at the seed. None: all.

        Raises:
            DataError: the shapes do not fit, or a number is not finite.
        """
        from scipy.spatial.transform import Rotation

        position = frozen_array(position, "position", (len(seed), 3))
        rotation = frozen_array(rotation, "rotation", (len(seed), 3, 3))
        free = np.ones(self.n_joints, dtype=bool) if free is None else free
        q, reached = np.array(seed, dtype=np.float64), np.zeros(len(seed), dtype=bool)
        rows, remaining_error = np.arange(len(q)), np.full((STEPS, len(q)), np.inf)
        for step in range(STEPS):
            tcp, turned, jacobian = self._computed(
                Chain.tool, q[rows], (3,), (3, 3), (6, self.n_joints)
            )
            turn = Rotation.from_matrix(rotation[rows] @ turned.transpose(0, 2, 1))
            error = np.hstack([position[rows] - tcp, turn.as_rotvec()])
            near = np.linalg.norm(error.reshape(-1, 2, 3), axis=2) <= (REACHED_M, REACHED_RAD)
            reached[rows[near.all(axis=1)]] = True
            error[:, :3] /= LENGTH
            remaining_error[step, rows] = np.linalg.norm(error, axis=1)
            on = ~near.all(axis=1)
            if step >= PATIENCE:
                on &= remaining_error[step, rows] < 0.5 * remaining_error[step - PATIENCE, rows]
            rows, error = rows[on], error[on]
            if not len(rows):
                break
            jacobian = jacobian[on][:, :, free]
            jacobian[:, :3] /= LENGTH
            transposed = jacobian.transpose(0, 2, 1)
            damping = 0.5 * np.einsum("ni,ni->n", error, error) + 1e-14
            normal = transposed @ jacobian + damping[:, None, None] * np.eye(free.sum())
            move = np.linalg.solve(normal, transposed @ error[..., None])[..., 0]
            largest = np.abs(move).max(axis=1, keepdims=True)
            move *= np.minimum(1.0, LARGEST_TURN / np.maximum(largest, LARGEST_TURN))
            q[np.ix_(rows, free)] += move
        return q, reached

    def _computed(
        self, formula: Formula, q: FloatArray, *shapes: tuple[int, ...]
    ) -> list[FloatArray]:
        """Return a formula of joint positions, in parts of these shapes, each (n, *shape)."""
        q = self.checked_positions(q)
        program = _program(formula, self, self.n_joints)
        results = np.empty((len(program.results), len(q)))
        program.run([q], results)
        parts = np.split(results, np.cumsum([math.prod(shape) for shape in shapes])[:-1])
        return [
            np.moveaxis(part.reshape(*shape, -1), -1, 0)
            for part, shape in zip(parts, shapes, strict=True)
        ]


@lru_cache(PROGRAMS_KEPT)
def _program(formula: Formula, chain: SerialChain, *sizes: int) -> Program:
    tape, inputs = tape_with(*sizes)
    return Program.of(tape, formula(Chain.of(chain, half_angle), *inputs))


def joint_torque(rows: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return J^T w, (n, n_joints): the load's torque [N m] (force [N] at a prismatic joint).

    `rows` (n, 6, n_joints) is the Jacobian at the TCP.
    """
    return np.asarray(np.einsum("nki,nk->ni", rows, wrench))


def motion_at(rows: FloatArray, levers: FloatArray = AT_TCP) -> FloatArray:
    """Return the (n, 3, ...) motions of points of the last link by (n, 6, ...) twists of the TCP.

    `levers` (n, 3) lead from the TCP to the points, base frame, m: v + omega x lever.
    """
    if not levers.size:
        return rows[:, :3]
    arms = levers.reshape(len(levers), 3, *[1] * (rows.ndim - 2))
    return np.asarray(rows[:, :3] + np.cross(rows[:, 3:], arms, axis=1))


def unit_deflections(
    rows: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
) -> FloatArray:
    """Return the deflection by each single spring at unit compliance: J_v,s (J_s^T w).

    `rows` (n, 6, n_springs) is the twist of the TCP by a unit turn (or slide) of each spring; the
    result (n, 3, n_springs) is in m for a compliance of 1 rad/(N m), or m/N for a slide. It is the
    displacement of the points of `motion_at`; the wrench is at the TCP.
    """
    return np.asarray(motion_at(rows, levers) * joint_torque(rows, wrench)[:, None, :])
