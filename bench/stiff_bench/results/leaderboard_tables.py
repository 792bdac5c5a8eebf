"""Tables of a leaderboard: over robots, or per data set; and the leaderboard of a study."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING

from stiff_bench.results.columns import (
    board_tables,
    cost_table,
    dataset_table,
    score_list,
)
from stiff_bench.results.leaderboard import Leaderboard, merge_training_seeds, model_frame
from stiff_bench.results.load import StoredResults
from stiff_bench.results.notes import caveats_of
from stiff_bench.results.scored_task import sort_key
from stiff_bench.results.scores import Scores
from stiff_bench.results.selection import BoardSettings
from stiff_bench.results.summary import (
    Summary,
    dataset_notes,
    section_notes,
    split_notes,
    summarize,
)
from stiff_bench.store.names import grouped
from stiff_bench.tables.table import Column, Entry, Table
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError

if TYPE_CHECKING:
    from pandas import DataFrame


def leaderboard_tables(board: Leaderboard) -> list[Table]:
    """Return the tables of all sections; json also has all scores of all tasks."""
    tables = []
    for section in board.sections:
        models = section_models(section)
        tables += section_tables(section, board)
        tables.append(score_list(section, models, board.notes))
    return tables


def section_models(section: Scores) -> list[str]:
    """Return all models: complete ones first, best first; those without a score come last."""
    return list(dict.fromkeys([*model_frame(section)["model"], *section.missing]))


def section_tables(section: Scores, board: Leaderboard) -> list[Table]:
    """Return the tables of a section per protocol and condition, and its costs."""
    models = section_models(section)
    tables, has_datasets = list[Table](), False
    plans = grouped(section.tasks, lambda task: (task.name.protocol, task.name.condition))
    for plan, tasks in plans.items():
        scores = section.over(tasks)
        of_plan = plan_tables(scores, plan) if not section.key.is_cost else []
        has_datasets |= not of_plan
        tables += of_plan or dataset_tables(scores, models)
    if tables:
        notes = section_notes(section, board, has_datasets=has_datasets)
        tables[0] = replace(tables[0], notes=[*notes, *tables[0].notes])
        tables[-1] = replace(tables[-1], notes=[*tables[-1].notes, *board.provenance])
    return [table for table in (*tables, cost_table(section, models)) if table.rows]


def dataset_tables(scores: Scores, models: Collection[str]) -> list[Table]:
    """Return a table per data set, for tasks of one protocol and condition."""
    tables = []
    for tasks in grouped(scores.tasks, lambda task: task.name.dataset).values():
        of_data = scores.over(tasks)
        there = {name for task in tasks for name in task.task.models}
        notes = [*dataset_notes(of_data), *caveats_of(task.task for task in tasks)]
        tables.append(dataset_table(of_data, [name for name in models if name in there], notes))
    return tables


def plan_tables(
    scores: Scores,
    plan: tuple[str, str],
    table: DataFrame | None = None,
    controls: Mapping[str, str] | None = None,
) -> list[Table]:
    """Return the tables over robots, the first with headline and sentences; [] for few robots."""
    table = model_frame(scores) if table is None else table
    tables = board_tables(scores, table, controls or {}, split_notes(scores, table))
    if not tables:
        return []
    summary = summarize(scores, table)
    title = f"{summary.headline} | {' | '.join(filter(None, plan))}"
    notes = [*summary.lines, *tables[0].notes, *caveats_of(task.task for task in scores.tasks)]
    tables[0] = replace(tables[0], title=title, notes=notes)
    about = dict(zip(("protocol", "condition"), plan, strict=True))
    return [replace(part, about={**part.about, **about}) for part in tables]


# the leaderboard of a study


NOT_RUN = "not run here"
VERIFIED = "verified"
STATUS_NOTE = "reported: results of a submission whose code could not be run again."


@dataclass(frozen=True, eq=False)
class StudyLeaderboard:
    """The leaderboard of a study: its main models over robots, and tables of the others.

    Attributes:
        every: results of the study.
        settings: settings of the study.
        groups: data sets with a separate column, by its name.
        statuses: model -> "verified" or "reported"; empty: no column of status.
    """

    every: StoredResults
    settings: BoardSettings
    groups: Mapping[str, Collection[str]] = field(default_factory=dict)
    statuses: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def stored(self) -> StoredResults:
        """Return the results, with one name for all pre-training seeds of a model."""
        return merge_training_seeds(self.every)

    def _scores(self, protocol: str, names: Collection[str]) -> Scores:
        tasks = [task for task in self.stored.tasks if task.name.protocol == protocol]
        return Scores.of(self.stored, sort_key(), tasks, names)

    @cached_property
    def _names(self) -> set[str]:
        every = {name for task in self.stored.tasks for name in task.models}
        return every - {*self.settings.extras, *self.settings.variants}

    @cached_property
    def scores(self) -> Scores:
        """Return the scores of the main models.

        Raises:
            ConfigError: fewer than five robots have results of a model.
        """
        scores = self._scores(self.settings.protocol, self._names)
        if scores.claim is None:
            raise ConfigError("no model has all results on five robots: the study is not finished")
        return scores

    @cached_property
    def few(self) -> dict[str, Scores]:
        """Return the scores of the main models with fewer poses, by heading."""
        protocols = {task.name.protocol for task in self.stored.tasks}
        headings = {name: of for name, of in self.settings.few.items() if of in protocols}
        return {name: self._scores(protocol, self._names) for name, protocol in headings.items()}

    @cached_property
    def frame(self) -> DataFrame:
        """Return the `model_frame` of the main models; errors as `scores`."""
        table = model_frame(self.scores, self.few, self.groups)
        if "won" not in table:
            raise ConfigError("no model has all results on five robots: the study is not finished")
        return table

    @property
    def board_frame(self) -> DataFrame:
        """Return the rows of the board: models with every score, best first."""
        return self.frame[self.frame["complete"]].sort_values("ratio", kind="stable")

    @cached_property
    def summary(self) -> Summary:
        """Return the sentences; a withdrawn claim is replaced."""
        summary = summarize(self.scores, self.frame)
        if not self.settings.withdrawn:
            return summary
        return replace(summary, which=self.settings.withdrawn, how_much="")

    @cached_property
    def tables(self) -> list[Table]:
        """Return headline, board, measured data, variants and extras; errors as `scores`."""
        plan, controls = (self.settings.protocol, ""), self.settings.controls
        tables = plan_tables(self.scores, plan, self.frame, controls)
        if self.settings.withdrawn:
            tables[0] = replace(tables[0], title=self.settings.withdrawn)
        if self.statuses:
            tables[0] = self._with_statuses(tables[0])
        if measured := [*chain.from_iterable(self.scores.measured.values())]:
            of_measured = self.scores.over(measured)
            tables += dataset_tables(of_measured, section_models(of_measured))
        return [*tables, *self._variant_tables(), *self._extra_tables()]

    def _with_statuses(self, table: Table) -> Table:
        names = [*self.board_frame["model"]]
        rows = [
            [*row, self.statuses.get(name, VERIFIED)]
            for row, name in zip(table.rows, names, strict=True)
        ]
        columns = [*table.columns, Column("status", "text")]
        return replace(table, columns=columns, rows=rows, notes=[*table.notes, STATUS_NOTE])

    def _variant_tables(self) -> Iterator[Table]:
        """Yield the tables of variants and their controls, in the tasks of a variant."""
        settings, variants = self.settings, {*self.settings.variants}
        if not variants:
            return
        pairs = [pair for pair in settings.controls.items() if variants.intersection(pair)]
        names = {*variants, *chain.from_iterable(pairs), REFERENCE_MODEL}
        every = self._scores(settings.protocol, names)
        scores = every.over([task for task in every.tasks if variants.intersection(task.scores)])
        few = {heading: self._scores(settings.few[heading], names) for heading in self.few}
        datasets = set() if scores.claim is None else {*scores.claim[1]["dataset"]}
        groups = {name: of for name, of in self.groups.items() if datasets.intersection(of)}
        table = model_frame(scores, few, groups)
        for part in board_tables(scores, table, dict(pairs), split_notes(scores, table)):
            title = f"Variants, on {', '.join(map(repr, groups))}: {part.title}"
            yield replace(part, title=title, about={"table": "variants"})

    def _extra_tables(self) -> Iterator[Table]:
        """Yield the table of models that need more packages, on the averaged robots."""
        extras = self.settings.extras
        if not extras:
            return
        best = self.board_frame["model"].iloc[0]
        every = self._scores(self.settings.protocol, {*extras, REFERENCE_MODEL, best})
        assert every.claim is not None  # the board has at least as many robots
        scores = every.over([*every.claim[1]["task"].unique()])
        table = model_frame(scores)
        first, *_ = board_tables(scores, table, {})
        complete = {*table[table["complete"]]["model"]}
        missing = [name for name in extras if name not in complete]
        rows: list[list[Entry]] = [[*row, *([None] if missing else [])] for row in first.rows]
        rows += [[name, *(None for _ in first.columns[1:]), NOT_RUN] for name in missing]
        yield replace(
            first,
            title=f"Models of other packages ({', '.join(extras)}) and the best",
            columns=[*first.columns, *([Column("run", "text")] if missing else [])],
            rows=rows,
            notes=[],
            about={"table": "extras"},
        )
