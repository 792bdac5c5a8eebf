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
from stiff_datasets.twin.twin import TwinData
from stiff_protocols.contract.types import BenchmarkData

CONSTANTS = "kr10_r1100_2"
Torques = Literal["table-5", "hook"]


class Kr10Twin(TwinData):
    """The 151 planned poses, one load a pose along the line of the source paper's Table 5.

    Attributes:
        torques: "table-5": they lie along the line too, as in the paper's simulated loads;
            "hook": they are those of one cable that pulls at a hook (see `loads.py`).
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
        super().__init__(specimen=specimen, seed=seed)
        self.torques = torques

    def load(self) -> BenchmarkData:
        """Simulate the measurement (well under a second)."""
        loads: LoadKind = "line" if self.torques == "table-5" else "line-hook"
        constants = shipped_constants(CONSTANTS)
        return self.measured(constants, paper_poses(constants.chain()), loads, self.loads_per_pose)


class Kr10TwinMultiload(Kr10Twin):
    """The same with five loads a pose; a fair split keeps them together."""

    loads_per_pose = 5


class Kr10TwinOmni(TwinData):
    """The 151 planned poses, one load a pose: any direction, up to the payload, at a hook."""

    def load(self) -> BenchmarkData:
        """Simulate the measurement (well under a second)."""
        constants = shipped_constants(CONSTANTS)
        return self.measured(constants, paper_poses(constants.chain()))
