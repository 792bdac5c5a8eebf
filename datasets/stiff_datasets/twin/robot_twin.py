"""A SIMULATED robot from two files: its URDF and a small TOML of joint constants."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from stiff_datasets.planning.loads import LoadKind, stream
from stiff_datasets.planning.poses import Poses
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.twin.constants import TwinConstants, read_constants, shipped_constants
from stiff_datasets.twin.twin import TwinData
from stiff_datasets.twin.twin_effects import ALL_EFFECTS, NO_EFFECTS
from stiff_protocols.contract.errors import warn
from stiff_protocols.contract.types import BenchmarkData

POSES = 151  # as many as the source paper measured


@dataclass(kw_only=True, eq=False)
class RobotTwin(TwinData):
    """A robot's twin at random reachable poses.

    Attributes:
        constants: TOML file; `constants.py` lists its tables.
        poses: number of poses, inside the joint limits, clear of base and ground.
        loads: "line" (along Table 5's line, scaled to the payload), "line-hook" or "omni".
        loads_per_pose: number of loads per pose.
    """

    constants: Path
    poses: Annotated[int, Gt(0)] = POSES
    loads: LoadKind = "omni"
    loads_per_pose: Annotated[int, Gt(0)] = 1
    effects: str = NO_EFFECTS

    def load(self) -> BenchmarkData:
        """Simulate the measurement.

        Raises:
            DataError: a file is missing or wrong, or a load is beyond the twin.
        """
        constants = read_constants(self.constants)
        for note in constants.chain().notes:
            warn(note)
        poses = random_poses(constants, self.poses, self.seed)
        how = {"loads": self.loads, "loads_per_pose": self.loads_per_pose}
        return self.measured(constants, poses, **how)


class Ur5Twin(TwinData):
    """The twin of a UR5, a smaller robot (5 kg), pulled at a hook in every direction."""

    def load(self) -> BenchmarkData:
        """Simulate the measurement."""
        constants = shipped_constants("ur5")
        return self.measured(constants, random_poses(constants, POSES, self.seed))


ARMS = (
    *("irb120_3_06", "tx60", "lr_mate_200id", "gp12", "kr16_r1610_2"),
    *("m20ib_25", "irb4600_40_255", "kr70_r2100", "gp180", "kr240_r2900_2"),
)
"""Numbers 0 to 9, by payload -> names of the URDF and of the constants."""

HEAVIEST = 0.8  # of the payload


@dataclass(kw_only=True, eq=False)
class ArmFamily(TwinData):
    """The twin of one of ten types of robot, pulled at a hook up to 80 % of its payload.

    Attributes:
        robot: 0 IRB 120, 1 TX60, 2 LR Mate 200iD, 3 GP12, 4 KR 16, 5 M-20iB/25, 6 IRB 4600,
            7 KR 70, 8 GP180, 9 KR 240.
    """

    robot: Annotated[int, Ge(0), Le(len(ARMS) - 1)] = 0
    effects: str = ALL_EFFECTS

    def load(self) -> BenchmarkData:
        """Simulate the measurement."""
        constants = shipped_constants(ARMS[self.robot])
        poses = random_poses(constants, POSES, self.seed)
        return self.measured(constants, poses, heaviest=HEAVIEST)


def random_poses(constants: TwinConstants, n: int, seed: int) -> Poses:
    """Return random reachable poses of a robot, the same for the same seed."""
    rng = stream("poses", constants.name, seed)
    q = reachable_poses(constants.robot(), n, rng, constants.clearance_m)
    names = np.array([f"P{i + 1}" for i in range(n)])
    return Poses(q=q, pose_id=names, group=np.full(n, "random"))
