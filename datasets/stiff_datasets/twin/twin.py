"""An experiment on a digital twin: loads, readings with the instruments' noise, records.

Records are rounded as a log would be, and more coarsely than rounding errors, so that machines
agree on the data's hash.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from annotated_types import Ge

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
    SpecimenNumber,
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
    NO_EFFECTS,
    Instruments,
    parse_effects,
    real_robot,
)
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Robot, Samples

DECIMALS_DEG, DECIMALS_N, DECIMALS_NM, DECIMALS_MM = 4, 3, 5, 5


@dataclass(eq=False)
class TwinExperiment:
    """A twin's measurement.

    Attributes:
        constants: of the twin.
        loads: how the wrenches lie.
        specimen: which robot of the type.
        seed: draws loads and noise; the robot does not depend on it.
        loads_per_pose: how many.
        physics: "rigid": no bearing tilts, and the links bend; all random numbers are the same.
        effects: what it has beyond the default twin, see `twin_effects.py`.
        heaviest: the largest pull at a hook, over the payload.
        twin: the robot.

    Raises:
        DataError: the links are to bend, and `constants` have no beams.
    """

    constants: TwinConstants
    _: KW_ONLY
    loads: LoadKind = "omni"
    specimen: int
    seed: int
    loads_per_pose: int = 1
    physics: TwinPhysics = "tilting"
    effects: Collection[str] = ()
    heaviest: float = 1.0

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
        asked = LINKS in self.effects or is_rigid
        self.twin = DigitalTwin(
            robot,
            springs,
            beams=specimen_beams(constants, robot, specimen, asked=asked),
            hysteresis=HYSTERESIS in self.effects,
        )
        # "line" and "line-hook" share their forces: only what the torques do differs
        loads = self.loads.split("-")[0]
        self._key = (constants.name, loads, self.loads_per_pose, specimen, self.seed)

    def samples(self, poses: Poses, *, block: int = 0) -> Samples:
        """Measure every load at each of the poses, pose by pose.

        Args:
            poses: where.
            block: another number gives other loads and noise.

        Raises:
            DataError: a load is beyond the twin.
        """
        q = self.logged_q(poses)
        wrench = self.wrenches(q, block=block)
        return self.recorded(poses, wrench, self.twin.readings(q, wrench), block=block)

    def measured(self, poses: Poses) -> BenchmarkData:
        """Return `samples` with the robot and with what the twin knows; error as `samples`.

        "oracle" is what the twin itself predicts from the recorded joint angles and wrenches,
        "noise" what the tracker would have shown without noise. Asked again, it answers by
        `DigitalTwin.readings`: in its true base frame, whichever frame the tracker has.
        """
        q = self.logged_q(poses)
        wrench = self.wrenches(q)
        shown, deflection = self._instruments, self.twin.readings(q, wrench)
        samples = self.recorded(poses, wrench, deflection)
        oracle = self.twin.readings(q, shown.true_wrench(samples.wrench))
        known = {
            "oracle": shown.shown_deflection(oracle),
            "noise": shown.shown_deflection(deflection),
        }
        return BenchmarkData(
            samples, self.constants.robot(), known, self.twin.readings, self.twin.joint_turn
        )

    def logged_q(self, poses: Poses) -> FloatArray:
        """Return (n, n_joints) joint positions [rad or m] as a log holds them, a row a load."""
        angle = np.deg2rad(np.rad2deg(poses.q).round(DECIMALS_DEG))
        length = (poses.q * 1000.0).round(DECIMALS_DEG) / 1000.0
        logged = np.where(self.twin.robot.turns, angle, length)
        return np.repeat(logged, self.loads_per_pose, axis=0)

    def wrenches(self, q: FloatArray, *, block: int = 0) -> FloatArray:
        """Return (n, 6) the loads that act at the TCP [N, N m], base frame, at (n, n_joints) q."""
        rng, payload = stream("loads", *self._key, block), self.constants.payload_kg
        if self.loads == "line":
            return line_wrenches(len(q), payload, rng)
        if self.loads == "line-hook":
            force = self.heaviest * line_wrenches(len(q), payload, rng)[:, :3]
        else:
            force = omni_forces(len(q), payload, rng, self.heaviest)
        lever = self.twin.robot.forward(q).rotation @ np.array(self.constants.hook_m)
        return hook_wrenches(force, lever)

    def recorded(
        self, poses: Poses, wrench: FloatArray, deflection: FloatArray, *, block: int = 0
    ) -> Samples:
        """Return what the instruments show of (n, 6) `wrench` and (n, 3) `deflection` [m]."""
        rng, shown = stream("noise", *self._key, block), self._instruments
        loads = np.arange(1, self.loads_per_pose + 1).astype(str)
        return Samples(
            q=self.logged_q(poses),
            wrench=recorded_wrench(shown.shown_wrench(wrench), shown.noise, rng),
            deflection=recorded_deflection(shown.shown_deflection(deflection), shown.noise, rng),
            pose_id=np.repeat(poses.pose_id, self.loads_per_pose),
            load_id=np.tile(loads, len(poses.q)),
            group=np.repeat(poses.group, self.loads_per_pose),
        )


def recorded_wrench(wrench: FloatArray, noise: Noise, rng: np.random.Generator) -> FloatArray:
    """Return (n, 6) `wrench` as the force sensor shows it."""
    noisy = wrench + rng.normal(size=wrench.shape) * np.repeat([noise.force_N, noise.torque_Nm], 3)
    return np.hstack([noisy[:, :3].round(DECIMALS_N), noisy[:, 3:].round(DECIMALS_NM)])


def recorded_deflection(
    deflection: FloatArray, noise: Noise, rng: np.random.Generator
) -> FloatArray:
    """Return (n, 3) `deflection` [m] as the difference of two tracker readings."""
    size = (2, *deflection.shape)
    if noise.tail is None:
        readings = rng.normal(scale=noise.tracker_m, size=size)
    else:
        readings = noise.tracker_m * rng.standard_t(noise.tail, size=size)
    measured_mm = (deflection + readings[0] - readings[1]) * 1000.0
    return np.asarray(measured_mm.round(DECIMALS_MM) / 1000.0)


@dataclass(kw_only=True, eq=False)
class TwinData:
    """A twin's data set, another one for each specimen and seed.

    Attributes:
        specimen: one of ten robots of the type; 0 has the nominal constants.
        seed: draws loads, noise and poses that are not planned; the robot itself does not depend
            on it.
        physics: "tilting": bearings tilt as the twin's file says, and links bend where `effects`
            names them; "rigid": no bearing tilts, and the links bend. Poses, loads and noise are
            the same.
        effects: hysteresis, links, kinematics and sensor, separated by commas, or "none"; each is
            described in `twin_effects.py`.
    """

    specimen: SpecimenNumber = 0
    seed: Annotated[int, Ge(0)] = 0
    physics: TwinPhysics = "tilting"

    effects = NO_EFFECTS
    added_later: ClassVar[tuple[str, ...]] = ("physics",)

    def __post_init__(self) -> None:
        """Refuse an unknown effect with a ConfigError."""
        parse_effects(self.effects)

    def measured(self, constants: TwinConstants, poses: Poses, **how: Any) -> BenchmarkData:
        """Return the samples of this specimen and seed at the poses, pose by pose.

        `how` is what else a `TwinExperiment` is made of.
        """
        experiment = TwinExperiment(
            constants,
            specimen=self.specimen,
            seed=self.seed,
            physics=self.physics,
            effects=parse_effects(self.effects),
            **how,
        )
        return experiment.measured(poses)


TOLERANCE_NM = 1e-10
"""What a torque may still change by in the last step; rounding leaves about 1e-13 N m."""
MAX_ITERATIONS = 100


class Equilibrium(NamedTuple):
    """The balance of springs, load and weight; elastic coordinates joint by joint.

    Attributes:
        theta: (n, 3 n_joints) elastic coordinates, rad: torsion and two tilts a joint; m along a
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
        springs: one entry a joint, base to tip, of the joint's kind.
        beams: links that bend; None: they are rigid.
        hysteresis: lost motion is taken up anew by every load, see `SpringLaw`.
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
        """Return the TCP's displacements by one load a pose, without measurement noise.

        Args:
            q: (n, n_joints) commanded joint angles, rad.
            wrench: (n, 6) load at the TCP, force [N] then torque [N m], base frame.

        Returns:
            (n, 3) loaded minus unloaded TCP position, m, base frame.

        Raises:
            DataError: no equilibrium was found (the load is beyond the model).
        """
        unloaded = self.equilibrium(q, np.zeros_like(wrench))
        loaded = self.equilibrium(q, wrench, unloaded.torque if self._hysteresis else None)
        moved = loaded.tcp - unloaded.tcp
        if self._beams is not None:
            moved = moved + self._beams.displacement(q, wrench)[:, :3]
        return moved

    def joint_turn(self, torque: FloatArray) -> FloatArray:
        """Return the (n, n_joints) turn [rad] (slide [m]) of joints that nothing loads before.

        `torque` (n, n_joints) [N m or N] then loads each joint about, or along, its axis.
        """
        on_springs = np.zeros((3 * torque.shape[1], len(torque)))
        on_springs[::3] = torque.T
        turning = np.zeros_like(on_springs) if self._hysteresis else None
        return self._law.angle(on_springs, turning)[::3].T

    def equilibrium(
        self, q: FloatArray, wrench: FloatArray, turning: FloatArray | None = None
    ) -> Equilibrium:
        """Return the balance of the joints under gravity and `wrench`; errors as `readings`.

        Args:
            q: (n, n_joints) commanded joint angles, rad.
            wrench: (n, 6) load at the TCP, N and N m, base frame.
            turning: (n, 3 n_joints) torque on the springs at the turning points, N m. None: the
                turning point itself, where there is hysteresis.
        """
        q_columns, load = q.T.copy(), wrench.T.copy()  # a sample a column, as `ElasticChain`
        theta = np.zeros((3 * len(q_columns), len(q)))
        torque, tcp = self._chain.statics(q_columns, theta, load)
        for _ in range(MAX_ITERATIONS):
            here = torque if self._hysteresis else None
            before = torque
            theta = self._law.angle(torque, here if turning is None else turning.T)
            torque, tcp = self._chain.statics(q_columns, theta, load)
            change = np.abs(torque - before).max(axis=0)
            if (change < TOLERANCE_NM).all():
                return Equilibrium(theta.T, torque.T, tcp.T)
        worst = int(np.argmax(~(change < TOLERANCE_NM)))  # NaN is no balance either
        raise DataError(
            f"no elastic equilibrium at q = {np.rad2deg(q[worst]).round(3)} deg under the "
            f"wrench {wrench[worst].round(3)}: the load is too large for these springs"
        )
