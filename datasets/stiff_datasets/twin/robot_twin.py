"""Simulate robots from two files: a URDF and a small TOML of joint constants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from stiff_datasets.planning.loads import LoadKind, stream
from stiff_datasets.planning.poses import Poses
from stiff_datasets.planning.reachable import reachable_poses
from stiff_datasets.twin.effects import World
from stiff_datasets.twin.experiment import Approach, TwinExperiment
from stiff_datasets.twin.twin_file import (
    SpecimenNumber,
    TwinConstants,
    read_constants,
    shipped_constants,
)
from stiff_protocols.contract.errors import warn
from stiff_protocols.contract.types import BenchmarkData

POSES = 151  # the number in the source paper
NARROW_JOINTS = (3, 5)
"""Columns of the joints at zero in the source paper's plan: A4 and A6."""
MeasuringPlan = Literal["narrow", "wide"]


@dataclass(kw_only=True, eq=False)
class TwinData:
    """A twin's data set; each specimen and seed gives another.

    Attributes:
        specimen: one of ten robots of the type; 0 has the nominal constants.
        seed: draws loads, noise, approach and poses that are not planned; the robot itself does not
            depend on it.
        world: effects of robot and measurement, see `effects.py`: "clean", "friction", "structure",
            "workshop", "all" of these three, or "unseen": effects that no model has a group for.
        approach: how a pose is reached in a world with friction: "random", "one-sided", or
            "cycled" (the first load is put on and off once before its reading).
    """

    specimen: SpecimenNumber = 0
    seed: Annotated[int, Ge(0)] = 0
    world: World = "clean"
    approach: Approach = "random"

    def measured(self, constants: TwinConstants, poses: Poses, **options: Any) -> BenchmarkData:
        """Return the samples of this specimen and seed at the poses, pose by pose.

        `options` are further arguments of `TwinExperiment`.
        """
        return self.experiment(constants, **options).measured(poses)

    def experiment(self, constants: TwinConstants, **options: Any) -> TwinExperiment:
        """Return the experiment; `options` are further arguments of `TwinExperiment`."""
        return TwinExperiment(
            constants,
            specimen=self.specimen,
            seed=self.seed,
            world=self.world,
            approach=self.approach,
            **options,
        )


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

    def load(self) -> BenchmarkData:
        """Simulate the measurement.

        Raises:
            DataError: a file is missing or invalid, or a load is too large for the twin.
        """
        constants = read_constants(self.constants)
        for note in constants.chain().notes:
            warn(note)
        poses = random_poses(constants, self.poses, self.seed)
        options = {"loads": self.loads, "loads_per_pose": self.loads_per_pose}
        return self.measured(constants, poses, **options)


@dataclass(kw_only=True, eq=False)
class HookTwin(TwinData):
    """A robot that is pulled at a hook.

    Attributes:
        plan: "wide": random poses, pulled in every direction; "narrow": random poses whose fourth
            and sixth joints stay at zero, pulled along the line of the source paper's Table 5.
    """

    plan: MeasuringPlan = "wide"

    def planned(self, constants: TwinConstants, max_load_share: float = 1.0) -> BenchmarkData:
        """Simulate the measurement, with loads up to `max_load_share` times the payload."""
        is_narrow = self.plan == "narrow"
        poses = random_poses(
            constants, POSES, self.seed, at_zero=NARROW_JOINTS if is_narrow else ()
        )
        loads: LoadKind = "line-hook" if is_narrow else "omni"
        return self.measured(constants, poses, loads=loads, max_load_share=max_load_share)


class Ur5Twin(HookTwin):
    """The twin of a UR5, a smaller robot (5 kg)."""

    def load(self) -> BenchmarkData:
        """Simulate the measurement."""
        return self.planned(shipped_constants("ur5"))


ARMS = (
    *("irb120_3_06", "tx60", "lr_mate_200id", "gp12", "kr16_r1610_2"),
    *("m20ib_25", "irb4600_40_255", "kr70_r2100", "gp180", "kr240_r2900_2"),
)
"""Names of the URDFs and of the constants, numbers 0 to 9, by payload."""

HEAVIEST = 0.8  # of the payload


@dataclass(kw_only=True, eq=False)
class ArmFamily(HookTwin):
    """The twin of one of ten types of robot, pulled with up to 80 % of its payload.

    Attributes:
        robot: 0 IRB 120, 1 TX60, 2 LR Mate 200iD, 3 GP12, 4 KR 16, 5 M-20iB/25, 6 IRB 4600,
            7 KR 70, 8 GP180, 9 KR 240.
    """

    robot: Annotated[int, Ge(0), Le(len(ARMS) - 1)] = 0
    world: World = "all"

    def load(self) -> BenchmarkData:
        """Simulate the measurement."""
        return self.planned(shipped_constants(ARMS[self.robot]), HEAVIEST)


def random_poses(
    constants: TwinConstants, n: int, seed: int, *, at_zero: Sequence[int] = ()
) -> Poses:
    """Return random reachable poses of a robot; the seed determines them.

    The joints of the columns `at_zero` stay at zero.
    """
    rng = stream("poses", constants.name, seed)
    q = reachable_poses(constants.robot(), n, rng, constants.clearance_m, at_zero)
    names = np.array([f"P{i + 1}" for i in range(n)])
    return Poses(q=q, pose_id=names, group=np.full(n, "random"))
