"""An experiment on a digital twin: loads, readings with the instruments' noise, records.

Records are rounded as a log would be, and more coarsely than rounding errors, so that machines
agree on the data's hash.
"""

from __future__ import annotations

import numpy as np

from stiff_datasets.loads import LoadKind, hook_wrenches, line_wrenches, omni_forces
from stiff_datasets.poses import Poses
from stiff_datasets.specimen import specimen_springs
from stiff_datasets.streams import stream
from stiff_datasets.twin import DigitalTwin
from stiff_datasets.twin_constants import Noise, TwinConstants
from stiff_protocols.types import BenchmarkData, FloatArray, Samples

DECIMALS_DEG, DECIMALS_N, DECIMALS_NM, DECIMALS_MM = 4, 3, 5, 5


class TwinExperiment:
    """A twin's measurement.

    Args:
        constants: of the twin.
        loads: how the wrenches lie.
        specimen: which robot of the type.
        seed: draws loads and noise; the robot does not depend on it.
        loads_per_pose: how many.

    Attributes:
        twin: the robot.
    """

    def __init__(
        self,
        constants: TwinConstants,
        *,
        loads: LoadKind,
        specimen: int,
        seed: int,
        loads_per_pose: int = 1,
    ) -> None:
        """Build the twin."""
        self._constants = constants
        self._loads = loads
        self._loads_per_pose = loads_per_pose
        self.twin = DigitalTwin(constants.chain(), specimen_springs(constants, specimen))
        # "line" and "line-hook" share their forces: only what the torques do differs
        self._key = (constants.name, loads.split("-")[0], loads_per_pose, specimen, seed)

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

    def logged_q(self, poses: Poses) -> FloatArray:
        """Return (n, n_joints) joint angles [rad] as a log holds them, a row a load."""
        logged = np.deg2rad(np.rad2deg(poses.q).round(DECIMALS_DEG))
        return np.repeat(logged, self._loads_per_pose, axis=0)

    def wrenches(self, q: FloatArray, *, block: int = 0) -> FloatArray:
        """Return (n, 6) the loads that act at the TCP [N, N m], base frame, at (n, n_joints) q."""
        rng, payload = stream("loads", *self._key, block), self._constants.payload_kg
        if self._loads == "line":
            return line_wrenches(len(q), payload, rng)
        if self._loads == "line-hook":
            force = line_wrenches(len(q), payload, rng)[:, :3]
        else:
            force = omni_forces(len(q), payload, rng)
        return hook_wrenches(force, self.twin.tool_vectors(q, self._constants.hook_m))

    def recorded(
        self, poses: Poses, wrench: FloatArray, deflection: FloatArray, *, block: int = 0
    ) -> Samples:
        """Return what the instruments show of (n, 6) `wrench` and (n, 3) `deflection` [m]."""
        rng, noise = stream("noise", *self._key, block), self._constants.noise
        loads = np.arange(1, self._loads_per_pose + 1).astype(str)
        return Samples(
            q=self.logged_q(poses),
            wrench=recorded_wrench(wrench, noise, rng),
            deflection=recorded_deflection(deflection, noise, rng),
            pose_id=np.repeat(poses.pose_id, self._loads_per_pose),
            load_id=np.tile(loads, len(poses.q)),
            group=np.repeat(poses.group, self._loads_per_pose),
        )


def measure_poses(
    constants: TwinConstants,
    poses: Poses,
    *,
    loads: LoadKind,
    loads_per_pose: int,
    specimen: int,
    seed: int,
) -> BenchmarkData:
    """Return the samples of `loads_per_pose` loads at each of the poses, pose by pose."""
    experiment = TwinExperiment(
        constants, loads=loads, specimen=specimen, seed=seed, loads_per_pose=loads_per_pose
    )
    return BenchmarkData(experiment.samples(poses), constants.robot())


def recorded_wrench(wrench: FloatArray, noise: Noise, rng: np.random.Generator) -> FloatArray:
    """Return (n, 6) `wrench` as the force sensor shows it."""
    noisy = wrench + rng.normal(size=wrench.shape) * np.repeat([noise.force_N, noise.torque_Nm], 3)
    return np.hstack([noisy[:, :3].round(DECIMALS_N), noisy[:, 3:].round(DECIMALS_NM)])


def recorded_deflection(
    deflection: FloatArray, noise: Noise, rng: np.random.Generator
) -> FloatArray:
    """Return (n, 3) `deflection` [m] as the difference of two tracker readings."""
    readings = rng.normal(scale=noise.tracker_m, size=(2, *deflection.shape))
    measured_mm = (deflection + readings[0] - readings[1]) * 1000.0
    return np.asarray(measured_mm.round(DECIMALS_MM) / 1000.0)
