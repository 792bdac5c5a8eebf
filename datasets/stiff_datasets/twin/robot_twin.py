"""A SIMULATED robot from two files: its URDF and a small TOML of joint constants."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from stiff_datasets.planning.loads import LoadKind, stream
from stiff_datasets.planning.poses import Poses
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.twin.constants import (
    SpecimenNumber,
    TwinConstants,
    read_constants,
    shipped_constants,
)
from stiff_datasets.twin.twin import TwinData
from stiff_protocols.contract.types import BenchmarkData

POSES = 151  # as many as the source paper measured


class RobotTwin(TwinData):
    """A robot's twin at random reachable poses.

    Attributes:
        constants: TOML file; `constants.py` lists its tables.
        poses: number of poses, inside the joint limits, clear of base and ground.
        loads: "line" (along Table 5's line, scaled to the payload), "line-hook" or "omni".
        loads_per_pose: number of loads per pose.
        seed: draws poses, loads and noise; the robot itself does not depend on it.
    """

    def __init__(
        self,
        *,
        constants: Path,
        poses: Annotated[int, Gt(0)] = POSES,
        loads: LoadKind = "omni",
        loads_per_pose: Annotated[int, Gt(0)] = 1,
        specimen: SpecimenNumber = 0,
        seed: Annotated[int, Ge(0)] = 0,
    ) -> None:
        """Store the options."""
        super().__init__(specimen=specimen, seed=seed)
        self.constants = constants
        self.poses = poses
        self.loads = loads
        self.loads_per_pose = loads_per_pose

    def load(self) -> BenchmarkData:
        """Simulate the measurement.

        Raises:
            DataError: a file is missing or wrong, or a load is beyond the twin.
        """
        constants = read_constants(self.constants)
        poses = _random_poses(constants, self.poses, self.seed)
        return self.measured(constants, poses, self.loads, self.loads_per_pose)


class Ur5Twin(TwinData):
    """The twin of a UR5, a smaller robot (5 kg), pulled at a hook in every direction.

    Attributes:
        seed: draws poses, loads and noise; the robot itself does not depend on it.
    """

    def load(self) -> BenchmarkData:
        """Simulate the measurement."""
        constants = shipped_constants("ur5")
        return self.measured(constants, _random_poses(constants, POSES, self.seed))


def _random_poses(constants: TwinConstants, n: int, seed: int) -> Poses:
    q = reachable_poses(constants.chain(), n, stream("poses", constants.name, seed))
    names = np.array([f"P{i + 1}" for i in range(n)])
    return Poses(q=q, pose_id=names, group=np.full(n, "random"))
