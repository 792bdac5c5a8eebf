"""Leaderboards: over robots if there are enough, else per data set; and of a study."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from stiff_bench.results.columns import board_tables, dataset_table
from stiff_bench.results.fresh_robots import fresh_frame, fresh_tables, read_entries
from stiff_bench.results.load import StoredResults, Task, newest_tasks
from stiff_bench.results.notes import (
    SELECTION_MARK,
    TRAINING_MARK,
    caveats_of,
    left_out_notes,
    same_name_other_data,
    sources,
)
from stiff_bench.results.scored_task import TRUE, SortKey, sort_key
from stiff_bench.results.scores import Scores, model_frame, ratio_frame, robot_logs
from stiff_bench.results.selection import EVERYTHING, BoardSettings, Selection
from stiff_bench.results.summary import (
    Summary,
    dataset_notes,
    few_robots_text,
    split_notes,
    summarize,
)
from stiff_bench.store.database import has_results
from stiff_bench.store.names import grouped, labels, without_options
from stiff_bench.tables.table import Table
from stiff_bench.tables.units import first_few
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import FitResult

if TYPE_CHECKING:
    from pandas import DataFrame


def merge_training_seeds(stored: StoredResults) -> StoredResults:
    """Return results in which the repeats of a model's training have one name.

    The pre-training seed leaves the model's name, unless a task has several seeds of the model.
    """
    repeated = {
        base
        for task in stored.tasks
        for base, names in grouped(task.models, _without_seed).items()
        if len(names) > 1
    }

    def renamed(result: FitResult) -> FitResult:
        name = _without_seed(result.presentation.model)
        if name in repeated:
            return result
        return replace(result, presentation=replace(result.presentation, model=name))

    return StoredResults.of_results(stored.folder, [*map(renamed, stored.every)])


def _without_seed(model: str) -> str:
    return without_options(model, "pretrain_seed")


def comparable_scores(
    stored: StoredResults, key: SortKey, selection: Selection = EVERYTHING, *, seed: int = 0
) -> tuple[Scores, list[str]]:
    """Score the selected models, and the VJM, in every task of at least two of them.

    Only tasks of the fairest protocols count. Notes tell which results do not count.

    Raises:
        ConfigError: a name has no results, no task has two models, or no model has a score.
        StoreError: samples are corrupt, or two models share no split.
    """
    stored = merge_training_seeds(stored)
    tasks = selection.tasks_of(stored.tasks)
    newest = newest_tasks(tasks)
    names = selection.models_of([t for t in newest if not t.presentation.reports_training])

    def reason(task: Task) -> str:
        if task.presentation.reports_training:
            return TRAINING_MARK
        n_models = sum(name in task.models for name in names)
        return "" if n_models > 1 else f"{('none', 'one')[n_models]} of the models was run there"

    by_reason = grouped(newest, reason)
    comparable = by_reason.pop("", [])
    outcome = "they are never compared; only the data of the newest run count"
    notes = [
        *same_name_other_data(tasks, stored.data_of, outcome),
        *left_out_notes(tasks),
        *(f"Left out ({text}): {_places(of_text)}." for text, of_text in by_reason.items()),
    ]
    if not comparable:
        reasons = "".join(f"; {note.removesuffix('.')}" for note in notes)
        raise ConfigError(
            "there is nothing to compare: no two models have results on the same data, "
            f"protocol and condition (models with results: {', '.join(names) or 'none'}){reasons}"
        )
    scores = Scores.of(stored, key, comparable, names, seed)
    scored = {task.name for task in scores.tasks}
    if without := [task for task in comparable if task.name not in scored]:
        notes.append(f"Left out ({SELECTION_MARK}, or no model has a score): {_places(without)}.")
    return scores, notes


def _places(tasks: Sequence[Task]) -> str:
    return first_few([*labels(task.name for task in tasks).values()])


def leaderboard_tables(
    stored: StoredResults, key: SortKey, selection: Selection = EVERYTHING, *, seed: int = 0
) -> list[Table]:
    """Return the tables per protocol and condition: over robots, or per data set.

    Errors as `comparable_scores`.
    """
    tables, has_datasets = list[Table](), False
    scores, notes_left_out = comparable_scores(stored, key, selection, seed=seed)
    plans = grouped(scores.tasks, lambda task: (task.name.protocol, task.name.condition))
    for plan, tasks in plans.items():
        of_tasks = scores.over(tasks)
        of_plan = [] if scores.key.is_cost else plan_tables(of_tasks, plan, model_frame(of_tasks))
        has_datasets |= not of_plan
        tables += of_plan or dataset_tables(of_tasks)
    notes = [task.task.presentation.warning for task in scores.tasks]
    if has_datasets:
        notes += [few_robots_text(scores)] if scores.claim is None else []
        missing = [
            f"{model} ({len(reasons)} of {len(scores.tasks)}: {reasons[0]})"
            for model, reasons in scores.missing.items()
        ]
        notes += [f"Scores are missing: {first_few(missing)}."] if missing else []
    cut = [task for task in scores.tasks if task.left_out]
    for text, tasks in grouped(cut, lambda task: task.left_out).items():
        notes.append(f"{_places([task.task for task in tasks])}: {text}.")
    tables[0] = replace(tables[0], notes=[*notes, *notes_left_out, *tables[0].notes])
    results = (of_model for task in scores.tasks for of_model in task.results.values())
    counts = Counter(result.run_id for of_model in results for result in of_model)
    provenance = sources(stored.folder, stored.runs, counts)
    tables[-1] = replace(tables[-1], notes=[*tables[-1].notes, provenance])
    return tables


def dataset_tables(scores: Scores, *, has_verdicts: bool = True) -> list[Table]:
    """Return a table per data set, for tasks of one protocol and condition.

    Without verdicts the data are exploratory: the tables have estimates only.
    """
    tables = []
    for tasks in grouped(scores.tasks, lambda task: task.name.dataset).values():
        of_data = scores.over(tasks)
        notes = dataset_notes(of_data, has_verdicts=has_verdicts)
        caveats = caveats_of(task.task for task in tasks)
        tables.append(dataset_table(of_data, [*notes, *caveats], has_verdicts=has_verdicts))
    return tables


def plan_tables(
    scores: Scores,
    plan: tuple[str, str],
    table: DataFrame,
    controls: Mapping[str, str] = MappingProxyType({}),
) -> list[Table]:
    """Return the tables over robots, the first with headline and sentences; [] for few robots."""
    tables = board_tables(scores, table, controls, split_notes(scores, table))
    if not tables:
        return []
    summary = summarize(scores, table)
    title = f"{summary.headline} | {' | '.join(filter(None, plan))}"
    notes = [*summary.lines, *tables[0].notes, *caveats_of(task.task for task in scores.tasks)]
    tables[0] = replace(tables[0], title=title, notes=notes)
    about = dict(zip(("protocol", "condition"), plan, strict=True))
    return [replace(part, about={**part.about, **about}) for part in tables]


# the leaderboard of a study


@dataclass(frozen=True, eq=False)
class StudyLeaderboard:
    """The leaderboard of a study: its main models over robots, and tables of the others.

    Attributes:
        every: results of the study.
        settings: settings of the study.
    """

    every: StoredResults
    settings: BoardSettings

    @cached_property
    def stored(self) -> StoredResults:
        """Return the results, with one name for all pre-training seeds of a model."""
        return merge_training_seeds(self.every)

    def _scores(self, protocol: str, names: Collection[str], metric: str = "") -> Scores:
        tasks = [task for task in self.stored.tasks if task.name.protocol == protocol]
        return Scores.of(self.stored, sort_key(metric or self.settings.metric), tasks, names)

    @cached_property
    def _names(self) -> set[str]:
        every = {name for task in self.stored.tasks for name in task.models}
        return every - {*self.settings.extras, *self.settings.variants}

    @cached_property
    def scores(self) -> Scores:
        """Return the scores of the main models."""
        return self._scores(self.settings.protocol, self._names)

    @cached_property
    def readings(self) -> Scores:
        """Return the scores of the main models and variants against readings."""
        names = self._names.union(self.settings.variants)
        return self._scores(self.settings.protocol, names, "norm")

    @cached_property
    def few(self) -> dict[str, Scores]:
        """Return the scores of the main models with fewer poses, by heading."""
        protocols = {task.name.protocol for task in self.stored.tasks}
        headings = {name: of for name, of in self.settings.few.items() if of in protocols}
        return {name: self._scores(protocol, self._names) for name, protocol in headings.items()}

    @cached_property
    def frame(self) -> DataFrame:
        """Return the `model_frame` of the main models.

        Raises:
            ConfigError: fewer than five robots have results of a model.
        """
        table = model_frame(self.scores, self.few, self.readings)
        if "won" not in table:
            raise ConfigError("no model has all results on five robots: the study is not finished")
        return table

    @property
    def board_frame(self) -> DataFrame:
        """Return the rows of the board: models with every score, best first."""
        return self.frame[self.frame["complete"]]

    @cached_property
    def summary(self) -> Summary:
        """Return the sentences."""
        return summarize(self.scores, self.frame)

    @cached_property
    def tables(self) -> list[Table]:
        """Return headline, board, measured data, variants and extras; errors as `frame`."""
        plan, controls = (self.settings.protocol, ""), self.settings.controls
        board, *tables = plan_tables(self.scores, plan, self.frame, controls)
        measured = [*chain.from_iterable(self.readings.measured.values())]
        tables += dataset_tables(self.readings.over(measured), has_verdicts=False)
        tables += fresh_tables(self.fresh) if self.fresh is not None else []
        return [board, *tables, *self._variant_tables(), *self._extra_tables()]

    @cached_property
    def fresh(self) -> DataFrame | None:
        """Return the `fresh_frame` of the main models; None without results on fresh robots."""
        results = self.stored.folder.parent
        folder = results.parent / self.settings.fresh / "runs"
        if not (self.settings.fresh and has_results(folder)):
            return None
        stored = StoredResults.read(folder)
        scores = Scores.of(stored, sort_key(self.settings.metric), stored.tasks)
        return fresh_frame(self.scores, scores, read_entries(results))

    @cached_property
    def metrics(self) -> dict[str, DataFrame]:
        """Return ratios to the VJM's number by metric: overall ("") and by world.

        Each has a `ratio_frame` of the main models, in the order of the overall ratio.
        """
        first = "truth" if self.scores.key == TRUE else self.scores.key.text
        sources = {
            first: (self.scores, "error ratio"),
            "readings": (self.scores, "readings ratio"),
            "95th percentile": (self.scores, "p95 ratio"),
            "tool paths": (self.scores, "path ratio"),
            **{name: (scores, "error ratio") for name, scores in self.few.items()},
        }
        frames = {name: self._ratios(of.rows, value) for name, (of, value) in sources.items()}
        return {name: frame for name, frame in frames.items() if not frame.empty}

    def _ratios(self, rows: DataFrame, value: str) -> DataFrame:
        worlds = rows["world"].dropna().unique()
        parts = {"": rows, **{world: rows[rows["world"] == world] for world in worlds}}
        frame = ratio_frame({name: robot_logs(of, value) for name, of in parts.items()})
        frame = frame[frame.index.isin(self.board_frame["model"])]
        overall: Any = [("", "ratio")]
        return frame.dropna(subset=overall).sort_values(overall, kind="stable")

    def _variant_tables(self) -> Iterator[Table]:
        """Yield the tables of variants and their controls; variants that ran alike share them."""
        settings, variants = self.settings, self.settings.variants
        every = self._scores(settings.protocol, variants)
        claimed = [task for task in every.tasks if task.kind == every.claim]

        def where(variant: str) -> tuple[Task, ...]:
            return tuple(task.task for task in claimed if variant in task.scores)

        for tasks, alike in grouped(variants, where).items():
            if tasks:
                yield from self._tables_of_variants({*alike}, len(tasks) == len(claimed))

    def _tables_of_variants(self, variants: set[str], is_everywhere: bool) -> Iterator[Table]:
        """Yield the tables of variants that ran in the same tasks; few of them if not in all."""
        settings = self.settings
        pairs = [pair for pair in settings.controls.items() if variants.intersection(pair)]
        pairs = [(name, control) for name, control in pairs if is_everywhere or name in variants]
        names = {*variants, *chain.from_iterable(pairs), REFERENCE_MODEL}
        scores = self._scores(settings.protocol, names)
        scores = scores.over([task for task in scores.tasks if variants.intersection(task.scores)])
        few = {heading: self._scores(settings.few[heading], names) for heading in self.few}
        heading = "Variants"
        if is_everywhere:
            table = model_frame(scores, few, self.readings)
        else:
            table = model_frame(scores)
            heading += f" in {' and '.join(scores.rows['world'].unique())}"
        for part in board_tables(scores, table, dict(pairs), split_notes(scores, table)):
            if is_everywhere or part.about["table"] in ("board", "worlds", "controls"):
                yield replace(part, title=f"{heading}: {part.title}", about={"table": "variants"})

    def _extra_tables(self) -> Iterator[Table]:
        """Yield the table of models that need more packages, on the averaged robots."""
        extras = self.settings.extras
        if not extras:
            return
        best = self.board_frame["model"].iloc[0]
        every = self._scores(self.settings.protocol, {*extras, REFERENCE_MODEL, best})
        scores = every.over([*every.rows["task"].unique()])
        table = model_frame(scores)
        first, *_ = board_tables(scores, table, {})
        missing = sorted({*extras} - {*table[table["complete"]]["model"]})
        yield replace(
            first,
            title=f"Models of other packages ({', '.join(extras)}) and the best",
            notes=[f"not run here: {first_few(missing)}."] if missing else [],
            about={"table": "extras"},
        )
