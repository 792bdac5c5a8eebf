"""The SIMULATED KUKA KR10 R1100-2: five data sets of three digital twins.

Nothing here was measured. Every constant stands in `twins/kr10_*.toml` with its source or the word
"assumption"; what the paper leaves open about poses and loads is decided in `poses.py` and
`loads.py`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from typing import Annotated, Literal, NamedTuple

from annotated_types import Ge

from stiff_datasets.planning.loads import LoadKind
from stiff_datasets.planning.poses import Poses, bent_wrist_poses, paper_poses
from stiff_datasets.robots.robot import ChainModel
from stiff_datasets.twin.constants import SpecimenNumber, TwinConstants, shipped_constants
from stiff_datasets.twin.effects import ALL_EFFECTS, parse_effects
from stiff_datasets.twin.twin import TwinData
from stiff_protocols.contract.types import BenchmarkData


class Calibration(NamedTuple):
    """A default twin whose VJM errors were brought near the source paper's.

    Attributes:
        constants: name of its file.
        poses: the paper's plan; what it leaves open about A5 is decided twice.
    """

    constants: str
    poses: Callable[[ChainModel], Poses]


CALIBRATIONS = {
    1: Calibration("kr10_r1100_2", paper_poses),
    2: Calibration("kr10_r1100_2_calibration_2", bent_wrist_poses),
}
CalibrationNumber = Literal[1, 2]
Torques = Literal["table-5", "hook"]


class PaperTwin(TwinData, ABC):
    """A twin at the 151 planned poses, loads along the line of the source paper's Table 5.

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
        poses = self.poses(constants.chain())
        return self.measured(constants, poses, loads, self.loads_per_pose, self.effects)

    @abstractmethod
    def constants(self) -> TwinConstants:
        """Read the twin's constants."""

    def poses(self, chain: ChainModel) -> Poses:
        """Return the planned poses."""
        return paper_poses(chain)


class Kr10Twin(PaperTwin):
    """The default twin, one load a pose.

    Attributes:
        calibration: 1, or 2: nearer to the paper, with a bent wrist and a tracker that has heavy
            tails (see the data card).
    """

    added_later = ("calibration",)

    def __init__(
        self,
        *,
        specimen: SpecimenNumber = 0,
        calibration: CalibrationNumber = 1,
        torques: Torques = "table-5",
        seed: Annotated[int, Ge(0)] = 0,
    ) -> None:
        """Store the options."""
        super().__init__(specimen=specimen, torques=torques, seed=seed)
        self.calibration = calibration

    def constants(self) -> TwinConstants:
        """Read the constants of the calibration."""
        return shipped_constants(CALIBRATIONS[self.calibration].constants)

    def poses(self, chain: ChainModel) -> Poses:
        """Return the poses of the calibration."""
        return CALIBRATIONS[self.calibration].poses(chain)


class Kr10TwinMultiload(Kr10Twin):
    """The same with five loads a pose; a fair split keeps them together."""

    loads_per_pose = 5


class Kr10TwinRough(PaperTwin):
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


class Kr10TwinBeam(PaperTwin):
    """The default twin's poses and loads on a robot of linear joints whose links are beams."""

    def constants(self) -> TwinConstants:
        """Read the twin's constants."""
        return shipped_constants("kr10_beam")


class Kr10TwinOmni(TwinData):
    """The 151 planned poses, one load a pose: any direction, up to the payload, at a hook.

    Attributes:
        calibration: as that of `Kr10Twin`.
    """

    added_later = ("calibration",)

    def __init__(
        self,
        *,
        specimen: SpecimenNumber = 0,
        calibration: CalibrationNumber = 1,
        seed: Annotated[int, Ge(0)] = 0,
    ) -> None:
        """Store the options."""
        super().__init__(specimen=specimen, seed=seed)
        self.calibration = calibration

    def load(self) -> BenchmarkData:
        """Simulate the measurement (well under a second)."""
        chosen = CALIBRATIONS[self.calibration]
        constants = shipped_constants(chosen.constants)
        return self.measured(constants, chosen.poses(constants.chain()))
