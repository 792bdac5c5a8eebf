"""Ranks of models over data sets and protocols. Numbers alone; `leaderboard_tables` prints them.

A mean rank over fewer contests is another quantity: a model that lacks a result anywhere has none,
and stands beneath with what it lacks. Ranks, tests and the critical difference are computed among
the models that are shown and complete, whoever else has results in the folder.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiff_bench.board_columns import Column, columns
from stiff_bench.collected import Contest, competitor_names
from stiff_bench.contest_choice import FEWEST_RANKED, caveats_of, presentation, shown_contests
from stiff_bench.contest_name import ContestName
from stiff_bench.field import Field, complete_models, field_of
from stiff_bench.rank_analysis import RankAnalysis, rank_analyses
from stiff_bench.same_robot import family_of
from stiff_bench.sort_key import SortKey
from stiff_bench.standing import Standing, Standings
from stiff_bench.tables import mark_of
from stiff_protocols.paired import LEVEL
from stiff_protocols.types import FloatArray


@dataclass(frozen=True)
class RankedModel:
    """A model with a result in every contest.

    Attributes:
        name, mark: of it, and what must stand beside it.
        mean_rank: over the contests, among the ranked models.
        low, high: bounds of it over resampled poses, and itself; NaN where the metric cannot be
            resampled.
        won: contests in which no model has a better score.
        like_best: contests in which it is the best or cannot be told from it; None: no test
            applies to them all.
        within_cd: it lies within the critical difference of the best; None: there is none.
    """

    name: str
    mark: str
    mean_rank: float
    low: float
    high: float
    won: int
    like_best: int | None
    within_cd: bool | None


@dataclass(frozen=True)
class UnrankedModel:
    """A model that lacks a result somewhere.

    Attributes:
        missing: contest -> why it has no result there.
    """

    name: str
    mark: str
    missing: Mapping[ContestName, str]


@dataclass(frozen=True)
class Section:
    """The contests that may be ranked together.

    Attributes:
        selects_on_test: their protocols let models pick the epoch on the test part.
        fields: the contests.
        ranked: by mean rank, then name.
        unranked: the others, by name.
        columns: by protocol and condition.
        analyses: over data sets, the one over all protocols first.
    """

    selects_on_test: bool
    fields: tuple[Field, ...]
    ranked: tuple[RankedModel, ...]
    unranked: tuple[UnrankedModel, ...]
    columns: tuple[Column, ...]
    analyses: tuple[RankAnalysis, ...]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the data, e.g. ("simulated",)."""
        return tuple(dict.fromkeys(presentation(field.contest).kind for field in self.fields))

    @property
    def caveats(self) -> tuple[str, ...]:
        """What must be read with the data sets and the protocols."""
        return caveats_of(field.contest for field in self.fields)

    def caveats_of(self, family: str, protocol: str) -> tuple[str, ...]:
        """Return what must be read with the data sets of one robot type and a protocol."""
        return caveats_of(
            field.contest
            for field in self.fields
            if (family_of(field.name.dataset), field.name.protocol) == (family, protocol)
        )

    @property
    def marks(self) -> dict[str, str]:
        """Model -> all its marks under these protocols; the ranked first."""
        marks = {model.name: model.mark for model in self.ranked}
        return marks | {model.name: model.mark for model in self.unranked}

    def mark_under(self, protocol: str, model: str) -> str:
        """Return what must stand beside a model's numbers under one protocol."""
        contests = [field.contest for field in self.fields if field.name.protocol == protocol]
        return _mark(contests, model)


@dataclass(frozen=True)
class Leaderboard:
    """Sections, fair protocols first.

    Attributes:
        key: what the ranks are of.
        sections: at least one.
        notes: what holds for all of them.
    """

    key: SortKey
    sections: tuple[Section, ...]
    notes: tuple[str, ...]

    @property
    def run_ids(self) -> Counter[str]:
        """How many of the results shown each run made."""
        return Counter(
            result.run_id
            for section in self.sections
            for field in section.fields
            for model in field.scores
            for result in field.results(model)
        )


def build_leaderboard(
    contests: Sequence[Contest],
    *,
    models: Sequence[str],
    key: SortKey,
    folder: Path,
    asked: Set[str] = frozenset(),
    seed: int = 0,
) -> Leaderboard:
    """Return the ranks of the models of these contests.

    Args:
        contests: of one folder.
        models: names, or keys that stand for all their variants; none means all.
        key: what to rank by.
        folder: of the results, for the samples.
        asked: keys of the cells that the folder's runs were asked for.
        seed: of the draws of poses.

    Raises:
        ConfigError: a model has no results, or there is nothing to compare.
        StoreError: two models share no split, or the samples cannot be read.
    """
    shown = shown_contests(contests, models)
    fields = [field_of(contest, shown.models, key, asked) for contest in shown.contests]
    standings = Standings(key, folder, seed)
    sections = tuple(
        _section(part, selects, standings)
        for selects in (False, True)
        if (part := [f for f in fields if presentation(f.contest).selects_on_test == selects])
    )
    return Leaderboard(key, sections, shown.notes)


def _section(fields: list[Field], selects_on_test: bool, standings: Standings) -> Section:
    contests = [field.contest for field in fields]
    names = [name for name in competitor_names(contests) if _takes_part(fields, name)]
    marks = {name: _mark(contests, name) for name in names}
    complete = complete_models(fields)
    analyses = rank_analyses(fields, standings)
    ranked: list[RankedModel] = []
    if len(complete) >= FEWEST_RANKED:
        found = _ranked([standings.of(field, complete) for field in fields], marks, analyses[0])
        ranked = sorted(found, key=lambda model: (model.mean_rank, model.name))
    return Section(
        selects_on_test=selects_on_test,
        fields=tuple(fields),
        ranked=tuple(ranked),
        unranked=tuple(
            UnrankedModel(name, marks[name], _missing(fields, name))
            for name in names
            if name not in {model.name for model in ranked}
        ),
        columns=tuple(columns(fields, standings)),
        analyses=tuple(analyses),
    )


def _takes_part(fields: Sequence[Field], name: str) -> bool:
    """Say whether the model is shown and was run in one of these contests."""
    return any(
        name in field.contest.competitors and (name in field.scores or name in field.missing)
        for field in fields
    )


def _mark(contests: Sequence[Contest], name: str) -> str:
    found = [mark_of(c.competitors[name].shown) for c in contests if name in c.competitors]
    return ", ".join(filter(None, dict.fromkeys(found)))


def _missing(fields: Sequence[Field], name: str) -> dict[ContestName, str]:
    return {field.name: field.missing[name] for field in fields if name in field.missing}


def _ranked(
    standings: Sequence[Standing], marks: Mapping[str, str], over_datasets: RankAnalysis
) -> list[RankedModel]:
    mean_ranks = np.mean([standing.ranks for standing in standings], axis=0)  # (m,)
    low, high = _rank_interval(standings, mean_ranks)
    won = np.sum([standing.is_best for standing in standings], axis=0)
    tested = [like for standing in standings if (like := standing.like_best) is not None]
    like_best = np.sum(tested, axis=0) if len(tested) == len(standings) else None
    return [
        RankedModel(
            name=name,
            mark=marks[name],
            mean_rank=float(mean_ranks[column]),
            low=float(low[column]),
            high=float(high[column]),
            won=int(won[column]),
            like_best=None if like_best is None else int(like_best[column]),
            within_cd=over_datasets.like_best(name),
        )
        for column, name in enumerate(standings[0].models)
    ]


def _rank_interval(
    standings: Sequence[Standing], mean_ranks: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the (m,) bounds of the mean rank over draws of the poses, the same in all contests.

    A contest none of whose poses was drawn is left out of the mean of that draw. Draws hold fewer
    poses than the data, so that close models change places more often in them and ranks draw
    nearer to the middle: bounds are widened to hold the mean rank itself.
    """
    drawn = [ranks for standing in standings if (ranks := standing.drawn_ranks) is not None]
    if not drawn:
        nothing = np.full(len(standings[0].models), np.nan)
        return nothing, nothing
    total, counts = np.zeros_like(drawn[0]), np.zeros(drawn[0].shape, dtype=np.int64)
    for ranks in drawn:
        total += np.nan_to_num(ranks)
        counts += np.isfinite(ranks)
    drew_some = counts.all(axis=1)
    low, high = np.quantile(
        total[drew_some] / counts[drew_some], [0.5 * LEVEL, 1.0 - 0.5 * LEVEL], axis=0
    )
    return np.minimum(low, mean_ranks), np.maximum(high, mean_ranks)
