"""Ranks of models over data sets and protocols; `leaderboard_tables` prints them.

A mean rank over fewer cases is another quantity: a model that lacks a result anywhere has none.
Ranks and tests are computed among the models that are shown and complete.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from pandas import DataFrame, Series
from scipy.stats import rankdata

from stiff_bench.analysis.collected import (
    Case,
    StoredResults,
    left_out_notes,
    same_name_other_data,
)
from stiff_bench.analysis.scored_case import (
    ScoredCase,
    complete_models,
    scored_case,
    times_like_best,
)
from stiff_bench.analysis.selection import EVERYTHING, Selection
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.store.names import CaseName, labels, natural_key
from stiff_bench.store.samples import StoredData
from stiff_bench.store.versions import sources
from stiff_bench.tables.metric_table import TRAINING_MARK, mark_of
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.scoring.paired import LEVEL


@dataclass(frozen=True, eq=False)
class Section:
    """The cases that may be ranked together.

    Attributes:
        selects_on_test: their protocols let models pick the epoch on the test part.
        unranked: models without a score in every case: name -> case -> why it has no score there.
    """

    selects_on_test: bool
    cases: tuple[ScoredCase, ...]
    unranked: Mapping[str, Mapping[CaseName, str]]

    @cached_property
    def ranked(self) -> DataFrame:
        """The models with a score in every case by mean rank, then name; of one alone none.

        A row a model. Columns: `place`; `mean_rank` over the cases, among the ranked models; `low`
        and `high`, its bounds over draws of the poses, NaN where the metric cannot be resampled;
        `won`, the cases in which no model has a better score; `like_best`, the cases in which it
        is the best or cannot be told from it, NaN where no test applies to them all.
        """
        names = complete_models(self.cases)
        if len(names) < 2:
            return DataFrame()
        scores = DataFrame([[case.mean(name) for name in names] for case in self.cases])
        ranks = (scores * self.cases[0].key.sign).rank(axis="columns")  # (cases, models)
        low, high = _rank_interval(self.cases, names, ranks.mean())
        like_best = times_like_best(self.cases, names)
        found = DataFrame(
            {
                "place": ranks.mean().rank(method="min").astype(int),
                "mean_rank": ranks.mean(),
                **{"low": low, "high": high},
                "won": ranks.eq(ranks.min(axis="columns"), axis="index").sum(),
                "like_best": [np.nan if like_best is None else like_best[name] for name in names],
            }
        )
        return found.set_axis(names).sort_values("mean_rank", kind="stable")

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the data, e.g. ("simulated",)."""
        return tuple(dict.fromkeys(one.case.shown.kind for one in self.cases))

    @property
    def models(self) -> tuple[str, ...]:
        """All models, the ranked ones first."""
        return (*self.ranked.index, *self.unranked)

    def n_results(self, model: str) -> int:
        """Return in how many cases a model has a score."""
        return sum(model in case.scores for case in self.cases)

    def mark_under(self, model: str, protocol: str = "") -> str:
        """Return what must stand beside a model's numbers, under one protocol or all."""
        cases = [one.case for one in self.cases if protocol in ("", one.name.protocol)]
        found = [mark_of(c.competitors[model].shown) for c in cases if model in c.competitors]
        return ", ".join(filter(None, dict.fromkeys(found)))


@dataclass(frozen=True)
class Leaderboard:
    """One section or more, fair protocols first.

    Attributes:
        key: what models are ranked by.
        notes: what is left out, and why.
        provenance: which stiffbench made the results shown.
    """

    key: SortKey
    sections: tuple[Section, ...]
    notes: tuple[str, ...]
    provenance: tuple[str, ...]


def build_leaderboard(
    stored: StoredResults,
    key: SortKey,
    selection: Selection = EVERYTHING,
    *,
    seed: int = 0,
) -> Leaderboard:
    """Return the leaderboard of stored results; `seed` draws poses.

    Raises:
        ConfigError: a name has no results, or there is nothing to compare.
        StoreError: samples are corrupt, or two models share no split.
    """
    cases = selection.cases_of(stored.cases)
    data_of = stored.data_of
    newest = sorted(of_newest_data(cases), key=in_order)
    usable = [case for case in newest if not case.shown.reports_training]
    names = selection.models_of(usable)
    n_run = {case: sum(name in case.competitors for name in names) for case in usable}
    shown = [case for case in usable if n_run[case] > 1]
    lonely = [case for case in usable if n_run[case] == 1]
    notes = list(_data_notes(cases, data_of))
    if lonely:
        first = labels(case.name for case in usable)[lonely[0].name] + and_more(lonely)
        notes.append(f"{first} is left out: none of the other models was run there.")
    if not shown:
        why = "".join(f"; {note.removesuffix('.')}" for note in notes)
        raise ConfigError(
            "there is nothing to rank: no two models have results on the same data, "
            f"protocol and condition (models with results: {', '.join(names) or 'none'}){why}"
        )
    names = [name for name in names if any(name in c.competitors for c in shown)]
    scored = [scored_case(case, names, key, data_of(case.name.data_sha256), seed) for case in shown]
    sections = tuple(
        _section(part, names, selects)
        for selects in (False, True)
        if (part := [f for f in scored if f.case.shown.selects_on_test == selects])
    )
    run_ids = Counter(
        result.run_id for one in scored for model in one.scores for result in one.results[model]
    )
    made_by = (sources(stored.folder, stored.runs, run_ids),)
    return Leaderboard(key, sections, tuple(notes), made_by)


def caveats_of(cases: Iterable[Case]) -> list[str]:
    """Return what must be read with the protocols and the data sets of cases, each once."""
    shown = [case.shown for case in cases]
    caveats = [caveat for one in shown for caveat in one.caveats]
    return [*filter(None, dict.fromkeys([*(one.warning for one in shown), *caveats]))]


def of_newest_data(cases: Sequence[Case]) -> list[Case]:
    """Return the cases of the data that each data set's newest run was on.

    Of those that differ in the source domain's data or in added tool paths alone, the newest stay.
    """
    in_order = sorted(cases, key=lambda one: (one.newest_run, one.name))  # the last ones stay
    newest_data = {one.name.dataset: one.measured_sha256 for one in in_order}
    current = [c for c in in_order if c.measured_sha256 == newest_data[c.name.dataset]]
    newest_source = {replace(one.name, data_sha256="", source_sha256=""): one for one in current}
    return list(newest_source.values())


def _data_notes(cases: Sequence[Case], data_of: Callable[[str], StoredData]) -> Iterator[str]:
    for line in same_name_other_data(cases, data_of):
        yield f"{line.removesuffix('.')}, those of the newest run count, the others are left out."
    yield from left_out_notes(cases)
    for protocol in sorted({c.name.protocol for c in cases if c.shown.reports_training}):
        yield f"{protocol} is left out: {TRAINING_MARK}."


def in_order(case: Case) -> tuple[Any, ...]:
    """Return a sort key: "n = 5" stands before "n = 10"."""
    name = case.name
    return (*map(natural_key, (name.protocol, name.condition, name.dataset)), name)


def newest_results(stored: StoredResults) -> list[CellResult]:
    """Return the results and failures that count, the newest of each, sorted by comparison."""
    return [
        result
        for case in sorted(stored.cases, key=in_order)
        for model in case.competitors.values()
        for result in (*model.done.values(), *model.failures.values())
    ]


def and_more(things: Sequence[object]) -> str:
    """Return " (and 2 more)" of three things, the first of which is named; "" of one."""
    return f" (and {len(things) - 1} more)" if len(things) > 1 else ""


def _section(scored: list[ScoredCase], names: Sequence[str], selects_on_test: bool) -> Section:
    complete = complete_models(scored)
    unranked = {
        name: {one.name: one.missing[name] for one in scored if name in one.missing}
        for name in names
        if not (name in complete and len(complete) > 1)
        and any(name in one.case.competitors for one in scored)
    }
    return Section(selects_on_test, tuple(scored), unranked)


def _rank_interval(
    cases: Sequence[ScoredCase], models: Sequence[str], mean_ranks: Series
) -> tuple[Series, Series]:
    """Return the bounds of the m mean ranks over draws of the poses, the same in all cases.

    A case none of whose poses was drawn is left out of the mean of that draw. Draws hold fewer
    poses than the data, so that close models change places more often in them and ranks draw
    nearer to the middle: bounds are widened to hold the mean rank itself.
    """
    drawn = [
        one.errors.drawn[:, [one.models.index(model) for model in models]]
        for one in cases
        if one.errors.drawn is not None
    ]
    if not drawn:
        return mean_ranks * np.nan, mean_ranks * np.nan
    ranks = rankdata(drawn, axis=-1)  # (cases, B, m)
    drew_some = np.all(np.any(np.isfinite(ranks), axis=0), axis=1)
    low, high = np.quantile(
        np.nanmean(ranks[:, drew_some], axis=0), [0.5 * LEVEL, 1.0 - 0.5 * LEVEL], axis=0
    )
    return mean_ranks.clip(upper=low), mean_ranks.clip(lower=high)
