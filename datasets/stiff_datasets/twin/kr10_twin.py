"""The SIMULATED KUKA KR10 R1100-2: three data sets of one digital twin.

Nothing here was measured. Every constant stands in `twins/kr10_r1100_2.toml` with its source or
the word "assumption"; what the paper leaves open about poses and loads is decided in `poses.py`
and `loads.py`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge

from stiff_datasets.planning.loads import LoadKind
from stiff_datasets.planning.poses import paper_poses
from stiff_datasets.twin.constants import SpecimenNumber, shipped_constants
from stiff_datasets.twin.twin import measure_poses
from stiff_protocols.contract.types import BenchmarkData

CONSTANTS = "kr10_r1100_2"
LOADS_PER_POSE = 5  # of `kr10-twin-multiload`
Torques = Literal["table-5", "hook"]


class Kr10Twin:
    """The 151 planned poses, one load a pose along the line of the source paper's Table 5.

    Attributes:
        specimen: which of ten robots of the type; 0 has the calibrated constants.
        torques: "table-5": they lie along the line too, as in the paper's simulated loads;
            "hook": they are those of one rope that pulls at a hook (see `loads.py`).
        seed: draws the loads and the noise; the robot itself does not depend on it.
    """

    loads_per_pose = 1

    def __init__(
        self,
        *,
        specimen: SpecimenNumber = 0,
        torques: Torques = "table-5",
        seed: Annotated[int, Ge(0)] = 0,
    ) -> None:
        """Store the options."""
        self.specimen = specimen
        self.torques = torques
        self.seed = seed

    def load(self) -> BenchmarkData:
        """Simulate the measurement (well under a second)."""
        loads: LoadKind = "line" if self.torques == "table-5" else "line-hook"
        return _measured(loads, self.loads_per_pose, self.specimen, self.seed)


class Kr10TwinMultiload(Kr10Twin):
    """The same with five loads a pose; a fair split keeps them together."""

    loads_per_pose = LOADS_PER_POSE


class Kr10TwinOmni:
    """The 151 planned poses, one load a pose: any direction, up to the payload, at a hook.

    Attributes:
        specimen: which of ten robots of the type; 0 has the calibrated constants.
        seed: draws the loads and the noise; the robot itself does not depend on it.
    """

    def __init__(self, *, specimen: SpecimenNumber = 0, seed: Annotated[int, Ge(0)] = 0) -> None:
        """Store the options."""
        self.specimen = specimen
        self.seed = seed

    def load(self) -> BenchmarkData:
        """Simulate the measurement (well under a second)."""
        return _measured("omni", 1, self.specimen, self.seed)


def _measured(loads: LoadKind, loads_per_pose: int, specimen: int, seed: int) -> BenchmarkData:
    """Return the planned poses under loads of a kind."""
    constants = shipped_constants(CONSTANTS)
    return measure_poses(
        constants,
        paper_poses(constants.chain()),
        loads=loads,
        loads_per_pose=loads_per_pose,
        specimen=specimen,
        seed=seed,
    )
