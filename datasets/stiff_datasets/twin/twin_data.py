"""Define the options that the data sets of all twins have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge

from stiff_datasets.planning.poses import Poses
from stiff_datasets.twin.constants import SpecimenNumber, TwinConstants, TwinPhysics
from stiff_datasets.twin.effects import World
from stiff_datasets.twin.twin import TwinExperiment
from stiff_datasets.twin.twin_effects import NO_EFFECTS, parse_effects
from stiff_datasets.twin.world_twin import Approach, WorldExperiment
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import BenchmarkData

ADDED_LATER = ("physics", "world", "approach")
"""Options that fits of older versions do not name."""


@dataclass(kw_only=True, eq=False)
class TwinData:
    """A twin's data set; each specimen and seed gives another.

    Attributes:
        specimen: one of ten robots of the type; 0 has the nominal constants.
        seed: draws loads, noise and poses that are not planned; the robot itself does not depend
            on it.
        physics: "tilting": bearings tilt as given in the twin's file, and links bend if `effects`
            names them; "rigid": no bearing tilts, and the links bend. Poses, loads and noise are
            the same.
        world: effects of robot and measurement, see `effects.py`: "clean", "friction", "structure",
            "workshop", or "all"; "none": the twin of version 0.2, with `physics` and `effects`.
        approach: how a pose is reached in a world with friction: "random", "one-sided", or
            "cycled" (the first load is put on and off once before its reading).
        effects: hysteresis, links, kinematics and sensor, separated by commas, or "none"; each is
            described in `twin_effects.py`.
    """

    specimen: SpecimenNumber = 0
    seed: Annotated[int, Ge(0)] = 0
    physics: TwinPhysics = "tilting"
    world: Literal["none", World] = "none"
    approach: Approach = "random"

    effects = NO_EFFECTS
    added_later: ClassVar[tuple[str, ...]] = ADDED_LATER

    def __post_init__(self) -> None:
        """Raise a ConfigError for an unknown effect, or for `physics` together with a world."""
        parse_effects(self.effects)
        if self.world != "none" and self.physics != "tilting":
            raise ConfigError(f"physics={self.physics} does not go with world={self.world}")

    def measured(self, constants: TwinConstants, poses: Poses, **options: Any) -> BenchmarkData:
        """Return the samples of this specimen and seed at the poses, pose by pose.

        `options` are further arguments of `TwinExperiment`.
        """
        return self.experiment(constants, self.effects, **options).measured(poses)

    def experiment(
        self, constants: TwinConstants, effects: str = NO_EFFECTS, **options: Any
    ) -> TwinExperiment:
        """Return the experiment; `options` are further arguments of `TwinExperiment`.

        `twin_effects.py` explains `effects`; a world replaces them.
        """
        options |= {"specimen": self.specimen, "seed": self.seed}
        if self.world != "none":
            return WorldExperiment(constants, world=self.world, approach=self.approach, **options)
        chosen_effects = parse_effects(effects)
        return TwinExperiment(constants, physics=self.physics, effects=chosen_effects, **options)
