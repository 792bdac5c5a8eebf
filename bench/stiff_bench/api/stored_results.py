"""Read stored results: tables, comparisons, a leaderboard, a page, figures."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.selection import EVERYTHING, matches_key
from stiff_bench.analysis.selection import Selection as Selection
from stiff_bench.api import RESULTS
from stiff_bench.store.database import read_results
from stiff_bench.tables.fit_notes import failure_lines
from stiff_bench.tables.metric_table import build_tables, metric_lines
from stiff_bench.tables.table import SCREEN
from stiff_bench.tables.units import MM, first_few
from stiff_bench.tables.writers import Tables
from stiff_protocols.contract.errors import ConfigError, unknown_name
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.metrics import metric

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.analysis.answer import Answer
    from stiff_bench.api.data_sets import Dataset
    from stiff_bench.api.model import Model
    from stiff_bench.figures.prepared_figure import Prepared
    from stiff_bench.run.runner import Finished
    from stiff_bench.store.merging import Merged


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """Results of models on data sets under protocols.

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
        chosen = self.selection
        return replace(
            self,
            selection=Selection(
                tuple(models) or chosen.models,
                tuple(datasets) or chosen.datasets,
                tuple(protocols) or chosen.protocols,
                tuple(conditions) or chosen.conditions,
            ),
        )

    @cached_property
    def cells(self) -> tuple[CellResult, ...]:
        """Return a result per model, data set, protocol and split, including failures.

        Raises:
            StoreError: the folder has no results, or corrupt ones.
        """
        if self.finished is not None:
            return self._selected(self.finished.results)
        return self._selected(read_results(self.folder))

    def _selected(
        self, results: Sequence[CellResult], stored: StoredResults | None = None
    ) -> tuple[CellResult, ...]:
        """Return the selected results; `stored` avoids reading the folder again."""
        if self.selection == EVERYTHING:
            return tuple(results)
        cases = self.selection.cases_of((stored or StoredResults.read(self.folder)).cases)
        names = self.selection.models_of(cases)
        keys = {
            result.cell.key
            for case in cases
            for result in case.every
            if result.presentation.model in names
        }
        return tuple(result for result in results if result.cell.key in keys)

    @property
    def _counting(self) -> Sequence[CellResult]:
        """Return the results that tables use, in their order."""
        if self.finished is not None:
            return self.cells
        from stiff_bench.analysis.collected import newest_results

        stored = StoredResults.read(self.folder)
        return self._selected(newest_results(stored), stored)

    def frame(self) -> DataFrame:
        """Return tidy data with a row per metric, axis and split, in printed units.

        A failed cell has one row with its reason and no value.
        """
        from pandas import DataFrame

        rows = []
        for result in self.cells:
            about = {**_about(result), "status": result.status, "failure": result.failure}
            lines = (
                [] if result.prediction is None else metric_lines(result.prediction, result.cost)
            )
            rows += [{**about, **line} for line in lines] or [about]
        return DataFrame(rows)

    def predictions(self) -> DataFrame:
        """Return a row per test sample: measured and predicted deflection, mm."""
        from pandas import DataFrame, concat

        parts = []
        for result in self.cells:
            if (prediction := result.prediction) is None:
                continue
            arrays = {"": prediction.measured, "_predicted": prediction.predicted}
            columns = {
                f"d{axis}{name}_mm": MM * array[:, number]
                for name, array in arrays.items()
                for number, axis in enumerate(AXES)
            }
            parts.append(DataFrame({**_about(result), "row": prediction.rows, **columns}))
        return concat(parts, ignore_index=True) if parts else DataFrame()

    def table(self, *metrics: str, verbose: bool = False) -> Tables:
        """Return a table per data set and protocol, as printed by `bench run`.

        If results of a folder contradict each other, the newest run counts.

        Args:
            metrics: keys from `bench list metrics`; none: the requested ones, or the usual ones:
                mae, stde and me, and for tool paths norm, norm-p95, norm-max, removed.
            verbose: True to add the numbers reported by the fits, such as stiffnesses, below.

        Raises:
            ConfigError: a metric is unknown.
            StoreError: the folder has no results, or corrupt ones.
        """
        chosen_metrics = [metric(key) for key in metrics or self.metrics]
        tables = build_tables(self._counting, chosen_metrics)
        if verbose:
            tables = [replace(table, notes=[*table.notes, *table.details]) for table in tables]
        return Tables(tables, self.command)

    def compare(
        self,
        a: str,
        b: str,
        *,
        equivalence_mm: float = 0.01,
        confidence: float = 0.95,
        seed: int = 0,
    ) -> Tables:
        """Compare two models: difference, intervals and verdict.

        Args:
            a: name of a model, with its options.
            b: name of another model.
            equivalence_mm: largest difference in mean error that is negligible in practice, mm.
            confidence: confidence of intervals and verdicts (0..1).
            seed: seed of the resampling of poses.

        Raises:
            ConfigError: a model has no results, or they have no splits in common.
            StoreError: the folder has no results, or corrupt ones.
        """
        from stiff_bench.analysis.comparison import compare_folder
        from stiff_bench.analysis.comparison_text import comparison_tables, sentence
        from stiff_bench.analysis.verdict import Question

        question = Question(rope=equivalence_mm / MM, confidence=confidence, seed=seed)
        report = compare_folder(self.folder, a, b, question, self.selection)
        settings = {"equivalence_mm": equivalence_mm, "confidence": confidence}
        about = {"a": report.a, "b": report.b, **settings}
        return Tables(comparison_tables(report), self.command, sentence(report), about)

    def answer(self, metric: str = "norm", axis: str | None = None, *, seed: int = 0) -> Answer:
        """Return scores of the models against the VJM, with verdicts.

        Args:
            metric: key of the metric to score by.
            axis: "x", "y" or "z" for a metric with axes; None: the mean over the axes.
            seed: seed of the resampling of poses.

        Raises:
            ConfigError: no model has a score, or the metric cannot rank models.
            StoreError: the folder has no results, or corrupt ones.
        """
        from stiff_bench.analysis.answer import Answer
        from stiff_bench.analysis.sort_key import sort_key

        key = sort_key(metric, axis)
        if self.finished is not None:  # only the results of this run
            return Answer.of(StoredResults.of_results(self.folder, self.cells), key, seed=seed)
        stored = StoredResults.read(self.folder)
        cases = self.selection.cases_of(stored.cases)
        models = self.selection.models_of(cases)
        return Answer.of(stored, key, cases, models, seed=seed)

    def summary(self, metric: str = "norm", axis: str | None = None, *, seed: int = 0) -> Tables:
        """Return the answer as a headline and tables with notes.

        For one comparison there is a table of the models' errors. For several there is a table of
        the models against the VJM, and a table of their errors per comparison. Arguments and errors
        are the same as for `answer`.
        """
        from stiff_bench.analysis import answer_text, case_text

        answer = self.answer(metric, axis, seed=seed)
        if len(answer.cases) == 1 and metric == "norm":
            (case,) = answer.cases
            table = case_text.case_table(answer, case, case_text.case_title(case))
            failures = failure_lines(self.cells)
            notes = [case_text.case_facts(case), *failures, *case_text.case_notes(case)]
            text = case_text.verdict_sentence(answer, case)
            return Tables([replace(table, notes=notes, brief=True)], self.command, text)
        notes = [f"{label}: {text}" for label, text in answer_text.sentences(answer)]
        notes += failure_lines(self.cells)
        matrix = answer_text.matrix_table(answer)
        where = first_few(matrix.headings()[1:])
        title = f"{answer.key.text} against the VJM's on {where}"
        models = replace(answer_text.model_table(answer), title=title, notes=notes)
        return Tables([models, matrix], self.command, answer_text.headline(answer))

    def screen(self, *facts: str, verbose: bool = False) -> str:
        """Return the answer for a terminal, or the tables if no model has a score.

        Args:
            facts: facts about the run, such as its time.
            verbose: True to add a table per comparison and all notes.
        """
        from stiff_bench.analysis.case_text import answer_screen

        try:
            answer = self.answer()
        except ConfigError:
            return "\n".join([self.table(verbose=verbose).text_as(SCREEN), *facts])
        options = "" if self.folder == RESULTS else f" --results {shlex.quote(str(self.folder))}"
        text = ". ".join([*facts, ""]).strip()
        failures = failure_lines(self.cells)
        return answer_screen(answer, text, failures=failures, options=options, verbose=verbose)

    def plot(self, name: str = "scores") -> Prepared:
        """Return a figure of the results; see `figure` and `list_figures`."""
        return figure(name, self)

    def leaderboard(
        self, metric: str = "norm", axis: str | None = None, *, seed: int = 0
    ) -> Tables:
        """Return the models over robots with one vote per robot, or per data set.

        With five or more robots of one kind (simulated or measured), models are sorted by their
        error over the VJM's. With fewer robots there is a table per data set, with intervals over
        splits and poses.

        Args:
            metric: key of the metric to sort by.
            axis: "x", "y" or "z" for a metric with axes; None: the mean over the axes.
            seed: seed of the resampling of poses.

        Raises:
            ConfigError: fewer than two models have results, or the metric cannot rank models.
            StoreError: the folder has no results, or corrupt ones.
        """
        from stiff_bench.analysis.leaderboard import build_leaderboard
        from stiff_bench.analysis.leaderboard_tables import leaderboard_tables
        from stiff_bench.analysis.sort_key import sort_key

        key, stored = sort_key(metric, axis), StoredResults.read(self.folder)
        board = build_leaderboard(stored, key, self.selection, seed=seed)
        about = {"sort_key": key.text, "direction": key.metric.direction}
        tables = leaderboard_tables(board)
        return Tables(tables, self.command, about=about)

    def report(
        self,
        file: Path | str,
        *,
        metric: str = "norm",
        axis: str | None = None,
        seed: int = 0,
        other_results: Sequence[Results] = (),
    ) -> Path:
        """Write the results as one self-contained HTML page.

        Args:
            file: file of the page; an existing file is replaced.
            metric: key of the metric to rank by.
            axis: see `leaderboard`.
            seed: seed of the resampling of poses.
            other_results: further results, in separate sections of the page.

        Raises:
            ConfigError: the file's extension is not supported, or a name has no results.
            StoreError: a folder has no results, or corrupt ones, or the file cannot be written.
        """
        from stiff_bench.page.report import PageOptions, write_report

        folders = [results.folder for results in (self, *other_results)]
        write_report(
            folders, PageOptions(self.selection, metric, axis, seed), Path(file), self.command
        )
        return Path(file)

    def diagnostics(self) -> DataFrame:
        """Return the numbers reported by fits, such as stiffnesses, in a row each."""
        from pandas import DataFrame

        return DataFrame(
            [
                {**_about(result), "diagnostic": name, "value": value}
                for result in self.cells
                for name, value in result.diagnostics.items()
            ]
        )

    def __len__(self) -> int:
        """Return the number of results and failures."""
        return len(self.cells)

    def __getitem__(self, model: str) -> Results:
        """Return the results of one model, or of all variants of a key.

        Raises:
            ConfigError: the model has no results.
        """
        names = list(dict.fromkeys(cell.presentation.model for cell in self.cells))
        if not isinstance(model, str) or not any(matches_key(model, name) for name in names):
            raise unknown_name("model with results", str(model), names)
        return self.select(models=[model])

    __iter__ = None
    """Results are not a sequence; `cells` has them."""

    def _view(self) -> Tables:
        """Return the answer, or the tables if no model has a score."""
        try:
            return self.summary()
        except ConfigError:
            return self.table()

    def __repr__(self) -> str:
        """Return the answer for a screen, with its first table."""
        view = self._view()
        return repr(replace(view, tables=view.tables[:1]))

    def _repr_html_(self) -> str:
        return self._view()._repr_html_()


def _about(result: CellResult) -> dict[str, Any]:
    return {
        "model": result.presentation.model,
        "dataset": result.presentation.dataset,
        "protocol": result.presentation.protocol,
        "condition": result.cell.condition,
        "split": result.cell.split_index,
        "seed": result.cell.seed,
    }


def open_results(folder: Path | str) -> Results:
    """Return the results of a folder, such as the --output of `bench run`."""
    return Results(Path(folder), command=f"stiffbench.open_results({str(folder)!r})")


def merge(folders: Sequence[Path | str], output: Path | str) -> Merged:
    """Join the results of several folders, for example from several machines.

    Args:
        folders: folders to join; they are not changed.
        output: new folder, or a folder with results.

    Raises:
        ConfigError: two folders have different numbers for the same fit.
        StoreError: a folder has no results, or `output` cannot be written.
    """
    from stiff_bench.store import merging

    return merging.merge([*map(Path, folders)], Path(output))


def figure(
    name: str,
    results: Results | Dataset | Path | str | None = None,
    *,
    model: Model | None = None,
    row: int | None = None,
) -> Prepared:
    """Return a figure with its caption; `save("my.png")` writes it.

    Args:
        name: name from `list_figures`; numbers are figures of the source paper.
        results: results or their folder; None: the default folder of `bench run`, or of
            `bench reproduce` for the paper's figures. Use `Results.select` to choose models and
            data sets. By default a figure shows as many models as fit, and a panel per data set:
            measured ones first, then in the order of the request. The figure "robot" also takes a
            data set.
        model: fitted model for the figure "robot", which draws its prediction; without `results`
            at a training pose.
        row: row of the data set, from 0, for the figure "robot"; None: the largest deflection.

    Raises:
        ConfigError: the figure is unknown, or a name has no results.
        NotFittedError: the model is not fitted.
        StoreError: the folder does not have the results for the figure.
    """
    from stiff_bench.figures.figure_catalog import FIGURES
    from stiff_bench.figures.figure_source import FigureSource
    from stiff_bench.paper import paper_figures as papers

    if name not in FIGURES and name not in papers.FIGURES:
        raise unknown_name("figure", name, [*papers.FIGURES, *FIGURES])
    if name == "robot":
        return _robot_figure(results, model, row)
    if model is not None or row is not None or not isinstance(results, _STORED):
        raise ConfigError(f"{name}: only the figure robot draws a data set, a model or a row")
    folder = _folder(results)
    selection = results.selection if isinstance(results, Results) else EVERYTHING
    if name in FIGURES:
        return FIGURES[name](FigureSource.of(folder or RESULTS, selection))
    for kind, word in selection.options:
        raise ConfigError(f"{word}: not supported by the paper's figure {name}; leave it out", kind)
    return papers.prepare_figure(name, folder)


def _robot_figure(
    results: Results | Dataset | Path | str | None, model: Model | None, row: int | None
) -> Prepared:
    from stiff_bench.figures import robot_picture
    from stiff_bench.figures.figure_source import FigureSource

    chosen: dict[str, Any] = {"row": row}
    if model is not None:
        model.check_fitted()
        if results is None:
            if row is not None:
                raise ConfigError(f"{row}: a model has no rows; give a data set, too", "row")
            return robot_picture.model_picture(model.fitted, model.name)
        chosen |= {"model": model.fitted, "model_name": model.name}
    if isinstance(results, _STORED):
        selection = results.selection if isinstance(results, Results) else EVERYTHING
        source = FigureSource.of(_folder(results) or RESULTS, selection)
        return robot_picture.robot(source, **chosen)
    kind = results.choice.info.kind
    about = f"{results.name} ({kind})"
    return robot_picture.robot_picture(results.samples, results.robot, about, kind, **chosen)


def paper_table(
    number: int | str, results: Results | Path | str | None = None, *, command: str = ""
) -> Tables:
    """Return a table of the source paper, next to stiffbench's results if there are any.

    Args:
        number: number of the table in the paper, 1 to 10.
        results: results of `bench reproduce`, or their folder; None: its default folder.
        command: command that made the table.

    Raises:
        ConfigError: the number is unknown, or the table does not use results.
        StoreError: the results do not belong to the table.
    """
    from stiff_bench.paper.paper_tables import read_table

    tables = read_table(str(number), _folder(results))
    made_by = command or f"stiffbench.paper_table({number})"
    return Tables(tables, made_by)


_STORED = Results | Path | str | None


def _folder(results: Results | Path | str | None) -> Path | None:
    folder = results.folder if isinstance(results, Results) else results
    return None if folder is None else Path(folder)
