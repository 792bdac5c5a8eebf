"""Ten robots of one type: the constants of a twin, drawn within manufacturing scatter."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from stiff_datasets.springs import JointSprings
from stiff_datasets.streams import stream
from stiff_datasets.twin_constants import Scatter, TwinConstants

LAST_SPECIMEN = 9
SpecimenNumber = Annotated[int, Ge(0), Le(LAST_SPECIMEN)]


def specimen_springs(constants: TwinConstants, specimen: int) -> tuple[JointSprings, ...]:
    """Return the joint springs of one robot of a type.

    Number 0 has the constants as they stand; the others differ from it by log-normal factors
    whose standard deviations are `Scatter`'s. Links, masses and the TCP are alike in all: what
    they differ by in production changes a deflection by a thousandth.
    """
    if specimen == 0:
        return constants.springs
    rng = stream("specimen", constants.name, specimen)
    return tuple(_drawn(joint, constants.scatter, rng) for joint in constants.springs)


def _drawn(joint: JointSprings, scatter: Scatter, rng: np.random.Generator) -> JointSprings:
    deviations = (scatter.gear, scatter.structure, scatter.tilting, scatter.tilting)
    gear, structure, *tilting, lost_motion = np.exp(
        rng.normal(size=5) * np.array([*deviations, scatter.lost_motion])
    ).tolist()
    first, second, third = (slope * gear for slope in joint.gear.slopes)
    return JointSprings(
        gear=replace(joint.gear, slopes=(first, second, third)),
        structure=joint.structure * structure,
        tilting=(joint.tilting[0] * tilting[0], joint.tilting[1] * tilting[1]),
        lost_motion=joint.lost_motion * lost_motion,
    )
