"""What stored results say: tables, comparisons, a leaderboard, a page, figures."""

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
from stiff_bench.api.tables import Comparison, Tables, screen, short_table
from stiff_bench.store.database import read_results
from stiff_bench.tables.fit_notes import failure_lines
from stiff_bench.tables.metric_table import build_tables, metric_lines
from stiff_bench.tables.table import SCREEN
from stiff_bench.tables.units import MM, first_few
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
        folder: where they are stored.
        metrics: keys, that `table` shows; none: the usual ones.
        command: that made them, for the record.
        finished: what became of the run that made them; None: they are read from the folder.
        selection: what is shown of them.
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
        """Return the results of these: names, or keys for all variants.

        An argument that is not given keeps the earlier choice.

        Args:
            models: such as "vjm" or "ft-mlp@freeze=full".
            datasets: such as "kr10-twin" for every specimen.
            protocols: such as "holdout".
            conditions: of the protocols, such as "n = 40".
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
        """One result for each model, data set, protocol and split, failures too.

        Raises:
            StoreError: the folder holds no results, or corrupt ones.
        """
        if self.finished is not None:
            return self._selected(self.finished.results)
        return self._selected(read_results(self.folder))

    def _selected(
        self, results: Sequence[CellResult], stored: StoredResults | None = None
    ) -> tuple[CellResult, ...]:
        """Return those that are shown; `stored` spares reading the folder once more."""
        if self.selection == EVERYTHING:
            return tuple(results)
        cases = self.selection.cases_of((stored or StoredResults.read(self.folder)).cases)
        names = self.selection.models_of(cases)
        keys = {one.cell.key for case in cases for one in case.every if one.shown.model in names}
        return tuple(one for one in results if one.cell.key in keys)

    @property
    def _counting(self) -> Sequence[CellResult]:
        """The results that a table is made of, in its order."""
        if self.finished is not None:
            return self.cells
        from stiff_bench.analysis.collected import newest_results

        stored = StoredResults.read(self.folder)
        return self._selected(newest_results(stored), stored)

    def frame(self) -> DataFrame:
        """Return every metric as tidy data: a row a metric, axis and split, in printed units.

        A failed cell has one row with its reason and no value.
        """
        from pandas import DataFrame

        rows = []
        for one in self.cells:
            about = {**_about(one), "status": one.status, "failure": one.failure}
            lines = [] if one.prediction is None else metric_lines(one.prediction, one.cost)
            rows += [{**about, **line} for line in lines] or [about]
        return DataFrame(rows)

    def predictions(self) -> DataFrame:
        """Return a row a test sample: deflection of the data set and as predicted, mm."""
        from pandas import DataFrame, concat

        parts = []
        for one in self.cells:
            if (found := one.prediction) is None:
                continue
            arrays = {"": found.measured, "_predicted": found.predicted}
            columns = {
                f"d{axis}{name}_mm": MM * array[:, number]
                for name, array in arrays.items()
                for number, axis in enumerate(AXES)
            }
            parts.append(DataFrame({**_about(one), "row": found.rows, **columns}))
        return concat(parts, ignore_index=True) if parts else DataFrame()

    def table(self, *metrics: str, verbose: bool = False) -> Tables:
        """Return a table for each data set and protocol, as `bench run` prints it.

        Args:
            metrics: keys, as `bench list metrics` shows them; none: those that were asked for, or
                the usual ones: mae, stde and me, of tool paths norm, norm-p95, norm-max, removed.
            verbose: with the numbers that the fits report, such as stiffnesses, beneath.

        Of results that contradict each other in a folder, the newest run's count.

        Raises:
            ConfigError: there is no such metric.
            StoreError: the folder holds no results, or corrupt ones.
        """
        shown = [metric(key) for key in metrics or self.metrics]
        tables = build_tables(self._counting, shown)
        if verbose:
            tables = [replace(one, notes=[*one.notes, *one.details]) for one in tables]
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
        """Return whether model `a` is better than model `b`, by how much, and how sure that is.

        Args:
            a: name of a model, with its options.
            b: another one.
            equivalence_mm: largest difference in mean error that makes none in practice, mm.
            confidence: of intervals and verdicts (0..1).
            seed: of the resampling of poses.

        Raises:
            ConfigError: a model has no results, or they have no splits in common.
            StoreError: the folder holds no results, or corrupt ones.
        """
        from stiff_bench.analysis.comparison import compare_folder
        from stiff_bench.analysis.comparison_text import comparison_tables, sentence
        from stiff_bench.analysis.verdict import Question

        question = Question(rope=equivalence_mm / MM, confidence=confidence, seed=seed)
        found = compare_folder(self.folder, a, b, question, self.selection)
        asked = {"equivalence_mm": equivalence_mm, "confidence": confidence}
        about = {"a": found.a, "b": found.b, **asked}
        return Comparison(comparison_tables(found), self.command, sentence(found), about)

    def answer(self, metric: str = "norm", axis: str | None = None, *, seed: int = 0) -> Answer:
        """Return which model is best, how much better than the VJM, and how sure that is.

        Args:
            metric: to score by; a key.
            axis: of a metric that has axes: "x", "y" or "z"; None: the mean over them.
            seed: of the resampling of poses.

        Raises:
            ConfigError: no model has a score, or the metric cannot rank.
            StoreError: the folder holds no results, or corrupt ones.
        """
        from stiff_bench.analysis.answer import Answer
        from stiff_bench.analysis.sort_key import sort_key

        key = sort_key(metric, axis)
        if self.finished is not None:  # what was run now, not what else the folder holds
            return Answer.of(StoredResults.of_results(self.folder, self.cells), key, seed=seed)
        stored = StoredResults.read(self.folder)
        cases = self.selection.cases_of(stored.cases)
        models = self.selection.models_of(cases)
        return Answer.of(stored, key, cases, models, seed=seed)

    def summary(self, metric: str = "norm", axis: str | None = None, *, seed: int = 0) -> Tables:
        """Return the answer as a headline and tables with notes.

        Of one comparison the table has each model's errors; of several there is a table of the
        models against the VJM, and one of their errors in each comparison. It takes the arguments
        of `answer`, and raises the same errors.
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
        """Return the answer as a terminal shows it, or the tables where no model has a score.

        Args:
            facts: of the run, such as how long it took.
            verbose: with a table of each comparison, and every note.
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
        """Return the models over robots, one vote each, or over each data set.

        With five robots or more of one kind, simulated or measured, a protocol's models stand by
        their error over the VJM's; with fewer, each data set has a table with intervals over splits
        and poses.

        Args:
            metric: to sort by; a key.
            axis: of a metric that has axes: "x", "y" or "z"; None: the mean over them.
            seed: of the resampling of poses.

        Raises:
            ConfigError: fewer than two models have results, or the metric cannot rank.
            StoreError: the folder holds no results, or corrupt ones.
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
        others: Sequence[Results] = (),
    ) -> Path:
        """Write all that the results say as one HTML page that needs no network.

        Args:
            file: the page; an older one is replaced.
            metric: to rank by; a key.
            axis: see `leaderboard`.
            seed: of the resampling of poses.
            others: results that stand on the same page, each by itself.

        Raises:
            ConfigError: the file's suffix is no page's, or a name has no results.
            StoreError: a folder holds no results, or corrupt ones, or the file cannot be written.
        """
        from stiff_bench.report.report_content import PageOptions, write_report

        folders = [one.folder for one in (self, *others)]
        write_report(
            folders, PageOptions(self.selection, metric, axis, seed), Path(file), self.command
        )
        return Path(file)

    def diagnostics(self) -> DataFrame:
        """Return what the fits report beside their errors, such as stiffnesses: a row a number."""
        from pandas import DataFrame

        return DataFrame(
            [
                {**_about(one), "diagnostic": name, "value": value}
                for one in self.cells
                for name, value in one.diagnostics.items()
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
        names = list(dict.fromkeys(cell.shown.model for cell in self.cells))
        if not isinstance(model, str) or not any(matches_key(model, name) for name in names):
            raise unknown_name("model with results", str(model), names)
        return self.select(models=[model])

    __iter__ = None
    """Results are not a sequence; `cells` has them."""

    def _view(self) -> Tables:
        """Return the answer; the tables where no model has a score."""
        try:
            return self.summary()
        except ConfigError:
            return self.table()

    def __repr__(self) -> str:
        """Return the answer for a screen, with its first table."""
        view = self._view()
        return screen([short_table(view.tables[0])], view.text)

    def _repr_html_(self) -> str:
        return self._view()._repr_html_()


def _about(one: CellResult) -> dict[str, Any]:
    return {
        "model": one.shown.model,
        "dataset": one.shown.dataset,
        "protocol": one.shown.protocol,
        "condition": one.cell.condition,
        "split": one.cell.split_index,
        "seed": one.cell.seed,
    }


def open_results(folder: Path | str) -> Results:
    """Return what a folder holds, such as the --output of `bench run`; it is read when asked."""
    return Results(Path(folder), command=f"stiffbench.open_results({str(folder)!r})")


def merge(folders: Sequence[Path | str], output: Path | str) -> Merged:
    """Join the results of several folders, such as of several machines, in one.

    Args:
        folders: that are joined; they stay as they are.
        output: a new folder, or one that holds some.

    Raises:
        ConfigError: two folders have different numbers of one fit.
        StoreError: a folder holds no results, or `output` cannot be written.
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
    """Return a figure with its caption; a notebook shows it, and `save("my.png")` writes it.

    Args:
        name: one of `list_figures`; numbers are the source paper's.
        results: that it shows, or their folder; None: where `bench run` stores them, and for the
            paper's figures `bench reproduce`. `Results.select` chooses among them; else a figure
            shows the models that it is clear with, and the data sets in panels: measured ones
            first, then in the order of asking. The figure "robot" draws a data set, too.
        model: a fitted model, for the figure "robot": its prediction is drawn. Without `results`
            it is drawn at one of its training poses.
        row: of the data set, from 0, for the figure "robot"; None: the largest deflection.

    Raises:
        ConfigError: there is no such figure, or a name has no results.
        NotFittedError: the model is not fitted.
        StoreError: the folder does not hold what it shows.
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
        raise ConfigError(f"{word}: the paper's figure {name} takes no choice", kind)
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
                raise ConfigError(f"{row}: a model has no rows; give a data set too", "row")
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
    """Return a table of the source paper, beside ours where there are ours.

    Args:
        number: of the table in the paper, 1 to 10.
        results: of `bench reproduce`, or their folder; None: where it stores them.
        command: that made it, for the record.

    Raises:
        ConfigError: the paper has no table of that number, or it reads no results.
        StoreError: the results have nothing of it.
    """
    from stiff_bench.paper.paper_tables import read_table

    tables = read_table(str(number), _folder(results))
    made_by = command or f"stiffbench.paper_table({number})"
    return Tables(tables, made_by)


_STORED = Results | Path | str | None


def _folder(results: Results | Path | str | None) -> Path | None:
    folder = results.folder if isinstance(results, Results) else results
    return None if folder is None else Path(folder)
