"""The leaderboard of a study: its board over robots and other tables."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain

from stiff_bench.analysis.answer import Answer
from stiff_bench.analysis.board import Board, without_seeds
from stiff_bench.analysis.board_tables import board_tables
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.leaderboard import section_of
from stiff_bench.analysis.leaderboard_tables import dataset_tables, plan_board
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.paper.study_file import Study, StudyBoard
from stiff_bench.tables.table import Column, Entry, Table
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError

NOT_RUN = "not run here"
VERIFIED = "verified"
STATUS_NOTE = "reported: results of a submission whose code could not be run again."


@dataclass(frozen=True, eq=False)
class StudyResults:
    """A study with its results.

    Attributes:
        study: runs and page.
        stored: results of the study.
        statuses: model -> "verified" or "reported"; empty: no column of status.
    """

    study: Study
    stored: StoredResults
    statuses: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def merged(self) -> StoredResults:
        """The results, with the same name for all pre-training seeds of a model."""
        return without_seeds(self.stored)

    @cached_property
    def columns(self) -> StudyBoard:
        """The study's key `board`; ConfigError if it is missing."""
        if self.study.board is None:
            raise ConfigError(
                f"{self.study.file}: [board] is missing: it names the protocol of the board"
            )
        return self.study.board

    @cached_property
    def board(self) -> Board:
        """The board of the study's models, without its extras and variants.

        Raises:
            ConfigError: the study names no board, or fewer than five robots have results.
        """
        columns, cases = self.columns, self.merged.cases
        every = {name for case in cases for name in case.competitors}
        names = every - {*columns.extras, *columns.variants}
        few = {
            heading: self._answer(protocol, names)
            for heading, protocol in columns.few.items()
            if any(case.name.protocol == protocol for case in cases)
        }
        board = Board(self._answer(columns.protocol, names), few, self.study.groups)
        if not board.robots or not board.logs.columns.size:
            raise ConfigError("no model has all results on five robots: the study is not finished")
        return board

    @cached_property
    def board_tables(self) -> list[Table]:
        """Headline, board, measured data, variants and extras; errors as `board`."""
        board = self.board
        tables = plan_board(board, (self.columns.protocol, ""), self.columns.controls)
        if self.columns.withdrawn:
            tables[0] = replace(tables[0], title=self.columns.withdrawn)
        if self.statuses:
            tables[0] = _with_statuses(tables[0], board, self.statuses)
        measured = [case for cases in board.measured.values() for case in cases]
        if measured:
            tables += dataset_tables(section_of(board.answer.over(measured)))
        if self.columns.variants:
            tables += self._variants()
        if self.columns.extras:
            tables.append(self._extras())
        return tables

    def _answer(self, protocol: str, names: Collection[str]) -> Answer:
        cases = [case for case in self.merged.cases if case.name.protocol == protocol]
        return Answer.of(self.merged, sort_key("norm", None), cases, names)

    def _variants(self) -> list[Table]:
        """Return the board of the variants and what they are compared with.

        It has the comparisons in which a variant has a score.
        """
        columns = self.columns
        variants = {*columns.variants}
        pairs = [pair for pair in columns.controls.items() if variants.intersection(pair)]
        names = {*variants, *chain.from_iterable(pairs), REFERENCE_MODEL}
        answer = self._answer(columns.protocol, names)
        shared = answer.over([case for case in answer.cases if variants.intersection(case.scores)])
        few = {heading: self._answer(columns.few[heading], names) for heading in self.board.few}
        datasets = {case.name.dataset for of_robot in shared.robots.values() for case in of_robot}
        groups = {
            name: of_group
            for name, of_group in self.study.groups.items()
            if datasets.intersection(of_group)
        }
        tables = board_tables(Board(shared, few, groups), dict(pairs))
        return [
            replace(
                table,
                title=f"Variants, on {', '.join(map(repr, groups))}: {table.title}",
                about={"table": "variants"},
            )
            for table in tables
        ]

    def _extras(self) -> Table:
        """Return the board of models that need more packages, on the averaged robots."""
        extras = self.columns.extras
        names = {*extras, REFERENCE_MODEL, self.board.best}
        answer = self._answer(self.columns.protocol, names)
        of_extras = Board(answer.over(list(chain.from_iterable(answer.claim_robots.values()))))
        first, *_ = board_tables(of_extras, {})
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


def _with_statuses(table: Table, board: Board, statuses: Mapping[str, str]) -> Table:
    """Return the board with the column of status at its end."""
    status_of_row = [statuses.get(row.name, VERIFIED) for row in board.rows]
    rows = [[*row, status] for row, status in zip(table.rows, status_of_row, strict=True)]
    columns = [*table.columns, Column("status", "text")]
    return replace(table, columns=columns, rows=rows, notes=[*table.notes, STATUS_NOTE])
