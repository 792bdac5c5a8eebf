"""Simulate an experiment on a digital twin: loads, noisy readings, records.

Records are rounded like a log. The steps are coarser than rounding errors, so that the data's hash
is the same on every machine.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import NamedTuple

import numpy as np

from stiff_datasets.planning.loads import (
    LoadKind,
    hook_wrenches,
    line_wrenches,
    omni_forces,
    stream,
)
from stiff_datasets.planning.poses import Poses
from stiff_datasets.twin.beams import Beams
from stiff_datasets.twin.constants import (
    Noise,
    TwinConstants,
    TwinPhysics,
    specimen_beams,
    specimen_springs,
)
from stiff_datasets.twin.elastic_chain import ElasticChain
from stiff_datasets.twin.spring_law import JointSprings, SlideSprings, SpringLaw
from stiff_datasets.twin.twin_effects import (
    HYSTERESIS,
    KINEMATICS,
    LINKS,
    Instruments,
    real_robot,
)
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Robot, Samples

DECIMALS_DEG, DECIMALS_N, DECIMALS_NM, DECIMALS_MM = 4, 3, 5, 5


@dataclass(eq=False)
class TwinExperiment:
    """A twin's measurement.

    Attributes:
        constants: constants of the twin.
        loads: kind of the wrenches.
        specimen: number of the robot of the type.
        seed: draws loads and noise; the robot does not depend on it.
        loads_per_pose: number of loads per pose.
        physics: "rigid": no bearing tilts, and the links bend; all random numbers are the same.
        effects: effects in addition to the default twin, see `twin_effects.py`.
        max_load_share: largest pull at a hook, relative to the payload.
        robot: the real robot.
        twin: its elasticity.

    Raises:
        DataError: the links have to bend, and `constants` have no beams.
    """

    constants: TwinConstants
    _: KW_ONLY
    loads: LoadKind = "omni"
    specimen: int
    seed: int
    loads_per_pose: int = 1
    physics: TwinPhysics = "tilting"
    effects: Collection[str] = ()
    max_load_share: float = 1.0

    def __post_init__(self) -> None:
        """Build the twin."""
        constants, specimen, robot = self.constants, self.specimen, self.constants.robot()
        self._instruments = Instruments.of(constants, specimen, self.effects)
        if KINEMATICS in self.effects:
            rng = stream("kinematics", constants.name, specimen)
            robot = real_robot(robot, constants.errors, rng)
        springs, is_rigid = [*specimen_springs(constants, specimen)], self.physics == "rigid"
        if is_rigid:
            springs = [
                replace(joint, tilting=(np.inf, np.inf))
                if isinstance(joint, JointSprings)
                else joint
                for joint in springs
            ]
        must_bend = LINKS in self.effects or is_rigid
        self.robot = robot
        self.twin = DigitalTwin(
            robot,
            springs,
            beams=specimen_beams(constants, robot, specimen, must_bend=must_bend),
            hysteresis=HYSTERESIS in self.effects,
        )
        # "line" and "line-hook" share their forces; only the torques differ
        loads = self.loads.split("-")[0]
        self._key = (constants.name, loads, self.loads_per_pose, specimen, self.seed)

    def samples(self, poses: Poses, *, block: int = 0) -> Samples:
        """Measure every load at each of the poses, pose by pose.

        Args:
            poses: the poses.
            block: another number gives other loads and noise.

        Raises:
            DataError: a load is too large for the twin.
        """
        q = self.logged_q(poses)
        wrench = self.wrenches(q, block=block)
        return self.recorded(poses, wrench, self.twin.readings(q, wrench), block=block)

    def measured(self, poses: Poses) -> BenchmarkData:
        """Return `samples` with the robot and the twin's exact deflections; error as `samples`.

        "oracle" is the twin's own prediction from the recorded joint angles and wrenches, "noise"
        the tracker's reading without noise. For other loads, `DigitalTwin.readings` gives the exact
        deflections in the true base frame, not in the tracker's frame.
        """
        q = self.logged_q(poses)
        wrench = self.wrenches(q)
        instruments, deflection = self._instruments, self.twin.readings(q, wrench)
        samples = self.recorded(poses, wrench, deflection)
        oracle = self.twin.readings(q, instruments.true_wrench(samples.wrench))
        exact_deflections = {
            "oracle": instruments.tracker_deflection(oracle),
            "noise": instruments.tracker_deflection(deflection),
        }
        return BenchmarkData(
            samples,
            self.constants.robot(),
            exact_deflections,
            self.twin.readings,
            self.twin.joint_turn,
        )

    def logged_q(self, poses: Poses) -> FloatArray:
        """Return (n, n_joints) logged joint positions [rad or m], one row per load."""
        angle = np.deg2rad(np.rad2deg(poses.q).round(DECIMALS_DEG))
        length = (poses.q * 1000.0).round(DECIMALS_DEG) / 1000.0
        logged = np.where(self.robot.turns, angle, length)
        return np.repeat(logged, self.loads_per_pose, axis=0)

    def wrenches(self, q: FloatArray, *, block: int = 0) -> FloatArray:
        """Return (n, 6) loads at the TCP [N, N m], base frame, for (n, n_joints) q."""
        rng, payload = stream("loads", *self._key, block), self.constants.payload_kg
        if self.loads == "line":
            return line_wrenches(len(q), payload, rng)
        if self.loads == "line-hook":
            force = self.max_load_share * line_wrenches(len(q), payload, rng)[:, :3]
        else:
            force = omni_forces(len(q), payload, rng, self.max_load_share)
        lever = self.robot.forward(q).rotation @ np.array(self.constants.hook_m)
        return hook_wrenches(force, lever)

    def recorded(
        self, poses: Poses, wrench: FloatArray, deflection: FloatArray, *, block: int = 0
    ) -> Samples:
        """Record (n, 6) `wrench` and (n, 3) `deflection` [m] with the instruments."""
        rng, instruments = stream("noise", *self._key, block), self._instruments
        sensed = recorded_wrench(instruments.sensor_wrench(wrench), instruments.noise, rng)
        tracked = instruments.tracker_deflection(deflection)
        return self.rows(poses, sensed, recorded_deflection(tracked, instruments.noise, rng))

    def rows(self, poses: Poses, wrench: FloatArray, deflection: FloatArray) -> Samples:
        """Return the samples of recorded (n, 6) `wrench` and (n, 3) `deflection` [m]."""
        loads = np.arange(1, self.loads_per_pose + 1).astype(str)
        return Samples(
            q=self.logged_q(poses),
            wrench=wrench,
            deflection=deflection,
            pose_id=np.repeat(poses.pose_id, self.loads_per_pose),
            load_id=np.tile(loads, len(poses.q)),
            group=np.repeat(poses.group, self.loads_per_pose),
        )


def recorded_wrench(wrench: FloatArray, noise: Noise, rng: np.random.Generator) -> FloatArray:
    """Return (n, 6) `wrench` as recorded from the force sensor."""
    noisy = wrench + rng.normal(size=wrench.shape) * np.repeat([noise.force_N, noise.torque_Nm], 3)
    return np.hstack([noisy[:, :3].round(DECIMALS_N), noisy[:, 3:].round(DECIMALS_NM)])


def recorded_deflection(
    deflection: FloatArray, noise: Noise, rng: np.random.Generator
) -> FloatArray:
    """Return (n, 3) `deflection` [m] as recorded from two tracker readings."""
    size = (2, *deflection.shape)
    if noise.tail is None:
        readings = rng.normal(scale=noise.tracker_m, size=size)
    else:
        readings = noise.tracker_m * rng.standard_t(noise.tail, size=size)
    measured_mm = (deflection + readings[0] - readings[1]) * 1000.0
    return np.asarray(measured_mm.round(DECIMALS_MM) / 1000.0)


TOLERANCE_NM = 1e-10
"""Largest change of a torque in the last step; rounding errors are about 1e-13 N m."""
MAX_ITERATIONS = 100


def no_equilibrium(change: FloatArray, q: FloatArray, wrench: FloatArray) -> DataError:
    """Return an error that names the worst of (n, n_joints) q and (n, 6) wrench.

    `change` (n,) is the last change of a torque, N m.
    """
    worst = int(np.argmax(~(change < TOLERANCE_NM)))  # NaN counts as no equilibrium
    return DataError(
        f"no elastic equilibrium at q = {np.rad2deg(q[worst]).round(3)} deg under the "
        f"wrench {wrench[worst].round(3)}: the load is too large for these springs"
    )


class Equilibrium(NamedTuple):
    """Equilibrium of springs, load and weight; elastic coordinates joint by joint.

    Attributes:
        theta: (n, 3 n_joints) elastic coordinates, rad: torsion and two tilts per joint; m along a
            prismatic joint.
        torque: (n, 3 n_joints) torque on the springs, N m, or N.
        tcp: (n, 3) TCP of the deformed robot, base frame, m.
    """

    theta: FloatArray
    torque: FloatArray
    tcp: FloatArray


class DigitalTwin:
    """A robot of given elasticity that can be loaded and read.

    Args:
        robot: rigid kinematics, masses and TCP.
        springs: one entry per joint, base to tip, of the joint's kind.
        beams: bending links; None: rigid links.
        hysteresis: every load takes up the lost motion again, see `SpringLaw`.
    """

    def __init__(
        self,
        robot: Robot,
        springs: Sequence[JointSprings | SlideSprings],
        *,
        beams: Beams | None = None,
        hysteresis: bool = False,
    ) -> None:
        """Build the elastic chain."""
        self.robot, self._beams, self._hysteresis = robot, beams, hysteresis
        self._chain = ElasticChain(robot)
        self._law = SpringLaw(springs)

    def readings(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the TCP's displacements under one load per pose, without noise.

        Args:
            q: (n, n_joints) commanded joint angles, rad.
            wrench: (n, 6) load at the TCP, force [N] then torque [N m], base frame.

        Returns:
            (n, 3) loaded minus unloaded TCP position, m, base frame.

        Raises:
            DataError: no equilibrium was found (the load is too large).
        """
        unloaded = self.equilibrium(q, np.zeros_like(wrench))
        loaded = self.equilibrium(q, wrench, unloaded.torque if self._hysteresis else None)
        moved = loaded.tcp - unloaded.tcp
        if self._beams is not None:
            moved = moved + self._beams.displacement(q, wrench)[:, :3]
        return moved

    def joint_turn(self, torque: FloatArray) -> FloatArray:
        """Return the (n, n_joints) turn [rad] (slide [m]) of unloaded joints under `torque`.

        `torque` (n, n_joints) [N m or N] loads each joint about, or along, its axis.
        """
        on_springs = np.zeros((3 * torque.shape[1], len(torque)))
        on_springs[::3] = torque.T
        turning = np.zeros_like(on_springs) if self._hysteresis else None
        return self._law.angle(on_springs, turning)[::3].T

    def equilibrium(
        self, q: FloatArray, wrench: FloatArray, turning: FloatArray | None = None
    ) -> Equilibrium:
        """Return the equilibrium under gravity and `wrench`; errors as `readings`.

        Args:
            q: (n, n_joints) commanded joint angles, rad.
            wrench: (n, 6) load at the TCP, N and N m, base frame.
            turning: (n, 3 n_joints) torque on the springs at the turning points, N m. None: this
                equilibrium is the turning point if there is hysteresis.
        """
        q_columns, load = q.T.copy(), wrench.T.copy()  # one sample per column, see `ElasticChain`
        theta = np.zeros((3 * len(q_columns), len(q)))
        torque, tcp = self._chain.statics(q_columns, theta, load)
        for _ in range(MAX_ITERATIONS):
            current_torque = torque if self._hysteresis else None
            previous_torque = torque
            theta = self._law.angle(torque, current_torque if turning is None else turning.T)
            torque, tcp = self._chain.statics(q_columns, theta, load)
            change = np.abs(torque - previous_torque).max(axis=0)
            if (change < TOLERANCE_NM).all():
                return Equilibrium(theta.T, torque.T, tcp.T)
        raise no_equilibrium(change, q, wrench)
