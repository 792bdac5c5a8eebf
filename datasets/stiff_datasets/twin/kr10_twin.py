"""Simulate the KUKA KR10 R1100-2: three SIMULATED data sets of one digital twin.

No data here were measured. `twins/kr10_*.toml` lists every constant with its source or the word
"assumption". `poses.py` and `loads.py` define the poses and loads that the paper leaves open.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from stiff_datasets.planning.poses import Poses, bent_wrist_poses, paper_poses
from stiff_datasets.twin.robot_twin import POSES, MeasuringPlan, TwinData, random_poses
from stiff_datasets.twin.twin_file import TwinConstants, shipped_constants
from stiff_protocols.contract.types import BenchmarkData, Robot


class PlannedTwin(NamedTuple):
    """A twin of the KR10 and its poses.

    Attributes:
        name: name of its file of constants.
        plan: the paper's poses, with one of two choices of A5.
    """

    name: str
    plan: Callable[[Robot], Poses]

    def constants(self) -> TwinConstants:
        """Read the twin's constants."""
        return shipped_constants(self.name)

    def poses(self) -> Poses:
        """Return the planned poses, the same for every specimen."""
        return _planned(self)


@functools.cache
def _planned(twin: PlannedTwin) -> Poses:
    """Compute the poses of a twin once, which takes half a second."""
    return twin.plan(twin.constants().robot())


CALIBRATIONS = {
    1: PlannedTwin("kr10_r1100_2", paper_poses),
    2: PlannedTwin("kr10_r1100_2_calibration_2", bent_wrist_poses),
}
"""Default twins, calibrated to the source paper's VJM errors."""
CalibrationNumber = Literal[1, 2]


@dataclass(kw_only=True, eq=False)
class Kr10Twin(TwinData):
    """The default twin, one load per pose along the line of the paper's Table 5.

    Attributes:
        calibration: 1, or 2: nearer to the paper, with a bent wrist and a tracker that has heavy
            tails (see the data card).
        plan: "narrow": the paper's poses; "wide": the same number of random poses, pulled at a hook
            in every direction.
    """

    calibration: CalibrationNumber = 1
    plan: MeasuringPlan = "narrow"

    loads_per_pose = 1

    def load(self) -> BenchmarkData:
        """Simulate the measurement (well under a second)."""
        twin = CALIBRATIONS[self.calibration]
        constants, per_pose = twin.constants(), self.loads_per_pose
        if self.plan == "narrow":
            return self.measured(constants, twin.poses(), loads="line", loads_per_pose=per_pose)
        poses = random_poses(constants, POSES, self.seed)
        return self.measured(constants, poses, loads_per_pose=per_pose)


class Kr10TwinMultiload(Kr10Twin):
    """The default twin with five loads per pose; a fair split keeps them together."""

    loads_per_pose = 5


@dataclass(kw_only=True, eq=False)
class Kr10TwinOmni(TwinData):
    """The 151 planned poses, one load per pose: any direction, up to the payload, at a hook.

    Attributes:
        calibration: see `Kr10Twin`.
    """

    calibration: CalibrationNumber = 1

    def load(self) -> BenchmarkData:
        """Simulate the measurement (well under a second)."""
        twin = CALIBRATIONS[self.calibration]
        return self.measured(twin.constants(), twin.poses())
