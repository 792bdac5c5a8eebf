"""A leaderboard -> tables of text. Here SI becomes mm and per cent."""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import compress
from typing import Any

import numpy as np

from stiff_bench.analysis.costs import ModelCost, cost_table, model_costs
from stiff_bench.analysis.critical_difference import RankAnalysis
from stiff_bench.analysis.leaderboard import (
    Column,
    ColumnValue,
    Leaderboard,
    RankedModel,
    Section,
    UnrankedModel,
)
from stiff_bench.analysis.ranking import ScoredContest
from stiff_bench.analysis.same_robot import dataset_of, family_of, of_families, of_robots
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.store.names import grouped, labels
from stiff_bench.tables.render import TextTable, csv_cells, render_texts, value_text
from stiff_bench.tables.table import SELECTION_MARK, Value
from stiff_bench.tables.units import PRINTED, counted, marked, percent
from stiff_protocols.scoring.bootstrap import RANK_RESAMPLES
from stiff_protocols.scoring.metrics import METRICS
from stiff_protocols.scoring.paired import LEVEL


def analyses_table(section: Section, key: SortKey) -> TextTable:
    """Return a row for each analysis of a section that has an outcome."""
    found = [analysis for analysis in section.analyses if analysis.outcome is not None]
    types = {robot.type for analysis in found for robot in analysis.robots}
    notes = [
        'Friedman: p-value of "all models are equal". CD: mean ranks over robots that are at '
        f"least so far apart differ (Nemenyi, level {LEVEL:g}). Pairs: told apart by Nemenyi's and "
        "by Conover's test (Holm). Groups: models that are not told apart. A robot counts once: "
        "scores on several data sets of it (loads, sensors, seeds) are averaged.",
    ]
    if len(types) == 1:
        notes.append(
            f"all robots are of one type ({types.pop()}, "
            f"{' and '.join(section.kinds)}): what holds for its specimens need not hold for "
            "another robot."
        )
    if len(found) > 1:
        notes.append(
            "all protocols together: the score of a model on a robot is its mean rank over the "
            "contests there."
        )
    agreeing = [len(analysis.robots) for analysis in found if _robots_agree(analysis)]
    if agreeing:
        notes.append(
            "Conover: - where all robots agree on every rank. Without any disagreement to measure "
            f"by it would be certain of every difference; {min(agreeing)} robots that agree have "
            f"an exact two-sided p of {2.0 * 0.5 ** min(agreeing):.3g} for a pair."
        )
    return TextTable(
        title=f"Critical difference over robots | {key.text}",
        header=(
            "protocol, condition",
            "robots",
            "models",
            "Friedman p",
            "CD",
            "pairs: Nemenyi",
            "pairs: Conover",
            "groups, best first",
        ),
        rows=[_analysis_cells(analysis) for analysis in found],
        notes=[*notes, *section.caveats],
    )


def _robots_agree(analysis: RankAnalysis) -> bool:
    return analysis.differs and analysis.outcome is not None and analysis.outcome.conover is None


def _analysis_cells(analysis: RankAnalysis) -> list[str]:
    outcome = analysis.outcome
    assert outcome is not None
    upper = np.triu_indices(len(analysis.models), k=1)
    told = [
        "-"
        if p is None or not analysis.differs
        else f"{(p[upper] < LEVEL).sum()} of {len(p[upper])}"
        for p in (outcome.nemenyi, outcome.conover)
    ]
    groups = [f"{{{', '.join(analysis.models[i] for i in group)}}}" for group in outcome.groups]
    return [
        analysis.text,
        of_robots(analysis.families),
        str(len(analysis.models)),
        f"{outcome.friedman_p:.2g}",
        f"{outcome.critical_difference:.2f}",
        *told,
        (", ".join(groups) or "none") if analysis.differs else "all (Friedman)",
    ]


_CSV_HEADER = (
    *("selects_on_test", "model", "mark", "dataset", "data_sha256", "protocol", "condition"),
    *("seed", "splits", "quantity", "value", "low", "high", "unit", "note"),
)


def as_csv(board: Leaderboard) -> str:
    """Return a line for each mean rank, each model's score in each contest, and each cost.

    A missing score is a line without a value, with the reason.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_CSV_HEADER)
    for section in board.sections:
        for rows in (_csv_ranks(section, board), _csv_scores(section, board), _csv_costs(section)):
            writer.writerows(map(csv_cells, rows))
    return out.getvalue().rstrip("\n")


def _csv_ranks(section: Section, board: Leaderboard) -> Iterator[list[object]]:
    quantity = f"mean rank of {board.key.text}"
    for model in section.ranked:
        about = [section.selects_on_test, model.name, model.mark, *[""] * 6, quantity]
        yield [*about, *_numbers(model.mean_rank, model.low, model.high), "", ""]
    for missing in section.unranked:
        about = [section.selects_on_test, missing.name, missing.mark, *[""] * 6, quantity]
        note = f"{len(missing.missing)} of {len(section.fields)} contests missing"
        yield [*about, "", "", "", "", note]


def _csv_scores(section: Section, board: Leaderboard) -> Iterator[list[object]]:
    unit, factor = PRINTED[board.key.metric.unit]
    for field in section.fields:
        name = field.name
        place = [name.dataset, name.data_sha256, name.protocol, name.condition, name.seed]
        for model in section.marks:
            mark = section.mark_under(name.protocol, model)
            about = [section.selects_on_test, model, mark, *place, len(field.slots), board.key.text]
            if model in field.scores:
                yield [*about, repr(field.mean(model) * factor), "", "", unit, field.left_out]
            else:
                yield [*about, "", "", "", unit, field.missing[model]]


def _csv_costs(section: Section) -> Iterator[list[object]]:
    for model in model_costs(section):
        note = f"median, lowest and highest of {counted(model.n_cells, 'cell')}"
        for key, spread in model.costs.items():
            unit, factor = PRINTED[METRICS[key].unit]
            about = [section.selects_on_test, model.name, model.mark, *[""] * 6, key]
            values = (spread.median * factor, spread.low * factor, spread.high * factor)
            yield [*about, *_numbers(*values), unit, note]


def _numbers(*values: float) -> list[str]:
    return ["" if math.isnan(value) else repr(value) for value in values]


def as_json(board: Leaderboard, command: str, provenance: Sequence[str]) -> str:
    """Return everything that the tables show and every score behind them."""
    content = {
        "command": command,
        "provenance": list(provenance),
        "sort_key": board.key.text,
        "direction": board.key.metric.direction,
        "notes": list(board.notes),
        "sections": [_section(section, board) for section in board.sections],
    }
    return json.dumps(_without_nan(content), indent=2, allow_nan=False)


def _section(section: Section, board: Leaderboard) -> dict[str, Any]:
    unit, factor = PRINTED[board.key.metric.unit]
    return {
        "selects_on_test": section.selects_on_test,
        "caveats": list(section.caveats),
        "ranked": [asdict(model) for model in section.ranked],
        "unranked": [
            {"name": model.name, "mark": model.mark, "missing": len(model.missing)}
            for model in section.unranked
        ],
        "contests": [_contest(field, section, factor) for field in section.fields],
        "columns": [
            {
                "family": column.family,
                "protocol": column.protocol,
                "condition": column.condition,
                "datasets": list(column.datasets),
                "seeds": list(column.seeds),
                "unit": unit,
                "values": {model: _scaled(v, factor) for model, v in column.values.items()},
            }
            for column in section.columns
        ],
        "analyses": [_analysis(analysis) for analysis in section.analyses],
        "costs": [_cost(model) for model in model_costs(section)],
    }


def _cost(model: ModelCost) -> dict[str, Any]:
    costs = {}
    for key, spread in model.costs.items():
        unit, factor = PRINTED[METRICS[key].unit]
        scaled = {name: value * factor for name, value in asdict(spread).items()}
        costs[key] = {**scaled, "unit": unit}
    return {"name": model.name, "mark": model.mark, "cells": model.n_cells, "costs": costs}


def _contest(field: ScoredContest, section: Section, factor: float) -> dict[str, Any]:
    shown = [model for model in section.marks if model in field.missing]
    return {
        **{name: value for name, value in asdict(field.name).items() if name != "variant"},
        "splits": len(field.slots),
        "splits_left_out": field.left_out,
        "scores": {model: field.mean(model) * factor for model in field.scores},
        "missing": {model: field.missing[model] for model in shown},
    }


def _scaled(value: ColumnValue, factor: float) -> dict[str, Any]:
    return {**asdict(value), "mean": value.mean * factor, "std": value.std * factor}


def _analysis(analysis: RankAnalysis) -> dict[str, Any]:
    found = {
        "protocol": analysis.protocol,
        "condition": analysis.condition,
        "robots": [robot.text for robot in analysis.robots],
        "models": list(analysis.models),
        "why_none": analysis.why_none,
    }
    outcome = analysis.outcome
    if outcome is None:
        return found
    return found | {
        "mean_ranks": outcome.mean_ranks.tolist(),
        "friedman_p": outcome.friedman_p,
        "critical_difference": outcome.critical_difference,
        "nemenyi": outcome.nemenyi.tolist(),
        "conover": None if outcome.conover is None else outcome.conover.tolist(),
        "groups": [[analysis.models[i] for i in group] for group in outcome.groups],
    }


def _without_nan(value: Any) -> Any:
    """Return the content with null for NaN, which JSON has not."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


BEST, LIKE_BEST = "*", "≈"
NAMED_BLOCKS = 4
"""Conditions that a note on missing results names; the tables by protocol show the others."""


def render_leaderboard(
    board: Leaderboard, fmt: str, command: str, provenance: Sequence[str]
) -> str:
    """Return the tables as text of the given format.

    Args:
        board: the numbers.
        fmt: "github", "latex", "csv", "html" or "json".
        command: that makes them.
        provenance: lines on where the results come from.
    """
    if fmt == "csv":
        return as_csv(board)
    if fmt == "json":
        return as_json(board, command, provenance)
    tables = [
        table for section in board.sections for table in section_tables(section, board, provenance)
    ]
    return render_texts(tables, fmt, command)


def section_tables(
    section: Section, board: Leaderboard, provenance: Sequence[str]
) -> list[TextTable]:
    """Return ranks, scores by protocol, critical differences and costs of one section."""
    tables = [_ranks(section, board, provenance), *_by_protocol(section, board.key)]
    if any(analysis.outcome for analysis in section.analyses):
        tables.append(analyses_table(section, board.key))
    costs = cost_table(section)
    return [*tables, costs] if costs.rows else tables


def _ranks(section: Section, board: Leaderboard, provenance: Sequence[str]) -> TextTable:
    n_contests = len(section.fields)
    better = "larger" if board.key.sign < 0.0 else "smaller"
    apart = f" | {SELECTION_MARK}s: not a fair comparison" if section.selects_on_test else ""
    return TextTable(
        title=(
            f"Leaderboard, {counted(n_contests, 'contest')}: {_scope(section)}{apart} | sorted by "
            f"mean rank of {board.key.text} ({better} is better)"
        ),
        header=(
            "model",
            "place",
            "mean rank",
            f"{percent(1.0 - LEVEL)} interval",
            "won",
            "like the best",
            "within CD of the best",
            "contests",
        ),
        rows=[
            *(_ranked_cells(place, m, n_contests) for place, m in enumerate(section.ranked, 1)),
            *(_unranked_cells(model, n_contests) for model in section.unranked),
        ],
        notes=(*_rank_notes(section, board.key), *section.caveats, *board.notes, *provenance),
    )


def _scope(section: Section) -> str:
    families = {dataset_of(field.name): family_of(field.name) for field in section.fields}
    protocols = list(dict.fromkeys(field.name.protocol for field in section.fields))
    kinds = " and ".join(section.kinds)
    seeds = _seeds(len({field.name.seed for field in section.fields}))
    return f"{of_families(families)} ({kinds}) under {', '.join([*protocols, *seeds])}"


def _seeds(number: int) -> list[str]:
    return [counted(number, "seed")] if number > 1 else []


def _ranked_cells(place: int, model: RankedModel, n_contests: int) -> list[str]:
    known = np.isfinite(model.low)
    return [
        marked(model.name, model.mark),
        str(place),
        f"{model.mean_rank:.2f}",
        f"{model.low:.2f} to {model.high:.2f}" if known else "-",
        str(model.won),
        "-" if model.like_best is None else f"{model.like_best}/{n_contests}",
        {True: "yes", False: "no", None: "-"}[model.within_cd],
        f"{n_contests}/{n_contests}",
    ]


def _unranked_cells(model: UnrankedModel, n_contests: int) -> list[str]:
    done = f"{n_contests - len(model.missing)}/{n_contests}"
    return [marked(model.name, model.mark), *["-"] * 6, done]


def _rank_notes(section: Section, key: SortKey) -> Iterator[str]:
    n_ranked = len(section.ranked)
    if n_ranked:
        yield (
            f"mean rank: of {counted(n_ranked, 'model')} with a result in every contest, ranked "
            "among themselves; 1 is the best, ties share their mean rank. A contest is a data set "
            "under a protocol, condition and seed; each weighs the same, so that a protocol weighs "
            f"as many as it has: {_weights(section)}."
        )
        if key.resamples:
            yield (
                f"interval: {RANK_RESAMPLES} draws of the poses, the same for all models and "
                "contests, widened to hold the mean rank where draws pull it to the middle. The "
                "fitted models and the data sets are held fixed: other training "
                "sets and other robots are not in it."
            )
        else:
            yield f"no intervals: {key.metric.key} is no mean over rows, as norm and mae are."
        yield _test_text(key)
        if any(model.within_cd is not None for model in section.ranked):
            yield (
                f"within CD of the best: in {section.analyses[0].text}, its mean rank over robots "
                "is less than the critical difference behind the best one, so that the two are "
                f"not told apart (Nemenyi, level {LEVEL:g}); yes for all where Friedman's test "
                "finds no difference. Place and CD go by ranks, * in the tables by the mean error: "
                "the best of one need not be the best of the other."
            )
    else:
        yield (
            "no mean ranks: fewer than two models have a result in every contest; name fewer "
            "contests (--dataset, --protocol) or finish the runs."
        )
    for model in section.unranked:
        yield _missing_note(model, len(section.fields))
    called = labels(field.contest.name for field in section.fields)
    for field in section.fields:
        if field.left_out:
            yield f"{called[field.name]}: {field.left_out}"
    yield from _no_analysis_notes(section.analyses)


def _test_text(key: SortKey) -> str:
    if key.is_cost:
        return (
            "costs: no test; the first fit of a run loads libraries, and a pre-training from the "
            "cache is free."
        )
    tests = "corrected t over splits, with Holm over the models"
    if key.resamples:
        tests = (
            "corrected t over splits, or Wilcoxon over poses where there is one split, with Holm "
            "over the models, and the bootstrap over poses must both find a difference"
        )
    return (
        "like the best: contests in which it is the best, equivalent to the best or not "
        f"distinguishable from it ({tests}; level {LEVEL:g})."
    )


def _weights(section: Section) -> str:
    counts = Counter(field.name.protocol for field in section.fields)
    return ", ".join(f"{protocol} {count}" for protocol, count in counts.items())


def _missing_note(model: UnrankedModel, n_contests: int) -> str:
    if not model.missing:
        return f"{model.name}: no mean rank, it is the only model with all contests."
    by_reason: dict[str, Counter[str]] = {}
    for contest, reason in model.missing.items():
        block = " | ".join(filter(None, (contest.protocol, contest.condition)))
        by_reason.setdefault(reason, Counter())[block] += 1
    parts = []
    for reason, blocks in by_reason.items():
        named = [
            f"{block} ({counted(n, 'data set')})" for block, n in [*blocks.items()][:NAMED_BLOCKS]
        ]
        more = blocks.total() - sum([*blocks.values()][:NAMED_BLOCKS])
        parts.append(f"{reason}: {', '.join(named)}{f' and {more} more' if more else ''}")
    return (
        f"{model.name}: no mean rank, {len(model.missing)} of {counted(n_contests, 'contest')} "
        f"missing. {'; '.join(parts)}."
    )


def _no_analysis_notes(analyses: Sequence[RankAnalysis]) -> Iterator[str]:
    by_reason: dict[str, list[str]] = {}
    for analysis in analyses:
        if analysis.why_none:
            by_reason.setdefault(analysis.why_none, []).append(analysis.text)
    for reason, blocks in by_reason.items():
        named = "" if len(blocks) == len(analyses) else f" of {'; '.join(blocks)}"
        yield f"no critical-difference analysis{named}: it {reason}."


def _by_protocol(section: Section, key: SortKey) -> Iterator[TextTable]:
    """Yield a table for each robot type and protocol; its columns are the conditions."""
    for (family, protocol), found in grouped(
        section.columns, lambda column: (column.family, column.protocol)
    ).items():
        datasets = list(dict.fromkeys(name for column in found for name in column.datasets))
        several = len(datasets) > 1
        spread = ", mean ± standard deviation over data sets" if several else ""
        apart = f" | {SELECTION_MARK}s" if section.selects_on_test else ""
        models = [m for m in section.marks if any(m in column.values for column in found)]
        named = of_families(dict.fromkeys(datasets, family))
        yield TextTable(
            title=f"{protocol} on {named}{apart} | {key.text}{spread}",
            header=("model", *(_heading(column, several) for column in found)),
            rows=[
                [
                    marked(model, section.mark_under(protocol, model)),
                    *(_column_text(column, model, key) for column in found),
                ]
                for model in models
            ],
            notes=(_marks_note(key, several), *section.caveats_of(family, protocol)),
        )


def _marks_note(key: SortKey, several: bool) -> str:
    parts = [
        f"{BEST} best mean of the models with all data sets of a column (place and CD go by ranks)",
        f"{LIKE_BEST} not distinguishable from the best in more than half of its data sets",
        "- not run, or run not finished",
        "(2/5) mean over 2 of 5 data sets, not comparable",
    ]
    shown = [True, not key.is_cost, True, several]
    return "; ".join(compress(parts, shown)) + "."


def _heading(column: Column, several: bool) -> str:
    name = column.condition or column.protocol
    datasets = [counted(len(column.datasets), "data set")] if several else []
    about = ", ".join([*datasets, *_seeds(len(column.seeds))])
    return f"{name} ({about})" if about else name


def _column_text(column: Column, model: str, key: SortKey) -> str:
    value = column.values.get(model)
    if value is None:
        return "-"
    if not value.n_datasets:
        return value.failed or "-"
    if value.n_datasets < len(column.datasets):
        some = f"({value.n_datasets}/{len(column.datasets)})"
        return " ".join(filter(None, (_number(value, key), some, value.failed)))
    mark = BEST if value.best else LIKE_BEST if value.like_best else ""
    return " ".join(filter(None, (_number(value, key), mark)))


def _number(value: ColumnValue, key: SortKey) -> str:
    unit, factor = PRINTED[key.metric.unit]
    return value_text(Value(value.mean * factor, value.std * factor, unit))
