"""Read stored results: frames, tables, a comparison, a leaderboard."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from stiff_bench.parameter_types import AxisName, Bounds, Form, Fraction, Seed
from stiff_bench.results.columns import matrix_table, metric_tables, model_table, task_table
from stiff_bench.results.comparison import compare_models
from stiff_bench.results.fit_values import metric_lines
from stiff_bench.results.leaderboard import leaderboard_tables
from stiff_bench.results.load import StoredResults, newest_tasks
from stiff_bench.results.notes import (
    caveats_of,
    failure_lines,
    left_out_notes,
    outcome_notes,
    same_name_other_data,
    size_notes,
)
from stiff_bench.results.scored_task import TRUE, sort_key
from stiff_bench.results.scores import Scores, model_frame
from stiff_bench.results.selection import EVERYTHING, Selection
from stiff_bench.results.significance import Question
from stiff_bench.results.summary import elsewhere_notes, summarize, task_headline, task_title
from stiff_bench.tables.units import MM, first_few
from stiff_bench.tables.writers import Tables, Text
from stiff_protocols.contract.errors import ConfigError, StiffBenchError, StiffBenchWarning
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.metrics import metric

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.run.runner import Finished

UNIT_WORDS = {"%": "percent", "1/s": "per_s"}
"""Units as parts of a column's name."""


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """Results of models on data sets under protocols.

    If results of a folder contradict each other, the newest run counts.

    Attributes:
        folder: folder in which they are stored.
        metrics: keys of the metrics in `table`; empty: the usual ones.
        command: command that made them.
        finished: finished run that made them; None: they are read from the folder.
        selection: selected models, data sets, protocols and conditions.
    """

    folder: Path
    metrics: tuple[str, ...] = ()
    command: str = ""
    finished: Finished | None = None
    selection: Selection = EVERYTHING

    def select(
        self,
        *,
        models: Sequence[str] = (),
        datasets: Sequence[str] = (),
        protocols: Sequence[str] = (),
        conditions: Sequence[str] = (),
    ) -> Results:
        """Return the results of some names; a key selects all its variants.

        An empty argument keeps the earlier selection.

        Args:
            models: models, such as "vjm" or "ft-mlp@freeze=full".
            datasets: data sets, such as "kr10-twin" for all specimens.
            protocols: protocols, such as "holdout".
            conditions: conditions of the protocols, such as "n = 40".
        """
        words = {"models": models, "datasets": datasets}
        words |= {"protocols": protocols, "conditions": conditions}
        given = {kind: tuple(names) for kind, names in words.items() if names}
        return replace(self, selection=replace(self.selection, **given))

    @cached_property
    def stored(self) -> StoredResults:
        """Return the results by task: of the finished run, or of the folder."""
        if self.finished is not None:
            return StoredResults.of_results(self.folder, self.finished.results)
        return StoredResults.read(self.folder)

    @cached_property
    def fits(self) -> tuple[FitResult, ...]:
        """Return the newest result of each model, data set, protocol and split, or its failure.

        Raises:
            StoreError: the folder has no results, or corrupt ones.
        """
        newest = self.stored.newest_results()
        if self.finished is not None:  # in the order of the request
            keys = {result.fit.key for result in newest}
            newest = [result for result in self.finished.results if result.fit.key in keys]
        return self._selected(newest)

    @property
    def every(self) -> tuple[FitResult, ...]:
        """Return all selected results, also older ones that newer results replace."""
        return self._selected(self.stored.every)

    def _selected(self, results: Sequence[FitResult]) -> tuple[FitResult, ...]:
        tasks = self.selection.tasks_of(self.stored.tasks)
        names = self.selection.models_of(tasks)
        keys = {
            result.fit.key
            for task in tasks
            for result in task.every
            if result.presentation.model in names
        }
        return tuple(result for result in results if result.fit.key in keys)

    def frame(self) -> DataFrame:
        """Return a row per fit: the newest fit of each split.

        Columns: `model`, `dataset`, `kind`, `protocol`, `condition`, `seed`, `split`,
        `model_version`, `data_sha256`, `run`, `robot`, `status`, `failure`, and a column per metric
        whose name ends in its unit, such as `norm_mm`, `mae_x_mm` and `fit_time_ms`. A failed fit
        has its reason and no values. Data sets with one name and different data differ in
        `data_sha256`; only the newest data are in the frame, and a warning names the older ones.
        """
        tasks = self.selection.tasks_of(self.stored.tasks)
        outcome = "only the newest is in the frame"
        notes = same_name_other_data(tasks, self.stored.data_of, outcome)
        for note in (*notes, *left_out_notes(tasks)):
            warnings.warn(note, StiffBenchWarning, stacklevel=2)
        from pandas import DataFrame  # slow, and a single task needs no frame

        rows = []
        for result in self._current_fits:
            robot = self.stored.data_of(result.fit.data_sha256).robot.name
            facts = {"robot": robot, "status": result.status, "failure": result.failure}
            row = {**identity_of(result), **facts}
            for line in metric_lines(result.prediction, result.cost):
                unit = UNIT_WORDS.get(line["unit"], line["unit"])
                words = (line["metric"].replace("-", "_"), line["axis"], unit)
                row["_".join(filter(None, words))] = line["value"]
            rows.append(row)
        return DataFrame(rows)

    def predictions(self) -> DataFrame:
        """Return a row per test sample of the fits of `frame`: measured and predicted, mm."""
        from pandas import DataFrame, concat

        parts = []
        for result in self._current_fits:
            if (prediction := result.prediction) is None:
                continue
            arrays = {"": prediction.measured, "_predicted": prediction.predicted}
            columns = {
                f"d{axis}{name}_mm": MM * array[:, number]
                for name, array in arrays.items()
                for number, axis in enumerate(AXES)
            }
            parts.append(DataFrame({**identity_of(result), "row": prediction.rows, **columns}))
        return concat(parts, ignore_index=True) if parts else DataFrame()

    def diagnostics(self) -> DataFrame:
        """Return a row per number that a fit of `frame` reported, such as a stiffness."""
        from pandas import DataFrame

        return DataFrame(
            [
                {**identity_of(result), "diagnostic": name, "value": value}
                for result in self._current_fits
                for name, value in result.diagnostics.items()
            ]
        )

    @property
    def _current_fits(self) -> list[FitResult]:
        """Return the fits on each data set's newest data."""
        current = newest_tasks(self.stored.tasks)
        keys = {result.fit.key for task in current for result in task.every}
        return [result for result in self.fits if result.fit.key in keys]

    def table(self, *metrics: str, verbose: bool = False) -> Tables:
        """Return a table per data set and protocol, as printed by `bench run`.

        Args:
            metrics: keys from `bench list metrics`; none: the requested ones, or the usual ones:
                mae, stde and me, and for tool paths norm, norm-p95, norm-max, removed.
            verbose: True to add the numbers reported by the fits, such as stiffnesses, below.

        Raises:
            ConfigError: a metric is unknown.
            StoreError: the folder has no results, or corrupt ones.
        """
        chosen_metrics = [metric(key) for key in metrics or self.metrics]
        tables = metric_tables(self.fits, chosen_metrics)
        if verbose:
            tables = [replace(table, notes=[*table.notes, *table.details]) for table in tables]
        return Tables(tables, self.command)

    def compare(
        self,
        a: str,
        b: str,
        *,
        equivalence_mm: Annotated[float, Form("MM"), Bounds(at_least=0.0)] = 0.01,
        confidence: Fraction = 0.95,
        seed: Seed = 0,
    ) -> Tables:
        """Test whether model A is better than B, and by how much.

        Args:
            a: model with its options, as `bench run` names it: vjm, ft-mlp@freeze=full.
            b: another model.
            equivalence_mm: largest difference in mean error that is negligible in practice, in mm.
            confidence: level (0..1) of intervals and verdicts.
            seed: seed of the resampling of poses.

        Raises:
            ConfigError: a model has no results, or they have no splits in common.
            StoreError: the folder has no results, or corrupt ones.
        """
        question = Question(rope=equivalence_mm / MM, confidence=confidence, seed=seed)
        pair = compare_models(self.stored, a, b, question, self.selection)
        about = {"a": pair.a, "b": pair.b, "equivalence_mm": equivalence_mm}
        about |= {"confidence": confidence}
        return Tables(pair.tables(), self.command, pair.text, about)

    def scores(self, metric: str = "norm", axis: str | None = None, *, seed: int = 0) -> Scores:
        """Return scores of the models against the VJM, with verdicts.

        Args:
            metric: key of the metric to score by.
            axis: "x", "y" or "z" for a metric with axes; None: the mean over the axes.
            seed: seed of the resampling of poses.

        Raises:
            ConfigError: no model has a score, or the metric cannot rank models.
            StoreError: the folder has no results, or corrupt ones.
        """
        key = sort_key(metric, axis)
        tasks = self.selection.tasks_of(self.stored.tasks)
        return Scores.of(self.stored, key, tasks, self.selection.models_of(tasks), seed=seed)

    def summary(self, *, verbose: bool = False) -> Tables:
        """Return the result as a headline and tables with notes.

        For one task there is a table of the models' errors. For several there is a table of the
        models against the VJM, and a table of their errors per task: the true errors if they were
        requested and every task has them. If no model has a score, there are the tables of metrics.
        `verbose` adds a table per task and all notes.

        Raises:
            StoreError: the folder has no results, or corrupt ones.
        """
        try:
            scores = self.scores()
        except ConfigError:
            return self.table(verbose=verbose)
        if TRUE.metric.key in self.metrics and len(scores.tasks) > 1:
            with suppress(ConfigError):
                of_truth = self.scores(TRUE.metric.key)
                scores = of_truth if len(of_truth.tasks) == len(scores.tasks) else scores
        tasks = [task.task for task in scores.tasks]
        done = [[*model.done.values()] for task in tasks for model in task.models.values()]
        outcomes = [note for results in done if results for note in outcome_notes(results)]
        notes = [*failure_lines(self.fits), *outcomes, *caveats_of(tasks)]
        notes = [*elsewhere_notes(scores.tasks), *notes]
        task_tables = [task_table(task, task_title(task)) for task in scores.tasks]
        if len(tasks) == 1:
            (task,), (table,) = scores.tasks, task_tables
            notes = [*size_notes(next(iter(task.results.values()))), *notes]
            table = replace(table, notes=notes, brief=not verbose)
            return Tables([table], self.command, task_headline(task))
        models = model_frame(scores)
        summary, matrix = summarize(scores, models), matrix_table(scores, [*models["model"]])
        title = f"{scores.key.text} against the VJM's on {first_few(matrix.headings()[1:])}"
        table = model_table(scores, models, title, [*summary.lines, *notes])
        tables = [replace(table, brief=not verbose), matrix, *(task_tables if verbose else [])]
        return Tables(tables, self.command, summary.headline)

    def leaderboard(
        self, metric: str = "norm", axis: AxisName | None = None, *, seed: Seed = 0
    ) -> Tables:
        """Rank models over data sets and protocols, with intervals.

        With five or more robots of one kind (simulated or measured), models are sorted by their
        error over the VJM's. With fewer robots there is a table per data set, with intervals over
        splits and poses.

        Args:
            metric: metric to rank by.
            axis: axis of the metric; by default the mean over the axes.
            seed: seed of the resampling of poses.

        Raises:
            ConfigError: fewer than two models have results, or the metric cannot rank models.
            StoreError: the folder has no results, or corrupt ones.
        """
        key = sort_key(metric, axis)
        tables = leaderboard_tables(self.stored, key, self.selection, seed=seed)
        about = {"sort_key": key.text, "direction": key.metric.direction}
        return Tables(tables, self.command, about=about)

    def __getitem__(self, model: str) -> Results:
        """Return the results of one model, or of all variants of a key.

        Raises:
            ConfigError: the model has no results.
        """
        chosen = self.select(models=[str(model)])
        chosen.fits  # noqa: B018  # an unknown name raises
        return chosen

    def __repr__(self) -> str:
        """Return the result for a screen, with its first table; or why there are no results."""
        try:
            summary = self.summary()
        except StiffBenchError as error:
            return f"Results without numbers: {error}"
        return repr(replace(summary, tables=summary.tables[:1]))

    def _repr_html_(self) -> str:
        try:
            return self.summary()._repr_html_()
        except StiffBenchError:
            return Text(repr(self))._repr_html_()


def open_results(folder: Path | str) -> Results:
    """Return the results of a folder, such as the --output of `bench run`."""
    return Results(Path(folder), command=f"stiffbench.open_results({str(folder)!r})")


# rows of frames


def identity_of(result: FitResult) -> dict[str, Any]:
    """Return the columns that identify a fit in a frame."""
    fit, texts = result.fit, result.presentation
    return {
        "model": texts.model,
        "dataset": texts.dataset,
        "kind": texts.kind,
        "protocol": texts.protocol,
        "condition": fit.condition,
        "seed": fit.seed,
        "split": fit.split_index,
        "model_version": fit.model_version,
        "data_sha256": fit.data_sha256,
        "run": result.run_id,
    }
