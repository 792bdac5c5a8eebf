"""Simulate an experiment on a digital twin: loads, noisy readings, records.

Records are rounded like a log. The steps are coarser than rounding errors, so that the data's hash
is the same on every machine.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Literal, NamedTuple

import numpy as np

from stiff_datasets.planning.loads import (
    LoadKind,
    hook_wrenches,
    line_wrenches,
    omni_forces,
    stream,
)
from stiff_datasets.planning.poses import Poses
from stiff_datasets.twin.effects import World
from stiff_datasets.twin.twin import DigitalTwin
from stiff_datasets.twin.twin_file import Noise, TwinConstants
from stiff_protocols.contract.types import DRAWN, TRUTH, BenchmarkData, FloatArray, Samples

DECIMALS_DEG, DECIMALS_N, DECIMALS_NM, DECIMALS_MM = 4, 3, 5, 5


Approach = Literal["random", "one-sided", "cycled"]
"""How a pose is reached: from a side drawn for each joint and pose; always from the same side; or
as random, with the first load put on and off once before its reading."""


class Measurement(NamedTuple):
    """Samples, and what a file of samples does not have; rows as the samples.

    Attributes:
        samples: samples.
        noiseless: (n, 3) readings without noise and errors, m.
        after: (n, 3) readings of the unloaded robot after the load, minus those before it, m.
        direction: (n, n_joints) signs of the motion that ended at the pose.
    """

    samples: Samples
    noiseless: FloatArray
    after: FloatArray
    direction: FloatArray


@dataclass(eq=False)
class TwinExperiment:
    """A twin's measurement.

    Attributes:
        constants: constants of the twin.
        loads: kind of the wrenches.
        specimen: number of the robot of the type.
        seed: draws loads, noise and approach; the robot does not depend on it.
        loads_per_pose: number of loads per pose, one after the other.
        world: name of the world.
        approach: how each pose is reached.
        max_load_share: largest pull at a hook, relative to the payload.
        twin: the robot in its world.

    Raises:
        DataError: the links have to bend, and `constants` have no beams.
    """

    constants: TwinConstants
    _: KW_ONLY
    loads: LoadKind = "omni"
    specimen: int
    seed: int
    loads_per_pose: int = 1
    world: World = "clean"
    approach: Approach = "random"
    max_load_share: float = 1.0

    def __post_init__(self) -> None:
        """Draw the robot."""
        self.twin = DigitalTwin.in_world(self.constants, self.specimen, self.world)
        self._robot = self.twin.description

    def samples(self, poses: Poses, *, block: int = 0) -> Samples:
        """Measure every load at each of the poses, pose by pose.

        Args:
            poses: the poses.
            block: another number gives other loads, noise and approach.

        Raises:
            DataError: a load is too large for the twin.
        """
        return self.measurement(poses, block).samples

    def measured(self, poses: Poses) -> BenchmarkData:
        """Return `samples` with the robot and what only the simulation knows; error as `samples`.

        The truth is for the wrench as each row writes it, at the TCP of the description. "drawn" is
        the same in the drawn state of friction. "oracle" is the twin's own prediction from the
        recorded joint angles and wrenches, "noise" the tracker's reading without noise and errors.
        """
        twin, n = self.twin, self.loads_per_pose
        samples, noiseless, _, direction = self.measurement(poses)
        bounds = {
            TRUTH: twin.truth(samples.q, samples.wrench),
            "oracle": twin.oracle(samples.q, samples.wrench),
            "noise": noiseless,
        }
        if twin.has_friction:
            drawn = twin.readings(
                samples.q[::n],
                samples.wrench.reshape(-1, n, 6),
                direction[::n],
                cycled=self.approach == "cycled",
            )
            bounds[DRAWN] = drawn.tcp.reshape(-1, 3)
        return BenchmarkData(samples, twin.description, bounds, twin.truth, twin.joint_turn)

    def logged_q(self, poses: Poses) -> FloatArray:
        """Return (n, n_joints) logged joint positions [rad or m], one row per load."""
        angle = np.deg2rad(np.rad2deg(poses.q).round(DECIMALS_DEG))
        length = (poses.q * 1000.0).round(DECIMALS_DEG) / 1000.0
        logged = np.where(self._robot.turns, angle, length)
        return np.repeat(logged, self.loads_per_pose, axis=0)

    def stream(self, purpose: str, block: int = 0) -> np.random.Generator:
        """Return the random numbers of "loads", "approach" or "noise"."""
        loads = self.loads.split("-")[0]  # line and line-hook share their forces
        key = (self.constants.name, loads, self.loads_per_pose, self.specimen, self.seed)
        return stream(purpose, *key, block)

    def wrenches(self, q: FloatArray, *, block: int = 0) -> FloatArray:
        """Return (n, 6) loads at the TCP [N, N m], base frame, for (n, n_joints) q."""
        rng, payload = self.stream("loads", block), self.constants.payload_kg
        if self.loads == "line":
            return line_wrenches(len(q), payload, rng)
        if self.loads == "line-hook":
            force = self.max_load_share * line_wrenches(len(q), payload, rng)[:, :3]
        else:
            force = omni_forces(len(q), payload, rng, self.max_load_share)
        lever = self._robot.forward(q).rotation @ np.array(self.constants.hook_m)
        return hook_wrenches(force, lever)

    def measurement(self, poses: Poses, block: int = 0) -> Measurement:
        """Measure every load at each of the poses, pose by pose."""
        twin, n = self.twin, self.loads_per_pose
        q = self.logged_q(poses)
        wrench = self.wrenches(q, block=block)
        rng = self.stream("approach", block)
        direction = rng.choice([-1.0, 1.0], (len(poses.q), q.shape[1]))
        if self.approach == "one-sided":
            direction[:] = direction[0]
        readings = twin.readings(
            q[::n],
            twin.real_wrench(q, wrench).reshape(-1, n, 6),
            direction,
            cycled=self.approach == "cycled",
        )
        noiseless = twin.tracked(readings.point.reshape(-1, 3))
        rng, noise = self.stream("noise", block), self.constants.noise
        for effect in twin.effects:
            noise = effect.noise(noise)
        sensed = wrench
        for effect in twin.effects:
            sensed = effect.sensed(sensed)
        recorded = recorded_wrench(sensed, noise, rng)
        pose = np.repeat(np.arange(len(poses.q)), n)
        errors = sum(
            (effect.reading_errors(pose, len(q), rng) for effect in twin.effects), 0.0 * noiseless
        )
        deflection = recorded_deflection(noiseless + errors, noise, rng)
        samples = self.rows(poses, recorded, deflection)
        remaining = twin.tracked(readings.remaining.reshape(-1, 3))
        after = recorded_deflection(remaining, noise, rng)
        return Measurement(samples, noiseless, after, np.repeat(direction, n, axis=0))

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
