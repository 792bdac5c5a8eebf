"""Friedman and post-hoc tests over the robots of a leaderboard.

A block is one protocol and condition. A robot counts once in it: other loads, sensors, noise and
seeds of splits repeat the same robot, and a model's scores on its data sets are averaged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.analysis.ranking import ScoredCase, complete_models
from stiff_bench.analysis.same_robot import Specimen, family_of, robots_of
from stiff_bench.analysis.verdict import decide, rank_difference
from stiff_bench.store.names import CaseName, grouped
from stiff_protocols.scoring.paired import LEVEL
from stiff_protocols.scoring.ranks import OverDatasets, compare_over_datasets, why_not


@dataclass(frozen=True, eq=False)
class RankAnalysis:
    """The comparison of models over the robots of a block, or why there is none.

    Attributes:
        protocol, condition: of the block; both "" for all protocols together, where a model's
            score on a robot is its mean rank over the cases there.
        families: robot that counts -> its data sets' names, without the options that make another
            robot of its type.
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

    def like_best(self, model: str) -> bool | None:
        """Say whether a model is not found worse than the best; None where there is no analysis."""
        if self.outcome is None:
            return None
        best = int(self.outcome.mean_ranks.argmin())
        difference = rank_difference(self.outcome, best, self.models.index(model))
        return decide([difference], 1.0 - LEVEL) != "a"


def rank_analyses(scored: Sequence[ScoredCase]) -> list[RankAnalysis]:
    """Return an analysis for each block; where there are several, the one over all comes first."""
    robots = robots_of(scored)
    blocks = grouped(scored, lambda one: (one.name.protocol, one.name.condition))
    together = {("", ""): scored} if len(blocks) > 1 else {}
    return [_analysis(*block, cases, robots) for block, cases in (together | blocks).items()]


def _analysis(
    protocol: str,
    condition: str,
    cases: Sequence[ScoredCase],
    robots: Mapping[CaseName, Specimen],
) -> RankAnalysis:
    """Return the analysis of the models' scores, or of their ranks over several protocols."""
    models, is_cost = complete_models(cases), cases[0].key.is_cost
    of_robots = grouped(cases, lambda one: robots[one.name])
    why_none = "does not apply to costs" if is_cost else why_not(len(of_robots), len(models))
    outcome = None
    if not why_none:
        scores = {
            one: one.key.sign * np.array([one.mean(model) for model in models])
            if protocol
            else one.ranking(models).ranks
            for one in cases
        }
        outcome = compare_over_datasets(
            [np.mean([scores[one] for one in of_robot], axis=0) for of_robot in of_robots.values()]
        )
    families = {
        robot: tuple(dict.fromkeys(family_of(one.name) for one in of_robot))
        for robot, of_robot in of_robots.items()
    }
    return RankAnalysis(protocol, condition, families, models, outcome, why_none)
