"""Friedman and post-hoc tests over the robots of a leaderboard.

A block is one protocol and condition. A robot counts once in it: other loads, sensors, noise and
seeds of splits repeat the same robot, and a model's scores on its data sets are averaged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from stiff_bench.analysis.ranking import ScoredCase, complete_models
from stiff_bench.analysis.verdict import decide, rank_difference
from stiff_bench.store.names import CaseName, grouped
from stiff_bench.tables.units import counted
from stiff_protocols.contract.types import BoolArray
from stiff_protocols.scoring.paired import LEVEL
from stiff_protocols.scoring.ranks import OverDatasets, compare_over_datasets, why_not

SEED, SPECIMEN = "seed", "specimen"
"""Options of data sets that only repeat one, and that make another robot of its type."""


class Specimen(NamedTuple):
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
        robots |= {one.name: Specimen(members[0].data.robot.name, number) for one in members}
    return robots


def of_robots(families: Mapping[Specimen, Sequence[str]]) -> str:
    """Return how many robots, and in which data, e.g. "5 specimens of kr10-twin".

    `families` are the names of each robot's data sets, as `family_of` has them.
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


@dataclass(frozen=True, eq=False)
class RankAnalysis:
    """The comparison of models over the robots of a block, or why there is none.

    Attributes:
        protocol, condition: of the block; both "" for all protocols together, where a model's
            score on a robot is its mean rank over the cases there.
        families: robot that counts -> its data sets' names, as `family_of` has them.
        models: with results on all of them, in the order of the outcome's columns.
        outcome: None where there is none.
        why_none: "" where there is an outcome.
    """

    protocol: str
    condition: str
    families: Mapping[Specimen, tuple[str, ...]]
    models: tuple[str, ...]
    outcome: OverDatasets | None
    why_none: str

    @property
    def text(self) -> str:
        """Protocol and condition for people."""
        block = " | ".join(filter(None, (self.protocol, self.condition)))
        return block or "all protocols together"

    @property
    def differs(self) -> bool:
        """Whether the Friedman test finds that the models differ; else no pair is looked at."""
        return self.outcome is not None and self.outcome.friedman_p < LEVEL

    @cached_property
    def apart(self) -> BoolArray:
        """(m, m) whether Nemenyi's test finds that two models differ; of an outcome alone."""
        outcome, apart = self.outcome, np.zeros((len(self.models),) * 2, dtype=np.bool_)
        if outcome is not None:
            for a, b in combinations(range(len(self.models)), 2):
                verdict = decide([rank_difference(outcome, a, b)], 1.0 - LEVEL)
                apart[a, b] = apart[b, a] = verdict != "open"
        return apart

    def like_best(self, model: str) -> bool | None:
        """Say whether a model is not found worse than the best; None where there is no analysis."""
        if self.outcome is None:
            return None
        return not self.apart[int(self.outcome.mean_ranks.argmin()), self.models.index(model)]


def rank_analyses(scored: Sequence[ScoredCase]) -> list[RankAnalysis]:
    """Return an analysis for each block; where there are several, the one over all comes first.

    A block is of the models' scores, the one over several protocols of their ranks.
    """
    robots = robots_of(scored)
    blocks = grouped(scored, lambda one: (one.name.protocol, one.name.condition))
    if len(blocks) > 1:
        blocks = {("", ""): [*scored]} | blocks
    analyses = []
    for (protocol, condition), cases in blocks.items():
        of_robots = grouped(cases, lambda one: robots[one.name])
        families = {
            robot: tuple(dict.fromkeys(family_of(one.name) for one in of_robot))
            for robot, of_robot in of_robots.items()
        }
        models, is_cost = complete_models(cases), cases[0].key.is_cost
        why_none = "does not apply to costs" if is_cost else why_not(len(of_robots), len(models))
        outcome = None
        if not why_none:
            scores = {
                one: one.signed_means(models) if protocol else one.ranking(models).ranks
                for one in cases
            }
            of_each = [[scores[one] for one in of_robot] for of_robot in of_robots.values()]
            outcome = compare_over_datasets([np.mean(of_robot, axis=0) for of_robot in of_each])
        analyses.append(RankAnalysis(protocol, condition, families, models, outcome, why_none))
    return analyses
