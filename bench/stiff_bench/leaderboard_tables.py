"""A leaderboard -> tables of text. Here SI becomes mm and per cent."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import compress

import numpy as np

from stiff_bench.analyses_table import analyses_table
from stiff_bench.board_columns import Column, ColumnValue
from stiff_bench.contest_name import labels
from stiff_bench.cost_table import cost_table
from stiff_bench.grouped import grouped
from stiff_bench.leaderboard import Leaderboard, RankedModel, Section, UnrankedModel
from stiff_bench.leaderboard_data import as_csv, as_json
from stiff_bench.rank_analysis import RankAnalysis
from stiff_bench.render import TextTable, render_texts, value_text
from stiff_bench.same_robot import dataset_of, of_families
from stiff_bench.sort_key import SortKey
from stiff_bench.tables import SELECTION_MARK, Value
from stiff_bench.units import PRINTED, percent
from stiff_bench.words import counted, marked
from stiff_protocols.bootstrap import RANK_RESAMPLES
from stiff_protocols.paired import LEVEL

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
    datasets = dict.fromkeys(dataset_of(field.name.dataset) for field in section.fields)
    protocols = list(dict.fromkeys(field.name.protocol for field in section.fields))
    kinds = " and ".join(section.kinds)
    seeds = _seeds(len({field.name.seed for field in section.fields}))
    return f"{of_families(list(datasets))} ({kinds}) under {', '.join([*protocols, *seeds])}"


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
        "like the best: contests in which it is the best or not distinguishable from the best "
        f"({tests}; level {LEVEL:g})."
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
        yield TextTable(
            title=f"{protocol} on {of_families(datasets)}{apart} | {key.text}{spread}",
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
