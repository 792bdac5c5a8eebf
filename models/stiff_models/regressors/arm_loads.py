"""Loads on the virtual springs of an arm, their typical sizes, and errors of the rig.

Every joint has six virtual springs at its moving frame: two across its axis, its own, and three of
the other kind (a revolute joint has slides there). The base has six, too. Spring s moves the TCP by
a_s; the load turns it by the torque t_s, the weights turn it by g_s. SI: rad, N, N m, m.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from stiff_models.physics.fitted_geometry import moved_wrench
from stiff_models.physics.full_vjm import FullVjm, typical_springs
from stiff_models.physics.vjm import identify_joints
from stiff_protocols.contract.errors import StiffBenchWarning
from stiff_protocols.contract.types import (
    BoolArray,
    FloatArray,
    IntArray,
    Robot,
    Samples,
    read_along,
)
from stiff_protocols.kinematics.serial_chain import motion_at

OWN_AXIS = 2
"""Number of a joint's own spring among its six; 0 and 1 are across it, 3 to 5 of the other kind."""
LEVER_SHARE = 0.15
"""A link is about as soft in sliding as its joint is at this share of the arm's reach."""
WRENCH_NOISE = 0.01
"""Error of a wrench, of the largest one."""
SMALLEST, LEAST_SHARE = 1e-3, 0.05
"""Least compliance of a joint: of the softest joint's, and of its own estimate without tilts."""


@dataclass(frozen=True, eq=False)
class Sizes:
    """Typical sizes of a robot and its training loads, the units of the coefficients.

    Attributes:
        compliance: (n_joints + 1, 6) of each virtual spring, rad/(N m) or m/N.
        springs: (n_joints + 1, 6) as the full VJM identifies them; 0: it does not have the spring.
        torque: (n_joints + 1, 6) largest training torque [N m or N].
        wrench: (6,) root mean square of forces [N], then of torques [N m].
        largest: (6,) largest training wrench, N and N m.
    """

    compliance: FloatArray
    springs: FloatArray
    torque: FloatArray
    wrench: FloatArray
    largest: FloatArray

    @classmethod
    def of(cls, robot: Robot, train: Samples) -> Self:
        """Return the sizes; ModelError if no joint spring can be identified."""
        count = robot.n_joints
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StiffBenchWarning)  # they are sizes only
            full_vjm = FullVjm().fit(train, robot=robot)
        identified = np.reshape(full_vjm.compliance_, (count, 3))
        single = identify_joints(robot, train).compliance
        joints = identified[:, OWN_AXIS]
        joints = np.where(joints < LEAST_SHARE * single, single, joints)
        if not joints.any():
            joints = typical_springs(robot, 3).reshape(count, 3)[:, OWN_AXIS]
        joints = np.maximum(joints, SMALLEST * joints.max())
        reach = float(np.linalg.norm(robot.tcp_position(np.zeros((1, count))))) or 1.0
        lever = LEVER_SHARE * reach
        across_kind = joints * np.where(robot.turns, lever**2, lever**-2)
        base = [joints[0], across_kind[0]] if robot.turns[0] else [across_kind[0], joints[0]]
        of_joints = np.column_stack([joints] * 3 + [across_kind] * 3)
        compliance = np.vstack([np.repeat(base, 3), of_joints])
        springs = np.zeros((count + 1, 6))
        springs[1:, :3] = identified
        force, torque = (
            float(np.sqrt((part**2).sum(axis=1).mean())) for part in np.hsplit(train.wrench, 2)
        )
        force = force or torque / lever
        wrench = np.repeat([force, max(torque, LEVER_SHARE / 3.0 * force)], 3)
        largest = np.abs(train.wrench).max(axis=0)
        load = ArmLoads.of(robot, train.q, train.wrench, Rig.perfect(count)).load
        size = np.abs(load).max(axis=0)
        return cls(compliance, springs, np.where(size > 0.0, size, 1.0), wrench, largest)


@dataclass(frozen=True, eq=False)
class Rig:
    """Errors of the loads that a file states, and factors of the weights.

    Attributes:
        force_point: (3,) from the TCP to the point where the force acts, last joint's frame, m.
        cross_talk: (6, 6) share of each written component in each component that acts.
        weight_factor: (n_joints,) weights on each joint over the description's; of the robot.
    """

    force_point: FloatArray
    cross_talk: FloatArray
    weight_factor: FloatArray

    @classmethod
    def perfect(cls, n_joints: int) -> Self:
        """Return a rig whose file is right."""
        return cls(np.zeros(3), np.zeros((6, 6)), np.ones(n_joints))

    @property
    def without_errors(self) -> Rig:
        """The same robot with a perfect rig: what a tool path has."""
        return replace(self, force_point=np.zeros(3), cross_talk=np.zeros((6, 6)))


@dataclass(frozen=True, eq=False)
class ArmLoads:
    """Motions and torques of the virtual springs at n samples; joint 0 is the base.

    Attributes:
        q: (n, n_joints) joint positions, rad or m.
        written: (n, 6) wrench as written, N and N m.
        acting: (n, 6) wrench that acts at the TCP.
        rotation: (n, 3, 3) orientation of the last joint's frame.
        twist: (n, 6, n_joints + 1, 6) twist of the TCP by a unit motion of each spring.
        load: (n, n_joints + 1, 6) torque [N m] or force [N] of the load on each spring.
        weight: (n, n_joints + 1, 6) the same of the weights.
        turns: (n_joints,) true for revolute joints.
        by_weight: (n, 3, n_joints) derivative of the deflection by each joint's weight factor, m.
        order: (n,) number or time of each reading, and approach: (n, n_joints) direction from
            which each joint came; empty: not stated.
        directions: (n, m, 3) as `Samples.directions`; empty: x, y and z. Where it is stated,
            columns are (n, m, p) readings.
        levers: (n, 3) as `Samples.levers`.
    """

    q: FloatArray
    written: FloatArray
    acting: FloatArray
    rotation: FloatArray
    twist: FloatArray
    load: FloatArray
    weight: FloatArray
    turns: BoolArray
    by_weight: FloatArray = field(default_factory=lambda: np.empty(0))
    order: FloatArray = field(default_factory=lambda: np.empty(0))
    approach: FloatArray = field(default_factory=lambda: np.empty(0))
    directions: FloatArray = field(default_factory=lambda: np.empty(0))
    levers: FloatArray = field(default_factory=lambda: np.empty(0))

    @classmethod
    def of(cls, robot: Robot, q: FloatArray, wrench: FloatArray, rig: Rig) -> Self:
        """Return the loads of (n, n_joints) positions and (n, 6) written wrenches."""
        rotation = robot.forward(q).rotation
        acting = wrench + wrench @ rig.cross_talk.T
        acting = moved_wrench(acting, rotation @ rig.force_point)
        order = np.where(robot.turns[:, None], np.arange(6), [3, 4, 5, 0, 1, 2])  # own kind first
        jacobian = np.take_along_axis(robot.virtual_jacobian(q), order[None, None], axis=3)
        weight = np.take_along_axis(robot.virtual_gravity_torque(q), order[None], axis=2)
        twist = np.concatenate([_base_twists(robot.tcp_position(q))[:, :, None], jacobian], axis=2)
        load = np.einsum("nkjs,nk->njs", twist, acting)
        weight = np.concatenate(
            [np.zeros((len(q), 1, 6)), weight * rig.weight_factor[:, None]], axis=1
        )
        return cls(q, wrench, acting, rotation, twist, load, weight, robot.turns)

    @cached_property
    def move(self) -> FloatArray:
        """(n, 3, n_joints + 1, 6) motion, as read, by a unit motion of each spring."""
        return self.read(motion_at(self.twist, self.levers))

    def read(self, displacement: FloatArray) -> FloatArray:
        """Return the (n, m, ...) readings [m] of (n, 3, ...) displacements."""
        return read_along(self.directions, displacement)

    @property
    def joints(self) -> range:
        """Numbers of the robot's joints."""
        return range(1, self.load.shape[1])

    def products(self, sizes: Sizes, pairs: list[tuple[int, int, int, int]]) -> FloatArray:
        """Return (n, 3, p) columns a_r t_s + a_s t_r of pairs (joint, axis, joint, axis)."""
        joint, axis, other_joint, other_axis = np.array(pairs, dtype=int).reshape(-1, 4).T
        unit = sizes.compliance
        size = np.sqrt(unit[joint, axis] * unit[other_joint, other_axis])
        columns = self.move[:, :, joint, axis] * self.load[:, None, other_joint, other_axis]
        mirrored = self.move[:, :, other_joint, other_axis] * self.load[:, None, joint, axis]
        same = (joint == other_joint) & (axis == other_axis)
        return np.asarray((columns + np.where(same, 0.0, mirrored)) * size)

    def curves(self, sizes: Sizes, axes: IntArray, turned: FloatArray) -> FloatArray:
        """Return (n, 3, p) motions of the TCP by (n, n_joints, k) turns over c T of springs."""
        size = (sizes.compliance * sizes.torque)[1:, axes]
        columns = self.move[:, :, 1:, axes] * (turned * size)[:, None]
        return np.asarray(columns.reshape(*columns.shape[:2], -1))

    def compliance(self, sizes: Sizes) -> FloatArray:
        """Return the (n, 3, 6) compliance of the identified linear springs, as read."""
        twist = self.twist.reshape(*self.twist.shape[:2], -1)
        move = self.read(motion_at(twist, self.levers))
        return np.asarray((move * sizes.springs.ravel()) @ twist.swapaxes(1, 2))


def friction_turns(loads: ArmLoads, sizes: Sizes, width: float) -> FloatArray:
    """Return the (n, n_joints) turns c T tanh(|t| / (h T)) by friction, without their sign."""
    torque = sizes.torque[1:, OWN_AXIS]
    turned = sizes.compliance[1:, OWN_AXIS] * torque
    shares = np.tanh(np.abs(loads.load[:, 1:, OWN_AXIS]) / (width * torque))
    return np.asarray(turned * shares)


def friction_blocks(loads: ArmLoads, sizes: Sizes, width: float) -> FloatArray:
    """Return the (n, 3, 3) covariances of friction whose state is unknown."""
    turned = friction_turns(loads, sizes, width)
    moved = loads.move[:, :, 1:, OWN_AXIS] * turned[:, None]
    return np.asarray(moved @ moved.swapaxes(1, 2))


def wrench_blocks(loads: ArmLoads, sizes: Sizes) -> FloatArray:
    """Return the (n, 3, 3) covariances of wrenches with an error of 1 % of the largest."""
    moved = loads.compliance(sizes) * sizes.largest * WRENCH_NOISE
    return np.asarray(moved @ moved.swapaxes(1, 2))


def _base_twists(tcp: FloatArray) -> FloatArray:
    """Return the (n, 6, 6) twists of the TCP by turns about and slides along the base's axes."""
    axes = np.eye(3)
    twists = np.zeros((len(tcp), 6, 6))
    for axis in range(3):
        twists[:, :3, axis], twists[:, 3:, axis] = np.cross(axes[axis], tcp), axes[axis]
        twists[:, :3, 3 + axis] = axes[axis]
    return twists
