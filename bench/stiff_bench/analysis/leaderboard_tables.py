"""A leaderboard as tables: lists of columns, each of which makes its own cells. SI becomes mm here.

A new column is one entry: of the ranks in `RANKS`, of the costs in `COSTS`. docs/comparing.md says
what the columns and marks mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, fields, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from pandas import DataFrame

from stiff_bench.analysis.leaderboard import Leaderboard, Section, and_more, caveats_of
from stiff_bench.analysis.scored_case import (
    ScoredCase,
    complete_models,
    correction_text,
    dataset_of,
    family_of,
    times_like_best,
)
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.store.names import CaseName, grouped, labels
from stiff_bench.tables.metric_table import SELECTION_MARK, number_format
from stiff_bench.tables.table import WRITTEN, Column, Entry, Name, Quantity, Table, text_columns
from stiff_bench.tables.units import PRINTED, counted, percent
from stiff_protocols.contract.record import Cost
from stiff_protocols.scoring.metrics import METRICS
from stiff_protocols.scoring.paired import LEVEL

BEST, LIKE_BEST = "*", "≈"


def leaderboard_tables(board: Leaderboard) -> list[Table]:
    """Return the tables of all sections.

    csv has the ranks alone, a line a model and number; json has each model's score in each case,
    too.
    """
    tables = []
    for section in board.sections:
        ranks, *others = section_tables(section, board)
        others = [replace(one, formats=WRITTEN) for one in others]
        tables += [ranks, *others, _scores(section, board)]
    return tables


def section_tables(section: Section, board: Leaderboard) -> list[Table]:
    """Return ranks, scores by protocol and costs of one section."""
    tables = [_ranks(section, board), *_by_protocol(section, board.key), _costs(section)]
    return [replace(table, brief=True) for table in tables if table.rows]


def _about(section: Section, table: str) -> dict[str, object]:
    return {"table": table, "selects_on_test": section.selects_on_test}


class Model(NamedTuple):
    """What a row of the ranks, or of the costs, is of."""

    section: Section
    name: str

    @property
    def marked(self) -> Name:
        """Name, with what must stand beside it."""
        return Name(self.name, self.section.mark_under(self.name))

    @property
    def costs(self) -> list[Cost]:
        """Costs of the fits that the ranks are of, as far as they were recorded."""
        cases = [case for case in self.section.cases if self.name in case.scores]
        costs = (result.cost for case in cases for result in case.results[self.name])
        return [cost for cost in costs if cost is not None]

    def ranked(self, column: str) -> int | float | None:
        """Return an entry of `Section.ranked`; None where there is none."""
        ranked = self.section.ranked
        value: Any = ranked.at[self.name, column] if self.name in ranked.index else np.nan
        return None if np.isnan(value) else value.item()

    def share(self, number: float | None) -> Quantity | None:
        """Return a number of cases of all of them."""
        n_cases = len(self.section.cases)
        return None if number is None else Quantity(share=(int(number), n_cases))


RANKS = (
    Column("model", "text", value=lambda model: model.marked),
    Column("place", value=lambda model: model.ranked("place")),
    Column("mean rank", format=".2f", value=lambda model: model.ranked("mean_rank")),
    Column(
        f"{percent(1.0 - LEVEL)} interval",
        format=".2f",
        value=lambda model: Quantity(low=model.ranked("low"), high=model.ranked("high")),
    ),
    Column("won", value=lambda model: model.ranked("won")),
    Column("tied with best", value=lambda model: model.share(model.ranked("like_best"))),
    Column("results", value=lambda model: model.share(model.section.n_results(model.name))),
)
"""The columns of the ranks, made from a `Model`."""


def _ranks(section: Section, board: Leaderboard) -> Table:
    better = "larger" if board.key.sign < 0.0 else "smaller"
    apart = f" | {SELECTION_MARK}s: not a fair comparison" if section.selects_on_test else ""
    return Table.of(
        f"Leaderboard, {counted(len(section.cases), 'comparison')}: {_scope(section)}{apart} | "
        f"sorted by mean rank of {board.key.text} ({better} is better)",
        RANKS,
        [Model(section, name) for name in section.models],
        [*_rank_notes(section, board), *board.provenance],
        about=_about(section, "ranks"),
    )


def _scope(section: Section) -> str:
    names = [scored.name for scored in section.cases]
    protocols = list(dict.fromkeys(name.protocol for name in names))
    kinds, seeds = " and ".join(section.kinds), _several({name.seed for name in names}, "seed")
    return f"{_datasets(names)} ({kinds}) under {', '.join([*protocols, *seeds])}"


def _datasets(names: Iterable[CaseName]) -> str:
    """Return e.g. "5 x kr10-twin, ur5"."""
    families = {dataset_of(name): family_of(name) for name in names}
    return ", ".join(
        members[0] if len(members) == 1 else f"{len(members)} x {family}"
        for family, members in grouped(families, families.__getitem__).items()
    )


def _several(numbers: Collection[object], thing: str) -> list[str]:
    """Return ["2 seeds"] of two different ones, nothing of one."""
    return [counted(len(numbers), thing)] if len(numbers) > 1 else []


def _rank_notes(section: Section, board: Leaderboard) -> Iterator[str]:
    """Yield what must be read with the ranks, most important first."""
    shown = [scored.case.shown for scored in section.cases]
    yield from dict.fromkeys(one.warning for one in shown if one.warning)
    if "measured" in section.kinds and len(section.kinds) > 1:
        simulated = dict.fromkeys(
            family_of(scored.name)
            for scored in section.cases
            if scored.case.shown.kind != "measured"
        )
        yield f"Simulated, not measured: {', '.join(simulated)}."
    called = labels(scored.case.name for scored in section.cases)
    if section.unranked:
        yield f"Without a mean rank: {_lacking(section.unranked, called)}."
    cut = [scored for scored in section.cases if scored.left_out]
    if cut:
        yield f"{called[cut[0].name]}{and_more(cut)}: {cut[0].left_out}."
    if board.notes:
        yield f"{board.notes[0].removesuffix('.')}{and_more(board.notes)}."


MOST_LACKING = 4
"""So many missing results are named one by one."""


def _lacking(unranked: Mapping[str, Mapping[CaseName, str]], called: Mapping[CaseName, str]) -> str:
    """Return what each model lacks and why; where that is much, how much, and who says it."""
    every = sum(map(len, unranked.values())) <= MOST_LACKING
    parts = []
    for model, missing in unranked.items():
        reasons = grouped(missing, missing.__getitem__).items()
        places = [f"{', '.join(map(called.__getitem__, cases))}: {why}" for why, cases in reasons]
        named = f" ({'; '.join(places)})" if every else ""
        lacks = f"lacks {len(missing)} of {len(called)} results{named}"
        parts.append(f"{model} {lacks if missing else 'is the only model with all results'}")
    if every:
        return ", ".join(parts)
    more = f" and {counted(len(parts) - 3, 'more model')}" if len(parts) > 3 else ""
    return f"{', '.join(parts[:3])}{more}; `--format json` lists them, and why"


def _by_protocol(section: Section, key: SortKey) -> Iterator[Table]:
    """Yield a table for each robot type and protocol; its columns are the conditions."""
    apart = f" | {SELECTION_MARK}s" if section.selects_on_test else ""
    for (_, protocol), of_protocol in grouped(
        section.cases, lambda one: (family_of(one.name), one.name.protocol)
    ).items():
        n_datasets = len({dataset_of(one.name) for one in of_protocol})
        spread = ", mean ± standard deviation over data sets" if n_datasets > 1 else ""
        run = {model for one in of_protocol for model in one.case.competitors}
        mark = partial(section.mark_under, protocol=protocol)
        conditions = grouped(of_protocol, lambda one: one.name.condition).values()
        like = f"; {LIKE_BEST} no significant difference from the best, "
        like = "" if key.is_cost else like + correction_text(of_protocol)
        yield Table.of(
            f"{protocol} on {_datasets(one.name for one in of_protocol)}{apart} | "
            f"{key.text}{spread}",
            [
                Column("model", "text", value=lambda model: model),
                *(_condition_column(members, n_datasets, key) for members in conditions),
            ],
            [Name(model, mark(model)) for model in section.models if model in run],
            [
                f"{BEST} best mean of the column{like}.",
                *_few_splits(of_protocol),
                *caveats_of(one.case for one in of_protocol),
            ],
            unit=PRINTED[key.metric.unit][0],
            about=_about(section, "scores by protocol"),
        )


def _condition_column(cases: Sequence[ScoredCase], n_datasets: int, key: SortKey) -> Column:
    """Return the column of a condition: each model's mean score over the data sets."""
    name = cases[0].name
    datasets = dict.fromkeys(dataset_of(one.name) for one in cases)
    seeds = sorted({one.name.seed for one in cases})
    several = [counted(len(datasets), "data set")] if n_datasets > 1 else []
    counts = ", ".join([*several, *_several(seeds, "seed")])
    scores = _mean_scores(cases, key)
    return Column(
        f"{name.condition or name.protocol}{f' ({counts})' if counts else ''}",
        unit=PRINTED[key.metric.unit][0],
        format=number_format(key.metric),
        about={
            **{"metric": key.metric.key, "axis": key.axis, "protocol": name.protocol},
            **{"condition": name.condition, "datasets": [*datasets], "seeds": seeds},
        },
        value=lambda model: scores.get(model.text),
    )


FEW_SPLITS = 5
"""With fewer, only very large differences are significant among several models."""


def _few_splits(scored: Sequence[ScoredCase]) -> Iterator[str]:
    fewest = min(len(case.slots) for case in scored)
    if scored[0].key.is_cost or not 1 < fewest < FEW_SPLITS or scored[0].case.shown.pooled:
        return
    yield f"{fewest} splits show only very large differences; --splits {FEW_SPLITS} shows more."


def _mean_scores(cases: Sequence[ScoredCase], key: SortKey) -> dict[str, Quantity]:
    """Return each model's score over the data sets of some cases, as printed.

    A mean over some of the data sets alone has their share, and is never the best.
    """
    _, factor = PRINTED[key.metric.unit]
    run = sorted({model for one in cases for model in one.case.competitors})
    of_cases = DataFrame([{m: factor * one.mean(m) for m in one.scores} for one in cases])
    datasets = np.array([dataset_of(one.name) for one in cases])  # a list may name columns
    of_data = of_cases.reindex(columns=run).groupby(datasets)
    scores = of_data.mean(skipna=False)  # (data sets, models); NaN where a case has none
    mean, spread, count = scores.mean(), scores.std(), scores.count()
    complete = complete_models(cases)
    best = (key.sign * mean[[*complete]]).min()
    times = times_like_best(cases, complete) if complete else None
    found = {}
    for model in run:
        n, n_all = int(count[model]), len(scores)
        like = times is not None and times[model] > 0.5 * len(cases)
        is_best = model in complete and key.sign * mean[model] == best
        found[model] = Quantity(
            float(mean[model]) if n else None,
            float(spread[model]) if n > 1 else None,
            share=(n, n_all) if 0 < n < n_all else None,
            mark=BEST if is_best else LIKE_BEST if like else "",
            status=max(one.failed(model) for one in cases),
        )
    return found


def _costs(section: Section) -> Table:
    """Return what models cost, in the ranks' order; models without recorded costs are omitted."""
    models = [Model(section, name) for name in section.models]
    n_fits = sum(len(model.costs) for model in models)
    return Table.of(
        f"Costs of {counted(n_fits, 'fit')} | median (lowest to highest), not ranked",
        COSTS,
        [model for model in models if model.costs],
        ["wall times depend on the machine; a cached pre-training costs nothing."],
        about=_about(section, "costs"),
    )


def _spread(key: str, model: Model) -> Quantity | None:
    """Return median and range of a cost, as printed, over the fits that know it."""
    metric = METRICS[key]
    assert metric.of_cost is not None
    _, factor = PRINTED[metric.unit]
    known = [factor * value for value in map(metric.of_cost, model.costs) if value is not None]
    return Quantity(float(np.median(known)), low=min(known), high=max(known)) if known else None


def _range(found: Quantity, unit: str, number: Callable[[float], str]) -> str:
    """Return "2 ms (1 to 3)", or "2 ms" where all are alike."""
    median, low, high = (number(value or 0.0) for value in (found.value, found.low, found.high))
    shown = f"{median} {unit}".rstrip()
    return shown if low == high else f"{shown} ({low} to {high})"


def _time(found: Quantity) -> str:
    """Return a time [ms] in the unit that suits its size."""
    units = (("us", 1e3), ("ms", 1.0), ("s", 1e-3))
    median = found.value or 0.0
    unit, factor = next((one for one in units if median * one[1] < 999.5), units[-1])
    return _range(found, unit, lambda value: _three_digits(value * factor))


def _three_digits(value: float) -> str:
    """Return a positive number with three digits that count: 0.0123, 1.23, 12,300."""
    decimals = 2 - math.floor(math.log10(value)) if value > 0.0 else 0
    return f"{round(value, decimals):,.15g}"


def _cost_column(key: str, name: str, written: Callable[[Quantity], str]) -> Column:
    unit, _ = PRINTED[METRICS[key].unit]
    return Column(
        name, unit=unit, format=written, about={"metric": key}, value=partial(_spread, key)
    )


COSTS = (
    RANKS[0],
    _cost_column("fit-time", "fit time", _time),
    _cost_column(
        "throughput", "predictions a second", lambda found: _range(found, "", _three_digits)
    ),
    _cost_column("latency", "latency of one", _time),
    _cost_column("memory", "memory [MiB]", lambda found: _range(found, "", "{:.1f}".format)),
    Column("fits", value=lambda model: len(model.costs)),
)
"""The columns of the costs, made from a `Model`."""


def _scores(section: Section, board: Leaderboard) -> Table:
    """Return each model's score in each case, or why it has none."""
    unit, factor = PRINTED[board.key.metric.unit]
    rows: list[list[Entry]] = [
        [
            Name(model, section.mark_under(model, case.name.protocol)),
            *astuple(case.name),
            *(len(case.slots), case.left_out),
            factor * case.mean(model)
            if model in case.scores
            else Quantity(status=case.missing.get(model, "")),
        ]
        for case in section.cases
        for model in section.models
    ]
    return Table(
        f"Scores | {board.key.text}",
        [
            *text_columns(
                "model", *(one.name for one in fields(CaseName)), "splits", "splits left out"
            ),
            Column(board.key.text, unit=unit, format=number_format(board.key.metric)),
        ],
        rows,
        board.notes,
        about=_about(section, "scores"),
        formats=("json",),
    )
