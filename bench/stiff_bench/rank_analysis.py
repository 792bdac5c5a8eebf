"""Friedman and post-hoc tests over the robots of a leaderboard.

A block is one protocol and condition. A robot counts once in it: other loads, sensors, noise and
seeds of splits repeat the same robot, and a model's scores on its data sets are averaged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.contest_name import ContestName
from stiff_bench.field import Field, complete_models
from stiff_bench.grouped import grouped
from stiff_bench.same_robot import Robot, family_of, robots_of
from stiff_bench.sort_key import SortKey
from stiff_bench.standing import Standings
from stiff_protocols.paired import LEVEL
from stiff_protocols.ranks import OverDatasets, compare_over_datasets, why_not
from stiff_protocols.types import FloatArray

NOT_OF_COSTS = "does not apply to costs"


@dataclass(frozen=True, eq=False)
class RankAnalysis:
    """The comparison of models over the robots of a block, or why there is none.

    Attributes:
        protocol, condition: of the block; both "" for all protocols together, where a model's
            score on a robot is its mean rank over the contests there.
        families: robot that counts -> its data sets' names, without the options that make another
            robot of its type.
        models: with results on all of them, in the order of the outcome's columns.
        outcome: None where there is none.
        why_none: "" where there is an outcome.
    """

    protocol: str
    condition: str
    families: Mapping[Robot, tuple[str, ...]]
    models: tuple[str, ...]
    outcome: OverDatasets | None
    why_none: str

    @property
    def robots(self) -> tuple[Robot, ...]:
        """The robots that count."""
        return tuple(self.families)

    @property
    def text(self) -> str:
        """Protocol and condition for people."""
        block = " | ".join(filter(None, (self.protocol, self.condition)))
        return block or "all protocols together"

    @property
    def differs(self) -> bool:
        """Whether the Friedman test finds that the models differ; else no pair is looked at."""
        return self.outcome is not None and self.outcome.friedman_p < LEVEL

    def like_best(self, model: str) -> bool | None:
        """Say whether a model cannot be told from the best; None where there is no analysis."""
        if self.outcome is None:
            return None
        ranks = self.outcome.mean_ranks
        behind = ranks[self.models.index(model)] - ranks.min()
        return not self.differs or bool(behind < self.outcome.critical_difference)


def rank_analyses(fields: Sequence[Field], standings: Standings) -> list[RankAnalysis]:
    """Return an analysis for each block; where there are several, the one over all comes first."""
    robots = robots_of([field.contest for field in fields], standings.robot_name)
    blocks = grouped(fields, lambda field: (field.name.protocol, field.name.condition))
    found = [_of_block(*block, members, robots, standings) for block, members in blocks.items()]
    return found if len(found) == 1 else [_of_all(fields, robots, standings), *found]


def _of_block(
    protocol: str,
    condition: str,
    fields: Sequence[Field],
    robots: Mapping[ContestName, Robot],
    standings: Standings,
) -> RankAnalysis:
    models = complete_models(fields)
    sign = standings.key.sign
    scores = {
        field.name: np.array([sign * field.mean(model) for model in models]) for field in fields
    }
    return _analysis(protocol, condition, models, scores, robots, standings.key)


def _of_all(
    fields: Sequence[Field], robots: Mapping[ContestName, Robot], standings: Standings
) -> RankAnalysis:
    models = complete_models(fields)
    scores = {field.name: standings.of(field, models).ranks for field in fields}
    return _analysis("", "", models, scores, robots, standings.key)


def _analysis(
    protocol: str,
    condition: str,
    models: tuple[str, ...],
    scores: Mapping[ContestName, FloatArray],
    robots: Mapping[ContestName, Robot],
    key: SortKey,
) -> RankAnalysis:
    """Return the analysis of the (m,) scores in each contest, averaged over those of one robot."""
    of_robots = grouped(scores, lambda name: robots[name])
    why_none = NOT_OF_COSTS if key.is_cost else why_not(len(of_robots), len(models))
    outcome = None
    if not why_none:
        outcome = compare_over_datasets(
            [np.mean([scores[name] for name in names], axis=0) for names in of_robots.values()]
        )
    families = {
        robot: tuple(dict.fromkeys(family_of(name.dataset) for name in names))
        for robot, names in of_robots.items()
    }
    return RankAnalysis(protocol, condition, families, models, outcome, why_none)
