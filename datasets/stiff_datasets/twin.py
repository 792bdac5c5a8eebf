"""The elasto-static digital twin: a simulated robot that shares no code with any model.

The springs of every joint (`springs.py`) carry gravity and load. With J and g of the *deformed*
robot, the torques on them solve ``tau = J^T w - g`` at ``theta = phi(tau)``: a fixed point that
contracts by the share of a spring's stiffness which a load or weight takes away by turning, a few
per cent for an industrial robot. What a tracker would read is the TCP's place with the load minus
its place without: gravity preloads the gears in both.

Everything here is SI: rad, N, N m, m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiff_datasets.elastic_chain import ElasticChain
from stiff_datasets.robots.robot import ChainModel
from stiff_datasets.springs import JointSprings, SpringLaw
from stiff_protocols.errors import DataError
from stiff_protocols.types import FloatArray

TOLERANCE_NM = 1e-10
"""What a torque may still change by in the last step; rounding leaves about 1e-13 N m."""
MAX_ITERATIONS = 100
CHUNK = 2048  # samples at once: the arrays of one step stay in the cache


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The balance of springs, load and weight; elastic coordinates joint by joint.

    Attributes:
        theta: (n, 3 n_joints) elastic coordinates, rad: torsion and two tilts a joint.
        torque: (n, 3 n_joints) torque on the springs, N m.
        tcp: (n, 3) TCP of the deformed robot, base frame, m.
    """

    theta: FloatArray
    torque: FloatArray
    tcp: FloatArray


class DigitalTwin:
    """A robot of given elasticity that can be loaded and read.

    Args:
        chain: rigid kinematics, masses and TCP.
        springs: one entry a joint, base to tip.

    Raises:
        DataError: the number of springs differs from the number of joints, or a joint is
            not revolute.
    """

    def __init__(self, chain: ChainModel, springs: Sequence[JointSprings]) -> None:
        """Build the elastic chain."""
        self._chain = ElasticChain(chain)
        if len(springs) != self._chain.n_joints:
            raise DataError(f"{len(springs)} joint springs for {self._chain.n_joints} joints")
        self._law = SpringLaw(springs)

    def readings(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the TCP's displacements by one load a pose, without measurement noise.

        Args:
            q: (n, n_joints) commanded joint angles, rad.
            wrench: (n, 6) load at the TCP, force [N] then torque [N m], base frame.

        Returns:
            (n, 3) loaded minus unloaded TCP position, m, base frame.

        Raises:
            DataError: no equilibrium was found (the load is beyond the model).
        """
        return self.equilibrium(q, wrench).tcp - self.equilibrium(q, np.zeros_like(wrench)).tcp

    def equilibrium(self, q: FloatArray, wrench: FloatArray) -> Equilibrium:
        """Return the balance under gravity and `wrench`; arguments and errors as `readings`."""
        parts = [
            self._solve(q[start : start + CHUNK].T.copy(), wrench[start : start + CHUNK].T.copy())
            for start in range(0, len(q), CHUNK)
        ]
        theta, torque, tcp = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        return Equilibrium(theta, torque, tcp)

    def tool_vectors(self, q: FloatArray, vector: Sequence[float]) -> FloatArray:
        """Return (n, 3): `vector` (3,) of the last joint's frame in the base frame, undeformed."""
        return self._chain.tool_vectors(q.T, np.asarray(vector)).T

    def _solve(
        self, q: FloatArray, wrench: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        theta = np.zeros((3 * len(q), q.shape[1]))
        state = self._chain.statics(q, theta, wrench)
        for _ in range(MAX_ITERATIONS):
            theta = self._law.angle(state.torque)
            found = self._chain.statics(q, theta, wrench)
            change = np.abs(found.torque - state.torque).max(axis=0)
            state = found
            if (change < TOLERANCE_NM).all():
                return theta.T, state.torque.T, state.tcp.T
        worst = int(np.argmax(~(change < TOLERANCE_NM)))  # NaN is no balance either
        raise DataError(
            f"no elastic equilibrium at q = {np.rad2deg(q[:, worst]).round(3)} deg under the "
            f"wrench {wrench[:, worst].round(3)}: the load is too large for these springs"
        )
