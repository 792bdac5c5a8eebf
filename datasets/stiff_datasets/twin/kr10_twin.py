"""The SIMULATED KUKA KR10 R1100-2: five data sets of three digital twins.

Nothing here was measured. Every constant stands in `twins/kr10_*.toml` with its source or the word
"assumption"; what the paper leaves open about poses and loads is decided in `poses.py` and
`loads.py`.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Literal

from annotated_types import Ge

from stiff_datasets.planning.loads import LoadKind
from stiff_datasets.planning.poses import paper_poses
from stiff_datasets.twin.constants import SpecimenNumber, TwinConstants, shipped_constants
from stiff_datasets.twin.effects import ALL_EFFECTS, parse_effects
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
    effects: Collection[str] = ()

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
        constants = self.constants()
        poses = paper_poses(constants.chain())
        return self.measured(constants, poses, loads, self.loads_per_pose, self.effects)

    def constants(self) -> TwinConstants:
        """Read the twin's constants."""
        return shipped_constants(CONSTANTS)


class Kr10TwinMultiload(Kr10Twin):
    """The same with five loads a pose; a fair split keeps them together."""

    loads_per_pose = 5


class Kr10TwinRough(Kr10Twin):
    """The default twin's poses and loads on a robot that no model here describes exactly.

    Attributes:
        effects: hysteresis, links, kinematics and sensor, separated by commas, or "none"; each is
            described in `effects.py`.
    """

    def __init__(
        self,
        *,
        specimen: SpecimenNumber = 0,
        effects: str = ALL_EFFECTS,
        torques: Torques = "table-5",
        seed: Annotated[int, Ge(0)] = 0,
    ) -> None:
        """Store the options; ConfigError for an unknown effect."""
        super().__init__(specimen=specimen, torques=torques, seed=seed)
        self.effects = parse_effects(effects)

    def constants(self) -> TwinConstants:
        """Read the twin's constants."""
        return shipped_constants("kr10_rough")


class Kr10TwinBeam(Kr10Twin):
    """The default twin's poses and loads on a robot of linear joints whose links are beams."""

    def constants(self) -> TwinConstants:
        """Read the twin's constants."""
        return shipped_constants("kr10_beam")


class Kr10TwinOmni(TwinData):
    """The 151 planned poses, one load a pose: any direction, up to the payload, at a hook."""

    def load(self) -> BenchmarkData:
        """Simulate the measurement (well under a second)."""
        constants = shipped_constants(CONSTANTS)
        return self.measured(constants, paper_poses(constants.chain()))
