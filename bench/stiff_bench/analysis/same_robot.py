"""Which data sets are of one robot: what counts once where robots are counted.

Loads, sensors, noise and splits may differ between two data sets; if they were made on one robot,
they say nothing on another one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stiff_bench.analysis.ranking import ScoredCase
from stiff_bench.store.names import CaseName, grouped
from stiff_bench.tables.units import counted

SEED, SPECIMEN = "seed", "specimen"
"""Options of data sets that only repeat one, and that make another robot of its type."""


@dataclass(frozen=True)
class Specimen:
    """One robot, whichever data sets were made on it.

    Attributes:
        type: name of the robot.
        number: which robot of the type; "" where the data do not tell several apart.
    """

    type: str
    number: str = ""

    @property
    def text(self) -> str:
        """Type and number, for people."""
        return f"{self.type} specimen {self.number}" if self.number else self.type


def robots_of(cases: Sequence[ScoredCase]) -> dict[CaseName, Specimen]:
    """Return the robot that each case's data were made on.

    Data without a specimen are of one robot for each robot name. Equal data are of one robot,
    whatever their names say.
    """
    robots: dict[CaseName, Specimen] = {}
    for members in grouped(cases, lambda one: one.name.data_sha256).values():
        number = max(str(one.case.cell.dataset_params.get(SPECIMEN, "")) for one in members)
        robot = Specimen(members[0].data.robot, number)
        robots |= {one.name: robot for one in members}
    return robots


def of_robots(families: Mapping[Specimen, Sequence[str]]) -> str:
    """Return how many robots, and in which data, e.g. "5 specimens of kr10-twin".

    Args:
        families: robot -> names of its data sets, without what makes another robot of its type.
    """
    parts = []
    for members in grouped(families, lambda robot: robot.type).values():
        named = " and ".join(dict.fromkeys(name for robot in members for name in families[robot]))
        parts.append(f"{len(members)} specimens of {named}" if len(members) > 1 else named)
    if len(parts) == 1 and len(families) > 1:
        return parts[0]
    return f"{counted(len(families), 'robot')}: {', '.join(parts)}"


def dataset_of(name: CaseName) -> str:
    """Return a data set's name without the option that only repeats it."""
    return name.variant.without(SEED).name


def family_of(name: CaseName) -> str:
    """Return a data set's name without the options that make another robot of its type."""
    return name.variant.without(SEED, SPECIMEN).name


def of_families(families: Mapping[str, str]) -> str:
    """Return how many data sets of which family, e.g. "5 x kr10-twin, ur5".

    Args:
        families: data set -> its family.
    """
    return ", ".join(
        members[0] if len(members) == 1 else f"{len(members)} x {family}"
        for family, members in grouped(families, families.__getitem__).items()
    )
