"""Which data sets are of one robot: what counts once where robots are counted.

Loads, sensors, noise and splits may differ between two data sets; if they were made on one robot,
they say nothing on another one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from stiff_bench.analysis.collected import Contest
from stiff_bench.store.names import ContestName, grouped, join_word, split_word
from stiff_bench.tables.units import counted

SPECIMEN = "specimen"
_REPEATS = ("seed",)
_SAME_TYPE = ("seed", SPECIMEN)


@dataclass(frozen=True)
class Robot:
    """One robot, whichever data sets were made on it.

    Attributes:
        type: name of the robot.
        specimen: which robot of the type; "" where the data do not tell several apart.
    """

    type: str
    specimen: str = ""

    @property
    def text(self) -> str:
        """Type and number, for people."""
        return f"{self.type} specimen {self.specimen}" if self.specimen else self.type


def robots_of(
    contests: Iterable[Contest], robot_name: Callable[[str], str]
) -> dict[ContestName, Robot]:
    """Return the robot that each contest's data were made on.

    Data without a specimen are of one robot for each robot name. Equal data are of one robot,
    whatever their names say.

    Args:
        contests: of one folder.
        robot_name: name of the robot in the data with a hash.
    """
    contests = list(contests)
    of_data = grouped(contests, lambda contest: contest.name.data_sha256)
    robots = {
        sha256: Robot(
            robot_name(sha256),
            max(str(one.options("dataset").get(SPECIMEN, "")) for one in members),
        )
        for sha256, members in of_data.items()
    }
    return {contest.name: robots[contest.name.data_sha256] for contest in contests}


def of_robots(families: Mapping[Robot, Sequence[str]]) -> str:
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


def dataset_of(name: str) -> str:
    """Return a data set's name without the option that only repeats it."""
    return _without(name, _REPEATS)


def family_of(name: str) -> str:
    """Return a data set's name without the options that make another robot of its type."""
    return _without(name, _SAME_TYPE)


def _without(name: str, options: Sequence[str]) -> str:
    key, settings = split_word(name)
    return join_word(key, [one for one in settings if one.partition("=")[0] not in options])


def of_families(datasets: Sequence[str]) -> str:
    """Return how many data sets of which family, e.g. "5 x kr10-twin, ur5"."""
    return ", ".join(
        members[0] if len(members) == 1 else f"{len(members)} x {family}"
        for family, members in grouped(datasets, family_of).items()
    )
