"""Web pages of a board and its models. SI is converted to mm here."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

from stiff_bench.analysis.board import Board, BoardRow, p95_error, path_error
from stiff_bench.analysis.board_tables import (
    RATIO_FORMAT,
    VERDICT_MARKS,
    board_headline,
    board_sentences,
)
from stiff_bench.analysis.scored_case import ScoredCase
from stiff_bench.report.first_screen import (
    FIRST_MODELS,
    Axis,
    Chart,
    FirstScreen,
    MatrixCell,
    MatrixPart,
    ModelRow,
    ratio_style,
)
from stiff_bench.tables.table import Column, Entry, Name, Table, text_columns
from stiff_bench.tables.units import MM, counted, duration, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.scoring.paired import LEVEL

EVERY = "all"
"""Entry for all plans, or all physics."""


def board_screen(board: Board) -> FirstScreen:
    """Return the first screen: headline, models with intervals, and ratios by group of data."""
    rows = board.rows
    bounds = [bound for row in rows for bound in (row.mean.low, row.mean.high)]
    axis = Axis.over(bounds)
    n_measured = len(board.measured)
    return FirstScreen(
        board_headline(board),
        board_sentences(board),
        [f"{board.answer.claim_scope}, {n_measured} measured", f"{len(rows)} models"],
        "error / VJM's error",
        f"mean and {percent(1.0 - LEVEL)} interval over {board.answer.claim_scope}",
        axis.ticks,
        [_model_row(board, row, axis) for row in rows],
        "error / VJM's error by plan and physics, measured robot, and number of poses",
        [_matrix(board)],
        f"Show all {len(rows)} models" if len(rows) > FIRST_MODELS else "",
    )


def _model_row(board: Board, row: BoardRow, axis: Axis) -> ModelRow:
    ratios = [board.robot_ratio(robot, row.name) for robot in board.robots]
    mean = row.mean
    text = f"{mean.ratio:.2f} times the VJM's error, {mean.low:.2f} to {mean.high:.2f}"
    is_reference = row.name == REFERENCE_MODEL
    return ModelRow(
        str(Name(row.name, row.mark)),
        f"{mean.ratio:{RATIO_FORMAT}}",
        "baseline" if is_reference else f"{100.0 * (mean.ratio - 1.0):+.0f} %",
        Chart(axis.at(mean.ratio), axis.at(mean.low), axis.at(mean.high), text),
        f"{sum(ratio < 1.0 for ratio in ratios)} / {len(ratios)}",
        f"{sum(ratio > 1.0 for ratio in ratios)}",
        duration(row.fit_s),
    )


def _matrix(board: Board) -> MatrixPart:
    """Return ratios: a column for each group, measured data set and number of poses."""
    headings = [
        *(("simulated", group) for group in board.groups),
        *(("measured", dataset) for dataset in board.measured),
        *(("fewer poses", heading) for heading in board.few),
    ]

    def ratio(row: BoardRow, kind: str, name: str) -> float | None:
        if kind == "measured":
            return row.measured[name].ratio if name in row.measured else None
        return (row.groups if kind == "simulated" else row.few).get(name)

    best = {
        heading: min(
            (value for row in board.rows if (value := ratio(row, *heading)) is not None),
            default=None,
        )
        for heading in headings
    }

    def cell(row: BoardRow, heading: tuple[str, str]) -> MatrixCell:
        value = ratio(row, *heading)
        text = "-" if value is None else f"{value:{RATIO_FORMAT}}"
        return MatrixCell(text, ratio_style(value), value is not None and value == best[heading])

    kinds = [kind for kind, _ in headings]
    return MatrixPart(
        [(kind, kinds.count(kind)) for kind in dict.fromkeys(kinds)],
        [(name, 1) for _, name in headings],
        [],
        [name for _, name in headings],
        [
            (str(Name(row.name, row.mark)), [cell(row, heading) for heading in headings])
            for row in board.rows
        ],
        [],
    )


class _ScopedRow(NamedTuple):
    """A model on some of the data."""

    model: str
    kind: str
    plan: str
    physics: str
    ratio: float
    verdict: str
    fit_s: float | None


def scoped_table(board: Board) -> Table:
    """Return the filterable board: a row per model and plan, physics, or measured robot."""
    rows = [row for of_model in board.rows for row in _scoped(board, of_model)]
    return Table.of(
        "Board by data, plan and physics",
        [
            Column("model", "text", value=lambda row: row.model),
            Column("data", "text", value=lambda row: row.kind),
            Column("plan", "text", value=lambda row: row.plan),
            Column("physics", "text", value=lambda row: row.physics),
            Column("error / VJM's", format=RATIO_FORMAT, value=lambda row: row.ratio),
            Column("against the VJM", "text", value=lambda row: row.verdict),
            Column("fit", unit="s", format=".2g", value=lambda row: row.fit_s),
        ],
        rows,
        ["The boxes under the headings filter: narrow, rigid, measured, or a number such as < 1."],
    )


def _scoped(board: Board, row: BoardRow) -> Iterable[_ScopedRow]:
    yield _ScopedRow(row.name, "simulated", EVERY, EVERY, row.mean.ratio, row.verdict, row.fit_s)
    for group, ratio in row.groups.items():
        physics, _, plan = group.partition(", ")
        yield _ScopedRow(row.name, "simulated", plan, physics, ratio, "", row.fit_s)
    for dataset, score in row.measured.items():
        facts = (score.ratio, VERDICT_MARKS[score.verdict], row.fit_s)
        yield _ScopedRow(row.name, f"measured ({dataset})", "-", "-", *facts)


class _CaseRow(NamedTuple):
    """A model on one data set: its means over seeds and splits."""

    dataset: str
    robot: str
    group: str
    error_mm: float
    ratio: float
    p95_mm: float | None
    path_mm: float | None
    over_noise: float | None


ERROR_COLUMNS = (
    Column("3-D error", unit="mm", format=".4f", value=lambda row: row.error_mm),
    Column("error / VJM's", format=RATIO_FORMAT, value=lambda row: row.ratio),
    Column("95th percentile", unit="mm", format=".4f", value=lambda row: row.p95_mm),
    Column("left on tool paths", unit="mm", format=".4f", value=lambda row: row.path_mm),
    Column("error / noise", format=RATIO_FORMAT, value=lambda row: row.over_noise),
)
"""Numbers of a model on a data set, made from a `_CaseRow`."""


def model_table(board: Board, name: str) -> Table:
    """Return a model's errors on each data set, the best ratio first."""
    group_of = {dataset: group for group, members in board.groups.items() for dataset in members}
    by_data: dict[str, list[ScoredCase]] = {}
    for case in board.answer.cases:
        if board.answer.ratio(name, case) is not None:
            by_data.setdefault(case.name.dataset, []).append(case)
    rows = [
        _case_row(
            board, name, dataset, cases, group_of.get(dataset, cases[0].case.presentation.kind)
        )
        for dataset, cases in by_data.items()
    ]
    rows.sort(key=lambda row: row.ratio)
    return Table.of(
        "Errors on each data set, best ratio first",
        [
            Column("data set", "text", value=lambda row: row.dataset),
            Column("robot", "text", value=lambda row: row.robot),
            Column("physics and plan", "text", value=lambda row: row.group),
            *ERROR_COLUMNS,
        ],
        rows,
    )


def _case_row(
    board: Board, name: str, dataset: str, cases: Sequence[ScoredCase], group: str
) -> _CaseRow:
    errors = [case.mean(name) for case in cases]
    tails = [error for case in cases if (error := p95_error(name, case)) is not None]
    paths = [error for case in cases if (error := path_error(name, case)) is not None]
    floors = [floor for case in cases if (floor := board.answer.noise(case))]
    ratios = [ratio for case in cases if (ratio := board.answer.ratio(name, case)) is not None]
    return _CaseRow(
        dataset,
        cases[0].data.robot.name,
        group,
        MM * _mean(errors),
        math.exp(_mean([math.log(ratio) for ratio in ratios])),
        MM * _mean(tails) if tails else None,
        _mean(paths) if paths else None,
        _mean(errors) / _mean(floors) if floors else None,
    )


def _mean(numbers: Collection[float]) -> float:
    return float(sum(numbers) / len(numbers))


def dataset_table(board: Board, dataset: str) -> Table:
    """Return the models on one data set, the smallest ratio first."""
    cases = [case for case in board.answer.cases if case.name.dataset == dataset]
    cases_of = {
        row.name: [case for case in cases if board.answer.ratio(row.name, case) is not None]
        for row in board.rows
    }
    rows = [_case_row(board, name, name, scored, "") for name, scored in cases_of.items() if scored]
    rows.sort(key=lambda row: row.ratio)
    fewer = [name for name, scored in cases_of.items() if 0 < len(scored) < len(cases)]
    return Table.of(
        "Models on this data set, smallest ratio first",
        [
            Column("model", "text", value=lambda row: row.dataset),
            *ERROR_COLUMNS,
        ],
        rows,
        [f"With fewer results, and the VJM's of the same splits: {', '.join(fewer)}."]
        * bool(fewer),
    )


def model_sentences(board: Board, row: BoardRow) -> list[tuple[str, str]]:
    """Return the scores of a model in sentences."""
    if row.name == REFERENCE_MODEL:
        return [("Role", "the baseline: the errors of all models are divided by its errors.")]
    ratios = {robot: board.robot_ratio(robot, row.name) for robot in board.robots}
    best = min(ratios, key=lambda robot: ratios[robot])
    lines = [
        (
            "Over robots",
            f"{row.mean.ratio:.2f} times the VJM's error ({row.mean.low:.2f} to "
            f"{row.mean.high:.2f}, {percent(1.0 - LEVEL)} interval over "
            f"{board.answer.claim_scope}); {row.verdict}.",
        ),
        (
            "Where",
            f"best on {best} ({ratios[best]:.2f}), worst on {row.worst_robot} ({row.worst:.2f}); "
            f"the smallest error of all models on {row.won} of {counted(len(ratios), 'robot')}.",
        ),
    ]
    for dataset, score in row.measured.items():
        verdict = VERDICT_MARKS[score.verdict] or "not tested"
        lines.append(
            (f"Measured, {dataset}", f"{score.ratio:.2f} times the VJM's error ({verdict}).")
        )
    return lines


def facts_table(facts: Mapping[str, Entry], title: str) -> Table:
    """Return facts in two columns."""
    return Table(
        title,
        text_columns("fact", "value"),
        [[name, str(value)] for name, value in facts.items() if value not in ("", None)],
    )
