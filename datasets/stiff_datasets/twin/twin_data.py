"""Define the options that the data sets of all twins have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Ge

from stiff_datasets.planning.poses import Poses
from stiff_datasets.twin.constants import SpecimenNumber, TwinConstants
from stiff_datasets.twin.effects import World
from stiff_datasets.twin.experiment import Approach, TwinExperiment
from stiff_protocols.contract.types import BenchmarkData


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
