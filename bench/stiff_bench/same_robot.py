"""Which data sets are of one robot: what counts once where robots are counted.

Loads, sensors, noise and splits may differ between two data sets; if they were made on one robot,
they say nothing on another one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from stiff_bench.choice import OPTION_MARK, split_word
from stiff_bench.collected import Contest, ContestName
from stiff_bench.grouped import grouped

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


def of_types(robots: Sequence[Robot]) -> str:
    """Return how many robots of which type, e.g. "5 x kr10_r1100_2, ur5"."""
    return ", ".join(
        kind if len(members) == 1 else f"{len(members)} x {kind}"
        for kind, members in grouped(robots, lambda robot: robot.type).items()
    )


def dataset_of(name: str) -> str:
    """Return a data set's name without the option that only repeats it."""
    return _without(name, _REPEATS)


def family_of(name: str) -> str:
    """Return a data set's name without the options that make another robot of its type."""
    return _without(name, _SAME_TYPE)


def _without(name: str, options: Sequence[str]) -> str:
    key, settings = split_word(name)
    kept = [
        setting.replace(OPTION_MARK, 2 * OPTION_MARK)
        for setting in settings
        if setting.partition("=")[0] not in options
    ]
    return OPTION_MARK.join([key, *kept])


def of_families(datasets: Sequence[str]) -> str:
    """Return how many data sets of which family, e.g. "5 x kr10-twin, ur5"."""
    return ", ".join(
        members[0] if len(members) == 1 else f"{len(members)} x {family}"
        for family, members in grouped(datasets, family_of).items()
    )
