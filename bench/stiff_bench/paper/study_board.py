"""The leaderboard of a study: its board over robots and other tables."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import chain

from stiff_bench.analysis.answer import Answer
from stiff_bench.analysis.board import Board, without_seeds
from stiff_bench.analysis.board_tables import board_tables
from stiff_bench.analysis.collected import Case, StoredResults
from stiff_bench.analysis.leaderboard import section_of
from stiff_bench.analysis.leaderboard_tables import dataset_tables, plan_board
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.paper.study_file import Study
from stiff_bench.tables.table import Column, Entry, Table
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError

NOT_RUN = "not run here"
VERIFIED = "verified"
STATUS_NOTE = "reported: results of a submission whose code could not be run again."


def study_board(study: Study, stored: StoredResults) -> Board:
    """Return the board of the study's models, without its extras.

    Raises:
        ConfigError: the study names no board, or fewer than five robots have results.
    """
    stored = without_seeds(stored)
    columns = study.board
    if columns is None:
        raise ConfigError(f"{study.file}: [board] is missing: it names the protocol of the board")
    names = _models(stored.cases) - {*columns.extras, *columns.variants}
    board = Board(
        _answer(stored, columns.protocol, names),
        {
            heading: _answer(stored, protocol, names)
            for heading, protocol in columns.few.items()
            if any(case.name.protocol == protocol for case in stored.cases)
        },
        study.groups,
    )
    if not board.robots or not board.logs.columns.size:
        raise ConfigError("no model has all results on five robots: the study is not finished")
    return board


def study_board_tables(
    study: Study, stored: StoredResults, statuses: Mapping[str, str] | None = None
) -> list[Table]:
    """Return headline, board, measured data, and the extras.

    Args:
        study: with a board.
        stored: its results.
        statuses: model -> "verified" or "reported"; none: the board has no such column.

    Raises:
        ConfigError: as `study_board`.
    """
    board = study_board(study, stored)
    assert study.board is not None
    tables = plan_board(board, (study.board.protocol, ""), study.board.controls)
    if statuses:
        tables[0] = _with_statuses(tables[0], board, statuses)
    measured = [case for cases in board.answer.measured.values() for case in cases]
    if measured:
        tables += dataset_tables(section_of(board.answer.over(measured)))
    if study.board.variants:
        tables += _variants(study, without_seeds(stored), board)
    if study.board.extras:
        tables.append(_extras(study, without_seeds(stored), board))
    return tables


def _with_statuses(table: Table, board: Board, statuses: Mapping[str, str]) -> Table:
    """Return the board with the column of status at its end."""
    status_of_row = [statuses.get(row.name, VERIFIED) for row in board.rows]
    rows = [[*row, status] for row, status in zip(table.rows, status_of_row, strict=True)]
    columns = [*table.columns, Column("status", "text")]
    return replace(table, columns=columns, rows=rows, notes=[*table.notes, STATUS_NOTE])


def _answer(stored: StoredResults, protocol: str, names: Collection[str]) -> Answer:
    cases = [case for case in stored.cases if case.name.protocol == protocol]
    return Answer.of(stored, sort_key("norm", None), cases, names)


def _models(cases: Collection[Case]) -> set[str]:
    return {name for case in cases for name in case.competitors}


def _variants(study: Study, stored: StoredResults, board: Board) -> list[Table]:
    """Return the board of the variants and what they are compared with, on the first seed."""
    columns = study.board
    assert columns is not None
    variants = {*columns.variants}
    pairs = [pair for pair in columns.controls.items() if variants.intersection(pair)]
    names = {*variants, *chain.from_iterable(pairs), REFERENCE_MODEL}
    answer = _answer(stored, columns.protocol, names)
    seed = min(case.name.seed for case in answer.cases)
    first = answer.over([case for case in answer.cases if case.name.seed == seed])
    few = {heading: _answer(stored, columns.few[heading], names) for heading in board.few}
    tables = board_tables(Board(first, few, study.groups), dict(pairs))
    return [
        replace(table, title=f"Variants, first split: {table.title}", about={"table": "variants"})
        for table in tables
    ]


def _extras(study: Study, stored: StoredResults, board: Board) -> Table:
    """Return the board of models that need more packages; those without results say so."""
    assert study.board is not None
    extras = study.board.extras
    names = {*extras, REFERENCE_MODEL, board.best}
    of_extras = Board(_answer(stored, study.board.protocol, names))
    first, *_ = plan_board(of_extras, (study.board.protocol, ""))
    missing = [name for name in extras if name not in of_extras.logs]
    columns = [*first.columns, Column("run", "text")] if missing else first.columns
    with_scores = [[*row, None] if missing else row for row in first.rows]
    rows: list[list[Entry]] = [
        [name, *(None for _ in first.columns[1:]), NOT_RUN] for name in missing
    ]
    return replace(
        first,
        title=f"Models of other packages ({', '.join(extras)}) and the best",
        columns=columns,
        rows=[*with_scores, *rows],
        notes=[],
        about={"table": "extras"},
    )
