"""The elasto-static digital twin: a simulated robot that shares no code with any model.

Every joint of a Pinocchio model is followed by two more revolute joints across its axis. The
three together are the elastic coordinates theta of that joint:

* about the axis a strain-wave gear with three torsional slopes, the structure in series with it
  and lost motion;
* about the two cross axes the tilting springs of the bearing.

The springs carry gravity and load, so theta solves ``theta = phi(J^T w - g)``, where J and g are
those of the *deformed* robot. It is solved by Newton's method. What a tracker would read is the
TCP's place with the load minus its place without: gravity preloads the gears in both.

Everything here is SI: rad, N, m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from stiff_datasets.robots.robot import ChainModel, joint_type_and_axis
from stiff_protocols.errors import DataError
from stiff_protocols.types import FloatArray

TOLERANCE_RAD = 1e-13
MAX_ITERATIONS = 50


@dataclass(frozen=True)
class GearSize:
    """Catalogue torsion of a strain-wave gear: slope K1 up to T1, K2 up to T2, K3 above.

    Attributes:
        slopes: K1, K2, K3 in N m/rad.
        breakpoints: T1, T2 in N m.
        rated_torque: N m; lost motion is measured at +-4 % of it.
    """

    slopes: tuple[float, float, float]
    breakpoints: tuple[float, float]
    rated_torque: float


@dataclass(frozen=True)
class JointSprings:
    """The elasticity of one joint.

    Attributes:
        gear: its strain-wave gear.
        structure: stiffness of casing and link in series with the gear, N m/rad.
        tilting: stiffness about the two cross axes, N m/rad.
        lost_motion: full width of the backlash-like dead angle, rad.
    """

    gear: GearSize
    structure: float
    tilting: tuple[float, float]
    lost_motion: float


@dataclass(frozen=True)
class _SpringLaw:
    """theta = phi(tau) of all elastic coordinates, as arrays of shape (n_elastic,)."""

    compliance: FloatArray  # (3, n) rad/(N m) of the three segments
    breakpoints: FloatArray  # (2, n) N m
    half_lost_motion: FloatArray  # rad
    lost_motion_torque: FloatArray  # N m

    def angle(self, torque: FloatArray) -> FloatArray:
        size = np.abs(torque)
        first, second = self.breakpoints
        bent = (
            self.compliance[0] * np.minimum(size, first)
            + self.compliance[1] * np.clip(size - first, 0.0, second - first)
            + self.compliance[2] * np.maximum(size - second, 0.0)
        )
        lost = self.half_lost_motion * np.tanh(torque / self.lost_motion_torque)
        return np.asarray(np.sign(torque) * bent + lost)

    def slope(self, torque: FloatArray) -> FloatArray:
        size = np.abs(torque)
        first, second = self.breakpoints
        segment = np.where(
            size < first,
            self.compliance[0],
            np.where(size < second, self.compliance[1], self.compliance[2]),
        )
        ratio = np.tanh(torque / self.lost_motion_torque)
        return np.asarray(
            segment + self.half_lost_motion / self.lost_motion_torque * (1.0 - ratio**2)
        )


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
        """Build the elastic model."""
        n_joints = chain.model.njoints - 1
        if len(springs) != n_joints:
            raise DataError(f"{len(springs)} joint springs for {n_joints} joints")
        self._model = _elastic_model(chain)
        self._data = self._model.createData()
        self._last = self._model.njoints - 1
        self._tcp = pin.SE3(np.eye(3), chain.tcp)
        self._law = _spring_law(springs)

    def reading(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the TCP's displacement by one load at one pose, without measurement noise.

        Args:
            q: (n_joints,) commanded joint angles, rad.
            wrench: (6,) load at the TCP, force [N] then torque [N m], base frame.

        Returns:
            (3,) loaded minus unloaded TCP position, m, base frame.
        """
        unloaded = self.equilibrium(q, np.zeros(6))
        return self.tcp_position(q, self.equilibrium(q, wrench, unloaded)) - self.tcp_position(
            q, unloaded
        )

    def equilibrium(
        self, q: FloatArray, wrench: FloatArray, start: FloatArray | None = None
    ) -> FloatArray:
        """Return the (3 n_joints,) elastic coordinates in balance under gravity and `wrench`.

        Raises:
            DataError: Newton's method did not converge (the load is beyond the model).
        """
        theta = np.zeros(self._model.nv) if start is None else start.copy()
        residual = self._residual(q, theta, wrench)
        for _ in range(MAX_ITERATIONS):
            if np.abs(residual).max() < TOLERANCE_RAD:
                return theta
            step = np.linalg.solve(self._residual_jacobian(q, theta, wrench), -residual)
            scale = 1.0
            while True:  # halve the step while it does not help: phi has kinks
                trial = self._residual(q, theta + scale * step, wrench)
                if np.abs(trial).max() < np.abs(residual).max() or scale < 1e-3:
                    break
                scale *= 0.5
            theta, residual = theta + scale * step, trial
        raise DataError(f"no elastic equilibrium at q = {np.rad2deg(q).round(3)} deg")

    def tcp_position(self, q: FloatArray, theta: FloatArray) -> FloatArray:
        """Return the (3,) TCP position [m] of the robot deformed by `theta`."""
        pin.forwardKinematics(self._model, self._data, self._positions(q, theta))
        return np.asarray(self._data.oMi[self._last].act(self._tcp).translation.copy())

    def tool_rotation(self, q: FloatArray) -> FloatArray:
        """Return the (3, 3) orientation of the undeformed robot's last joint, base frame."""
        pin.forwardKinematics(self._model, self._data, self._positions(q, np.zeros(self._model.nv)))
        return np.asarray(self._data.oMi[self._last].rotation.copy())

    def torque(self, q: FloatArray, theta: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (3 n_joints,) torque on the springs, N m: J^T w - g, deformed robot."""
        x = self._positions(q, theta)
        gravity = pin.computeGeneralizedGravity(self._model, self._data, x)
        pin.computeJointJacobians(self._model, self._data, x)
        rows = pin.getFrameJacobian(
            self._model, self._data, self._last, self._tcp, pin.LOCAL_WORLD_ALIGNED
        )
        return np.asarray(rows.T @ wrench - gravity)

    def torque_derivative(self, q: FloatArray, theta: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the derivative of `torque` by theta, (3 n_joints, 3 n_joints), N m/rad."""
        x = self._positions(q, theta)
        result = -pin.computeGeneralizedGravityDerivatives(self._model, self._data, x)
        # d(J^T w)/dx_k, column by column: J moves as the joints do, the load stays as it is
        for k, direction in enumerate(np.eye(self._model.nv)):
            result[:, k] += self._jacobian_derivative(x, direction).T @ wrench
        return np.asarray(result)

    def _jacobian_derivative(self, x: FloatArray, direction: FloatArray) -> FloatArray:
        """Return dJ/dt at the TCP for joint velocities `direction`, (6, n_elastic)."""
        pin.computeJointJacobiansTimeVariation(self._model, self._data, x, direction)
        rows = pin.getJointJacobianTimeVariation(self._model, self._data, self._last, pin.WORLD)
        world = pin.getJointJacobian(self._model, self._data, self._last, pin.WORLD)
        # WORLD rows are taken at the base's origin; carry them, and their change, to the TCP
        tcp = self._data.oMi[self._last].act(self._tcp).translation
        at_tcp = world[:3] - pin.skew(tcp) @ world[3:]
        velocity = at_tcp @ direction
        change = rows[:3] - pin.skew(tcp) @ rows[3:] - pin.skew(velocity) @ world[3:]
        return np.vstack([change, rows[3:]])

    def _positions(self, q: FloatArray, theta: FloatArray) -> FloatArray:
        x = theta.copy()
        x[::3] += q
        return x

    def _residual(self, q: FloatArray, theta: FloatArray, wrench: FloatArray) -> FloatArray:
        return theta - self._law.angle(self.torque(q, theta, wrench))

    def _residual_jacobian(
        self, q: FloatArray, theta: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        slope = self._law.slope(self.torque(q, theta, wrench))
        return np.eye(len(theta)) - slope[:, None] * self.torque_derivative(q, theta, wrench)


def _elastic_model(chain: ChainModel) -> pin.Model:
    """Return the chain with two cross joints behind every joint; they carry its link."""
    rigid, elastic = chain.model, pin.Model()
    elastic.gravity = rigid.gravity
    parent = 0
    for joint in range(1, rigid.njoints):
        kind, axis = joint_type_and_axis(rigid, joint)
        if kind != "revolute":
            raise DataError(f"joint {rigid.names[joint]!r} is {kind}; the twin has no law for it")
        across = np.linalg.svd(axis[None])[2][1:]  # (2, 3): an orthonormal complement
        placement = rigid.jointPlacements[joint]
        for name, direction in zip(("torsion", "tilt_a", "tilt_b"), (axis, *across), strict=True):
            parent = elastic.addJoint(
                parent,
                pin.JointModelRevoluteUnaligned(direction),
                placement,
                f"{rigid.names[joint]}_{name}",
            )
            placement = pin.SE3.Identity()
        elastic.appendBodyToJoint(parent, rigid.inertias[joint], pin.SE3.Identity())
    return elastic


def _spring_law(springs: Sequence[JointSprings]) -> _SpringLaw:
    compliance, breakpoints, lost, lost_torque = [], [], [], []
    for joint in springs:
        compliance.append([1.0 / slope + 1.0 / joint.structure for slope in joint.gear.slopes])
        breakpoints.append(joint.gear.breakpoints)
        lost.append(joint.lost_motion / 2.0)
        lost_torque.append(0.04 * joint.gear.rated_torque)
        for tilting in joint.tilting:  # linear: the same slope in all three segments
            compliance.append([1.0 / tilting] * 3)
            breakpoints.append((1.0, 2.0))
            lost.append(0.0)
            lost_torque.append(1.0)
    return _SpringLaw(
        np.array(compliance).T, np.array(breakpoints).T, np.array(lost), np.array(lost_torque)
    )
