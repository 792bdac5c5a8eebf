"""Ranks of models over data sets and protocols. Numbers alone; `leaderboard_tables` prints them.

A mean rank over fewer contests is another quantity: a model that lacks a result anywhere has none,
and stands beneath with what it lacks. Ranks, tests and the critical difference are computed among
the models that are shown and complete, whoever else has results in the folder.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stiff_bench.analysis.collected import (
    Contest,
    asked_for,
    competitor_names,
    left_out_notes,
    same_name_other_data,
    stands_for,
)
from stiff_bench.analysis.critical_difference import RankAnalysis, rank_analyses
from stiff_bench.analysis.ranking import (
    Ranking,
    Rankings,
    ScoredContest,
    complete_models,
    scored_contest,
)
from stiff_bench.analysis.same_robot import dataset_of, family_of
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.store.names import ContestName, grouped, labels, natural_key
from stiff_bench.tables.table import mark_of
from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.plugin import STIFFNESS, kind_label
from stiff_protocols.contract.record import Presentation
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.paired import LEVEL


@dataclass(frozen=True)
class ColumnValue:
    """A model's score over the data sets of a column.

    Attributes:
        mean: over the data sets that have it, in the metric's unit; NaN where none has.
        std: over them; NaN for one.
        n_datasets: how many have it.
        failed: "FAILED" or "SKIPPED" where it did in one of them; else "".
        best: it has the best mean of the models that have all data sets.
        like_best: it cannot be told from the best in more than half of the contests; None: it
            lacks a data set, or no test applies.
    """

    mean: float
    std: float
    n_datasets: int
    failed: str
    best: bool
    like_best: bool | None


@dataclass(frozen=True)
class Column:
    """One protocol and condition on the data sets of one robot type.

    Attributes:
        family: name of the data sets without the options that make another robot of the type.
        protocol, condition: as shown.
        datasets: their names.
        seeds: of the runs' splits.
        values: by model; one that was run nowhere here is not there.
    """

    family: str
    protocol: str
    condition: str
    datasets: tuple[str, ...]
    seeds: tuple[int, ...]
    values: Mapping[str, ColumnValue]


def columns(scored: Sequence[ScoredContest], rankings: Rankings) -> Iterator[Column]:
    """Yield a column for each robot type, protocol and condition, in the scored' order."""
    for (family, protocol, condition), members in grouped(scored, _place).items():
        datasets = tuple(dict.fromkeys(_dataset(one) for one in members))
        values = dict(_values(members, rankings))
        seeds = tuple(sorted({one.name.seed for one in members}))
        yield Column(family, protocol, condition, datasets, seeds, values)


def _place(one: ScoredContest) -> tuple[str, str, str]:
    return family_of(one.name), one.name.protocol, one.name.condition


def _dataset(one: ScoredContest) -> str:
    return dataset_of(one.name)


def _values(
    scored: Sequence[ScoredContest], rankings: Rankings
) -> Iterator[tuple[str, ColumnValue]]:
    complete = complete_models(scored)
    like = _like_best(scored, complete, rankings)
    scores = {
        model: _by_dataset(scored, model)
        for model in dict.fromkeys(name for one in scored for name in one.contest.competitors)
        if any(model in one.scores or model in one.missing for one in scored)
    }
    sign = rankings.key.sign
    best = min((sign * np.mean(scores[model]) for model in complete), default=math.nan)
    for model, found in scores.items():
        yield (
            model,
            ColumnValue(
                mean=float(np.mean(found)) if found else math.nan,
                std=float(np.std(found, ddof=1)) if len(found) > 1 else math.nan,
                n_datasets=len(found),
                failed=max(one.failed(model) for one in scored),
                best=model in complete and bool(sign * np.mean(found) == best),
                like_best=like.get(model),
            ),
        )


def _by_dataset(scored: Sequence[ScoredContest], model: str) -> list[float]:
    """Return a model's score on each data set where it lacks no repetition."""
    return [
        float(np.mean([one.mean(model) for one in members]))
        for members in grouped(scored, _dataset).values()
        if all(model in one.scores for one in members)
    ]


def _like_best(
    scored: Sequence[ScoredContest], models: tuple[str, ...], rankings: Rankings
) -> dict[str, bool]:
    """Return whether each model is like the best in more than half of the contests."""
    if not models:
        return {}
    found = [rankings.of(one, models).like_best for one in scored]
    tested = [like for like in found if like is not None]
    if len(tested) < len(scored):
        return {}
    share = np.mean(tested, axis=0)
    return {model: bool(part > 0.5) for model, part in zip(models, share, strict=True)}


FEWEST_RANKED = 2


@dataclass(frozen=True)
class ShownContests:
    """What a leaderboard shows.

    Attributes:
        contests: of stiffness, in which at least two of the models were run; by protocol,
            condition and data set.
        models: that were run in one of them, by name.
        notes: what is left out, and why.
    """

    contests: tuple[Contest, ...]
    models: tuple[str, ...]
    notes: tuple[str, ...]


def shown_contests(contests: Sequence[Contest], words: Sequence[str]) -> ShownContests:
    """Return the contests in which models can be ranked.

    Args:
        contests: of one folder.
        words: models' names, or keys that stand for all their variants; none means all.

    Raises:
        ConfigError: a model has no results, or there is nothing to rank.
    """
    usable = [c for c in of_newest_data(contests) if presentation(c).task == STIFFNESS]
    names = _named(usable, words)
    ranked = [c for c in usable if _n_run(c, names) >= FEWEST_RANKED]
    if not ranked:
        why = "".join(f"; {note.removesuffix('.')}" for note in _data_notes(contests))
        raise ConfigError(
            "there is nothing to rank: no two models have results on the same stiffness data, "
            f"protocol and condition (models with results: {', '.join(names) or 'none'}){why}"
        )
    lonely = sorted((c for c in usable if _n_run(c, names) == 1), key=_order)
    called = labels(contest.name for contest in usable)
    return ShownContests(
        contests=tuple(sorted(ranked, key=_order)),
        models=tuple(name for name in names if any(name in c.competitors for c in ranked)),
        notes=(
            *_data_notes(contests),
            *(
                f"{called[c.name]} is left out: none of the other models was run there."
                for c in lonely
            ),
        ),
    )


def presentation(contest: Contest) -> Presentation:
    """Return what stands beside a contest's numbers; what is said of the model is any model's."""
    return next(iter(contest.competitors.values())).shown


def caveats_of(contests: Iterable[Contest]) -> tuple[str, ...]:
    """Return what must be read with the data sets and the protocols of contests, each once."""
    shown = [presentation(contest) for contest in contests]
    said = [caveat for one in shown for caveat in (*one.caveats, one.warning)]
    return tuple(filter(None, dict.fromkeys(said)))


def _n_run(contest: Contest, names: Sequence[str]) -> int:
    return sum(name in contest.competitors for name in names)


def of_newest_data(contests: Sequence[Contest]) -> list[Contest]:
    """Return the contests of the data that each data set's newest run was on.

    Of those that differ in the data of the source domain alone, the newest stay.
    """
    in_order = sorted(contests, key=lambda one: (one.newest_run, one.name))  # the last ones stay
    newest_data = {one.name.dataset: one.name.data_sha256 for one in in_order}
    current = [c for c in in_order if c.name.data_sha256 == newest_data[c.name.dataset]]
    newest_source = {_without_source(one): one for one in current}
    return list(newest_source.values())


def _without_source(contest: Contest) -> ContestName:
    return replace(contest.name, source_sha256="")


def _named(contests: Sequence[Contest], words: Sequence[str]) -> list[str]:
    known = competitor_names(contests)
    for word in words:
        if not any(stands_for(word, name) for name in known):
            raise ConfigError(f"--model: {unknown_name('model with results', word, known)}")
    return [name for name in known if asked_for(name, words)]


def _data_notes(contests: Sequence[Contest]) -> Iterator[str]:
    for line in same_name_other_data(contests):
        yield f"{line.removesuffix('.')}, those of the newest run count, the others are left out."
    yield from left_out_notes(contests)
    others = {
        c.name.dataset: presentation(c) for c in contests if presentation(c).task != STIFFNESS
    }
    for dataset, shown in sorted(others.items()):
        yield f"{dataset} is left out: it is {kind_label(shown.kind, shown.task)}."


def _order(contest: Contest) -> tuple[Any, ...]:
    """Return a sort key: "n = 5" stands before "n = 10"."""
    name = contest.name
    return (*map(natural_key, (name.protocol, name.condition, name.dataset)), name.seed)


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
    fields: tuple[ScoredContest, ...]
    ranked: tuple[RankedModel, ...]
    unranked: tuple[UnrankedModel, ...]
    columns: tuple[Column, ...]
    analyses: tuple[RankAnalysis, ...]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the data, e.g. ("simulated",)."""
        return tuple(dict.fromkeys(presentation(one.contest).kind for one in self.fields))

    @property
    def caveats(self) -> tuple[str, ...]:
        """What must be read with the data sets and the protocols."""
        return caveats_of(one.contest for one in self.fields)

    def caveats_of(self, family: str, protocol: str) -> tuple[str, ...]:
        """Return what must be read with the data sets of one robot type and a protocol."""
        return caveats_of(
            one.contest
            for one in self.fields
            if (family_of(one.name), one.name.protocol) == (family, protocol)
        )

    @property
    def marks(self) -> dict[str, str]:
        """Model -> all its marks under these protocols; the ranked first."""
        marks = {model.name: model.mark for model in self.ranked}
        return marks | {model.name: model.mark for model in self.unranked}

    def mark_under(self, protocol: str, model: str) -> str:
        """Return what must stand beside a model's numbers under one protocol."""
        contests = [one.contest for one in self.fields if one.name.protocol == protocol]
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
            for one in section.fields
            for model in one.scores
            for result in one.results[model]
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
    scored = [scored_contest(contest, shown.models, key, asked) for contest in shown.contests]
    rankings = Rankings(key, folder, seed)
    sections = tuple(
        _section(part, selects, rankings)
        for selects in (False, True)
        if (part := [f for f in scored if presentation(f.contest).selects_on_test == selects])
    )
    return Leaderboard(key, sections, shown.notes)


def _section(scored: list[ScoredContest], selects_on_test: bool, rankings: Rankings) -> Section:
    contests = [one.contest for one in scored]
    names = [name for name in competitor_names(contests) if _takes_part(scored, name)]
    marks = {name: _mark(contests, name) for name in names}
    complete = complete_models(scored)
    analyses = rank_analyses(scored, rankings)
    ranked: list[RankedModel] = []
    if len(complete) >= FEWEST_RANKED:
        found = _ranked([rankings.of(one, complete) for one in scored], marks, analyses[0])
        ranked = sorted(found, key=lambda model: (model.mean_rank, model.name))
    return Section(
        selects_on_test=selects_on_test,
        fields=tuple(scored),
        ranked=tuple(ranked),
        unranked=tuple(
            UnrankedModel(name, marks[name], _missing(scored, name))
            for name in names
            if name not in {model.name for model in ranked}
        ),
        columns=tuple(columns(scored, rankings)),
        analyses=tuple(analyses),
    )


def _takes_part(scored: Sequence[ScoredContest], name: str) -> bool:
    """Say whether the model is shown and was run in one of these contests."""
    return any(
        name in one.contest.competitors and (name in one.scores or name in one.missing)
        for one in scored
    )


def _mark(contests: Sequence[Contest], name: str) -> str:
    found = [mark_of(c.competitors[name].shown) for c in contests if name in c.competitors]
    return ", ".join(filter(None, dict.fromkeys(found)))


def _missing(scored: Sequence[ScoredContest], name: str) -> dict[ContestName, str]:
    return {one.name: one.missing[name] for one in scored if name in one.missing}


def _ranked(
    rankings: Sequence[Ranking], marks: Mapping[str, str], over_datasets: RankAnalysis
) -> list[RankedModel]:
    mean_ranks = np.mean([ranking.ranks for ranking in rankings], axis=0)  # (m,)
    low, high = _rank_interval(rankings, mean_ranks)
    won = np.sum([ranking.is_best for ranking in rankings], axis=0)
    tested = [like for ranking in rankings if (like := ranking.like_best) is not None]
    like_best = np.sum(tested, axis=0) if len(tested) == len(rankings) else None
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
        for column, name in enumerate(rankings[0].models)
    ]


def _rank_interval(
    rankings: Sequence[Ranking], mean_ranks: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the (m,) bounds of the mean rank over draws of the poses, the same in all contests.

    A contest none of whose poses was drawn is left out of the mean of that draw. Draws hold fewer
    poses than the data, so that close models change places more often in them and ranks draw
    nearer to the middle: bounds are widened to hold the mean rank itself.
    """
    drawn = [ranks for ranking in rankings if (ranks := ranking.drawn_ranks) is not None]
    if not drawn:
        nothing = np.full(len(rankings[0].models), np.nan)
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
