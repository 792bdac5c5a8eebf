"""Friedman and post-hoc tests over the data sets of a leaderboard.

A block is one protocol and condition. A data set counts once in it: other seeds of its splits or
its noise repeat the same robot, and its scores are averaged over them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.choice import OPTION_MARK, split_word
from stiff_bench.standing import Field, Standings, complete_models
from stiff_protocols.paired import LEVEL
from stiff_protocols.ranks import OverDatasets, compare_over_datasets, why_not

_REPEATS = ("seed",)
_SAME_TYPE = ("seed", "specimen")


def dataset_of(name: str) -> str:
    """Return a data set's name without the option that only repeats it."""
    return _without(name, _REPEATS)


def family_of(name: str) -> str:
    """Return a data set's name without the options that make another robot of its type."""
    return _without(name, _SAME_TYPE)


def _without(name: str, options: Sequence[str]) -> str:
    key, settings = split_word(name)
    kept = [word for word in settings if word.partition("=")[0] not in options]
    return OPTION_MARK.join([key, *kept])


def of_families(datasets: Sequence[str]) -> str:
    """Return how many data sets of which robot type, e.g. "5 x kr10-twin, ur5"."""
    members: dict[str, list[str]] = {}
    for dataset in datasets:
        members.setdefault(family_of(dataset), []).append(dataset)
    return ", ".join(
        found[0] if len(found) == 1 else f"{len(found)} x {family}"
        for family, found in members.items()
    )


@dataclass(frozen=True, eq=False)
class RankAnalysis:
    """The comparison of models over the data sets of a block, or why there is none.

    Attributes:
        protocol, condition: of the block; both "" for all protocols together, where a data set's
            score is a model's mean rank over its contests.
        datasets: that count, by name.
        models: with results on all of them, in the order of the outcome's columns.
        outcome: None where there is none.
        why_none: "" where there is an outcome.
    """

    protocol: str
    condition: str
    datasets: tuple[str, ...]
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
        """Say whether a model cannot be told from the best; None where there is no analysis."""
        if self.outcome is None:
            return None
        ranks = self.outcome.mean_ranks
        behind = ranks[self.models.index(model)] - ranks.min()
        return not self.differs or bool(behind < self.outcome.critical_difference)


def rank_analyses(fields: Sequence[Field], standings: Standings) -> list[RankAnalysis]:
    """Return an analysis for each block; where there are several, the one over all comes first."""
    blocks: dict[tuple[str, str], list[Field]] = {}
    for field in fields:
        blocks.setdefault((field.name.protocol, field.name.condition), []).append(field)
    found = [_of_block(*block, members, standings) for block, members in blocks.items()]
    return found if len(found) == 1 else [_of_all(fields, standings), *found]


def _of_block(
    protocol: str, condition: str, fields: Sequence[Field], standings: Standings
) -> RankAnalysis:
    models = complete_models(fields)
    sign = standings.key.sign
    scores = [
        np.mean([[sign * field.mean(model) for model in models] for field in members], axis=0)
        for members in _by_dataset(fields).values()
    ]
    return _analysis(protocol, condition, tuple(_by_dataset(fields)), models, scores)


def _of_all(fields: Sequence[Field], standings: Standings) -> RankAnalysis:
    models = complete_models(fields)
    scores = [
        np.mean([standings.of(field, models).ranks for field in members], axis=0)
        for members in _by_dataset(fields).values()
    ]
    return _analysis("", "", tuple(_by_dataset(fields)), models, scores)


def _by_dataset(fields: Iterable[Field]) -> dict[str, list[Field]]:
    found: dict[str, list[Field]] = {}
    for field in fields:
        found.setdefault(dataset_of(field.name.dataset), []).append(field)
    return found


def _analysis(
    protocol: str,
    condition: str,
    datasets: tuple[str, ...],
    models: tuple[str, ...],
    scores: Sequence[np.ndarray],
) -> RankAnalysis:
    why_none = why_not(len(datasets), len(models))
    outcome = None if why_none else compare_over_datasets(scores)
    return RankAnalysis(protocol, condition, datasets, models, outcome, why_none)
