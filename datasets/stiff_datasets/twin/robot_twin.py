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
from stiff_datasets.twin.effects import ALL_EFFECTS, NO_EFFECTS
from stiff_datasets.twin.twin import TwinData
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
        poses = random_poses(constants, self.poses, self.seed)
        return self.measured(constants, poses, self.loads, self.loads_per_pose)


class Ur5Twin(TwinData):
    """The twin of a UR5, a smaller robot (5 kg), pulled at a hook in every direction."""

    def load(self) -> BenchmarkData:
        """Simulate the measurement."""
        constants = shipped_constants("ur5")
        return self.measured(constants, random_poses(constants, POSES, self.seed))


@dataclass(frozen=True)
class Arm:
    """A type of robot in `ArmFamily`.

    Attributes:
        name: of its URDF and of its constants.
        maker, type: the manufacturer's words.
        masses: where those of its links are from; the URDF says it in full.
    """

    name: str
    maker: str
    type: str
    masses: str


ARMS = (
    Arm("irb120_3_06", "ABB", "IRB 120-3/0.6", "public, from CAD"),
    Arm("tx60", "Stäubli", "TX60", "public, from CAD"),
    Arm("lr_mate_200id", "FANUC", "LR Mate 200iD", "scaled from KR 6 R700-2"),
    Arm("gp12", "Yaskawa", "GP12", "scaled from KR 12 R1450 HW"),
    Arm("kr16_r1610_2", "KUKA", "KR 16 R1610-2", "public; split inside the wrist"),
    Arm("m20ib_25", "FANUC", "M-20iB/25", "scaled from KR 20 R1820-2 E"),
    Arm("irb4600_40_255", "ABB", "IRB 4600-40/2.55", "scaled from KR 50 R2500"),
    Arm("kr70_r2100", "KUKA", "KR 70 R2100", "public"),
    Arm("gp180", "Yaskawa", "GP180", "scaled from KR 120 R2700-2"),
    Arm("kr240_r2900_2", "KUKA", "KR 240 R2900-2", "public"),
)
"""Numbers 0 to 9, by payload."""

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
        constants = shipped_constants(ARMS[self.robot].name)
        poses = random_poses(constants, POSES, self.seed)
        return self.measured(constants, poses, heaviest=HEAVIEST)


def random_poses(constants: TwinConstants, n: int, seed: int) -> Poses:
    """Return random reachable poses of a robot, the same for the same seed."""
    rng = stream("poses", constants.name, seed)
    q = reachable_poses(constants.robot(), n, rng, constants.clearance_m)
    names = np.array([f"P{i + 1}" for i in range(n)])
    return Poses(q=q, pose_id=names, group=np.full(n, "random"))
