"""A leaderboard as tables. Here SI becomes mm and per cent.

docs/comparing.md says what the columns and marks mean.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from stiff_bench.analysis.leaderboard import (
    Leaderboard,
    Section,
    and_more,
    caveats_of,
)
from stiff_bench.analysis.ranking import (
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
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table, text_columns
from stiff_bench.tables.units import PRINTED, counted, percent
from stiff_protocols.contract.record import Cost
from stiff_protocols.scoring.metrics import METRICS
from stiff_protocols.scoring.paired import LEVEL

BEST, LIKE_BEST = "*", "≈"


def render_leaderboard(board: Leaderboard, fmt: str, command: str) -> str:
    """Return the tables as text of a format of `render`; `command` makes them.

    csv has the ranks alone, a line a model and number; json has each model's score in each
    case, too.
    """
    tables = []
    for section in board.sections:
        tables += [_ranks(section, board)] if fmt == "csv" else section_tables(section, board)
        tables += [_scores(section, board)] if fmt == "json" else []
    about = {"sort_key": board.key.text, "direction": board.key.metric.direction}
    return render(tables, fmt, command, about=about)


def section_tables(section: Section, board: Leaderboard) -> list[Table]:
    """Return ranks, scores by protocol and costs of one section."""
    tables = [_ranks(section, board), *_by_protocol(section, board.key)]
    tables.append(_costs(section))
    return [replace(table, brief=True) for table in tables if table.rows]


def _about(section: Section, table: str) -> dict[str, object]:
    return {"table": table, "selects_on_test": section.selects_on_test}


def _ranks(section: Section, board: Leaderboard) -> Table:
    n_cases = len(section.cases)
    better = "larger" if board.key.sign < 0.0 else "smaller"
    apart = f" | {SELECTION_MARK}s: not a fair comparison" if section.selects_on_test else ""
    rows: list[list[Entry]] = [
        [
            *(Name(model.name, section.mark_under(model.name)), place, model.mean_rank),
            Quantity(low=model.low, high=model.high) if np.isfinite(model.low) else None,
            model.won,
            None if model.like_best is None else Quantity(share=(model.like_best, n_cases)),
            Quantity(share=(n_cases, n_cases)),
        ]
        for model in section.ranked
        for place in [1 + sum(one.mean_rank < model.mean_rank for one in section.ranked)]
    ]
    for name, missing in section.unranked.items():
        done = Quantity(share=(n_cases - len(missing), n_cases))
        rows.append([Name(name, section.mark_under(name)), *[None] * 5, done])
    return Table(
        title=(
            f"Leaderboard, {counted(n_cases, 'comparison')}: {_scope(section)}{apart} | sorted "
            f"by mean rank of {board.key.text} ({better} is better)"
        ),
        columns=[
            *(Column("model", "text"), Column("place"), Column("mean rank", format=".2f")),
            Column(f"{percent(1.0 - LEVEL)} interval", format=".2f"),
            *(Column("won"), Column("tied with best"), Column("results")),
        ],
        rows=rows,
        notes=[*_rank_notes(section, board), *board.provenance],
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
    unit, _ = PRINTED[key.metric.unit]
    apart = f" | {SELECTION_MARK}s" if section.selects_on_test else ""
    for (_, protocol), of_protocol in grouped(
        section.cases, lambda one: (family_of(one.name), one.name.protocol)
    ).items():
        n_datasets = len({dataset_of(one.name) for one in of_protocol})
        spread = ", mean ± standard deviation over data sets" if n_datasets > 1 else ""
        columns, scores = [Column("model", "text")], []
        for condition, members in grouped(of_protocol, lambda one: one.name.condition).items():
            datasets = dict.fromkeys(dataset_of(one.name) for one in members)
            seeds = sorted({one.name.seed for one in members})
            about = {
                **{"metric": key.metric.key, "axis": key.axis, "protocol": protocol},
                **{"condition": condition, "datasets": [*datasets], "seeds": seeds},
            }
            several = [counted(len(datasets), "data set")] if n_datasets > 1 else []
            counts = ", ".join([*several, *_several(seeds, "seed")])
            heading = f"{condition or protocol}{f' ({counts})' if counts else ''}"
            number = number_format(key.metric)
            columns.append(Column(heading, unit=unit, format=number, about=about))
            scores.append(_scores_of(section, members, key))
        like = f"; {LIKE_BEST} no significant difference from the best, "
        like = "" if key.is_cost else like + correction_text(of_protocol)
        yield Table(
            title=f"{protocol} on {_datasets(one.name for one in of_protocol)}{apart} | "
            f"{key.text}{spread}",
            columns=columns,
            rows=[
                [
                    Name(model, section.mark_under(model, protocol)),
                    *(column.get(model) for column in scores),
                ]
                for model in section.models
                if any(model in column for column in scores)
            ],
            notes=[
                f"{BEST} best mean of the column{like}.",
                *_few_splits(of_protocol),
                *caveats_of(one.case for one in of_protocol),
            ],
            unit=unit,
            about=_about(section, "scores by protocol"),
        )


FEW_SPLITS = 5
"""With fewer, only very large differences are significant among several models."""


def _few_splits(scored: Sequence[ScoredCase]) -> Iterator[str]:
    fewest = min(len(case.slots) for case in scored)
    if scored[0].key.is_cost or not 1 < fewest < FEW_SPLITS or scored[0].case.shown.pooled:
        return
    yield f"{fewest} splits show only very large differences; --splits {FEW_SPLITS} shows more."


def _scores_of(section: Section, scored: Sequence[ScoredCase], key: SortKey) -> dict[str, Quantity]:
    """Return each model's score over the data sets of a column; some of them alone are no mean."""
    complete = complete_models(scored)
    _, factor = PRINTED[key.metric.unit]
    datasets = grouped(scored, lambda one: dataset_of(one.name))
    means = {
        model: [
            factor * float(np.mean([one.mean(model) for one in members]))
            for members in datasets.values()
            if all(model in one.scores for one in members)
        ]
        for model in section.models
        if any(model in one.case.competitors for one in scored)
    }
    best = min((key.sign * np.mean(means[model]) for model in complete), default=np.nan)
    times = times_like_best([one.ranking(complete) for one in scored]) if complete else None
    shown = () if times is None else zip(complete, times, strict=True)
    like = {model for model, number in shown if number > 0.5 * len(scored)}
    found = {}
    for model, values in means.items():
        mean = float(np.mean(values)) if values else None
        std = float(np.std(values, ddof=1)) if len(values) > 1 else None
        failed = max(one.failed(model) for one in scored)
        if len(values) < len(datasets):
            share = (len(values), len(datasets)) if values else None
            found[model] = Quantity(mean, std, share=share, status=failed)
        else:
            is_best = model in complete and key.sign * np.mean(values) == best
            mark = BEST if is_best else LIKE_BEST if model in like else ""
            found[model] = Quantity(mean, std, mark=mark)
    return found


def _costs(section: Section) -> Table:
    """Return what models cost, in the ranks' order; one whose costs nobody knows is not there."""
    costs = {
        model: [
            result.cost
            for scored in section.cases
            if model in scored.scores
            for result in scored.results[model]
            if result.cost is not None
        ]
        for model in section.models
    }
    n_results = sum(map(len, costs.values()))
    return Table(
        title=f"Costs of {counted(n_results, 'fit')} | median (lowest to highest), not ranked",
        columns=[
            Column("model", "text"),
            *_COSTS.values(),
            Column("fits"),
        ],
        rows=[
            [
                Name(model, section.mark_under(model)),
                *(_spread(key, of_model) for key in _COSTS),
                len(of_model),
            ]
            for model, of_model in costs.items()
            if of_model
        ],
        notes=["wall times depend on the machine; a cached pre-training costs nothing."],
        about=_about(section, "costs"),
    )


def _spread(key: str, costs: Sequence[Cost]) -> Quantity | None:
    """Return median and range of a cost, as printed, over the results that know it."""
    metric = METRICS[key]
    assert metric.of_cost is not None
    _, factor = PRINTED[metric.unit]
    known = [factor * value for value in map(metric.of_cost, costs) if value is not None]
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


_COSTS = {
    key: Column(name, unit=PRINTED[METRICS[key].unit][0], format=written, about={"metric": key})
    for key, name, written in (
        ("fit-time", "fit time", _time),
        ("throughput", "predictions a second", lambda found: _range(found, "", _three_digits)),
        ("latency", "latency of one", _time),
        ("memory", "memory [MiB]", lambda found: _range(found, "", lambda size: f"{size:.1f}")),
    )
}
"""Metric -> its column."""


def _scores(section: Section, board: Leaderboard) -> Table:
    """Return each model's score in each case, or why it has none."""
    metric = board.key.metric
    unit, factor = PRINTED[metric.unit]
    rows: list[list[Entry]] = []
    for scored in section.cases:
        name = scored.name
        place = (
            *(name.dataset, name.data_sha256, name.source_sha256, name.protocol, name.condition),
            *(name.seed, len(scored.slots), scored.left_out),
        )
        for model in section.models:
            named = Name(model, section.mark_under(model, name.protocol))
            missing = Quantity(status=scored.missing.get(model, ""))
            score = scored.mean(model) * factor if model in scored.scores else missing
            rows.append([named, *place, score])
    return Table(
        title=f"Scores | {board.key.text}",
        columns=[
            *text_columns("model", "dataset", "data_sha256", "source_sha256", "protocol"),
            *text_columns("condition", "seed", "splits", "splits left out"),
            Column(board.key.text, unit=unit, format=number_format(metric)),
        ],
        rows=rows,
        notes=board.notes,
        about=_about(section, "scores"),
    )
