"""Fitting and testing of models, and what the results say."""

from __future__ import annotations

import shutil
import sys
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stiff_bench.api.data import Dataset, choice_of, registry
from stiff_bench.api.model import Model, model_choice
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.plan.options import Chosen
from stiff_bench.plan.request import plan_run
from stiff_bench.run.execution import chosen_execution
from stiff_bench.run.machine import pin_threads, threads_asked_for
from stiff_bench.run.progress import display
from stiff_bench.run.runner import run_cells
from stiff_bench.store.database import ResultStore, read_results
from stiff_bench.tables.metric_table import build_tables
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Table
from stiff_bench.tables.units import MM, PRINTED
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.metrics import METRICS, metric

if TYPE_CHECKING:
    from pandas import DataFrame

DEFAULT_METRICS = ("mae", "stde", "me")


@dataclass(frozen=True)
class Tables:
    """Tables that print themselves, in a terminal and in a notebook.

    Attributes:
        tables: typed values, with titles and notes.
        command: that makes them.
        text: a sentence above and beneath; "" for none.
    """

    tables: tuple[Table, ...]
    command: str
    text: str = ""

    def frame(self) -> DataFrame:
        """Return the numbers as tidy data: a row a number."""
        from pandas import concat

        return concat([table.frame() for table in self.tables], ignore_index=True)

    def text_as(self, fmt: str) -> str:
        """Return the tables as "github", "latex", "csv", "html" or "json"."""
        return render(self.tables, fmt, self.command, text=self.text)

    def __repr__(self) -> str:
        """Return the tables for a terminal."""
        return self.text_as("github")

    def _repr_html_(self) -> str:
        return self.text_as("html")


@dataclass(frozen=True, eq=False)
class Results:
    """Results of models on data sets under protocols.

    Attributes:
        folder: where they are stored.
        cells: one result for each model, data set, protocol and split, failures too.
        metrics: keys, that `table` shows.
        command: that made them.
    """

    folder: Path
    cells: tuple[CellResult, ...]
    metrics: tuple[str, ...] = DEFAULT_METRICS
    command: str = ""

    def frame(self) -> DataFrame:
        """Return every metric as tidy data: a row a metric, axis and split, in printed units.

        A failed cell has one row with its reason and no value.
        """
        from pandas import DataFrame

        rows = []
        for one in self.cells:
            about = {**_about(one), "status": one.status, "failure": one.failure}
            for record in one.records:
                unit, factor = PRINTED[METRICS[record.metric].unit]
                value = {"value": record.value * factor, "unit": unit}
                rows.append({**about, "metric": record.metric, "axis": record.axis, **value})
            if not one.records:
                rows.append(about)
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

    def table(self, *metrics: str) -> Tables:
        """Return a table for each data set and protocol, as `bench run` prints it.

        Args:
            metrics: keys, as `bench list metrics` shows them; none: those that were asked for.

        Raises:
            ConfigError: there is no such metric.
        """
        shown = [metric(key) for key in metrics or self.metrics]
        return Tables(tuple(build_tables(self.cells, shown)), self.command)

    def compare(self, a: str, b: str, *, equivalence_mm: float = 0.01) -> Tables:
        """Return whether model `a` is better than model `b`, by how much, and how sure that is.

        Args:
            a: name of a model, with its options.
            b: another one.
            equivalence_mm: largest difference in mean error that makes none in practice, mm.

        Raises:
            ConfigError: a model has no results, or they have no splits in common.
        """
        from stiff_bench.analysis.compare import CompareWords, compare_folder
        from stiff_bench.analysis.comparison_text import _tables, sentence  # type: ignore[attr-defined]
        from stiff_bench.analysis.verdict import Question

        question = Question(rope=equivalence_mm / MM)
        report = compare_folder(CompareWords(a, b, self.folder, (), (), (), question, self.command))
        return Tables(tuple(_tables(report).values()), self.command, sentence(report))

    def leaderboard(self, metric: str = "norm", axis: str | None = None) -> Tables:
        """Return the ranks of the models over all data sets and protocols.

        Args:
            metric: to rank by; a key.
            axis: of a metric that has axes: "x", "y" or "z"; None: the mean over them.

        Raises:
            ConfigError: fewer than two models have results, or the metric cannot rank.
        """
        from stiff_bench.analysis.leaderboard_tables import section_tables
        from stiff_bench.analysis.sort_key import sort_key
        from stiff_bench.analysis.stored_leaderboard import stored_leaderboard

        board, provenance = stored_leaderboard(self.folder, key=sort_key(metric, axis))
        found = [section_tables(section, board, provenance) for section in board.sections]
        return Tables(tuple(table for tables in found for table in tables), self.command)

    def report(self, file: Path | str) -> Path:
        """Write all that the results say as one HTML page that needs no network.

        Raises:
            ConfigError: the file's suffix is no page's.
            StoreError: it cannot be written.
        """
        from stiff_bench.report.report import write_report
        from stiff_bench.report.runs import Selection

        write_report([self.folder], Selection(), Path(file), self.command)
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

    def __repr__(self) -> str:
        """Return the tables for a terminal."""
        return repr(self.table())

    def _repr_html_(self) -> str:
        return self.table().text_as("html")


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
    """Return what a folder holds, such as the --output of `bench run`.

    Raises:
        StoreError: it holds no results, or damaged ones.
    """
    return Results(Path(folder), tuple(read_results(Path(folder))))


def evaluate(
    models: str | type | Model | Sequence[str | type | Model],
    datasets: str | Dataset | Sequence[str | Dataset] = "kr10-twin",
    *,
    protocol: str | Sequence[str] = "holdout",
    splits: int | None = None,
    seed: int = 0,
    metrics: Sequence[str] = DEFAULT_METRICS,
    coverage: float | None = None,
    jobs: int = 1,
    device: str = "auto",
    output: Path | str | None = None,
) -> Results:
    """Fit and test models on data sets under protocols.

    Args:
        models: names, models of `make_model` (each cell fits a new one), or classes.
        datasets: names, or data sets of `load_dataset` and `read_samples`.
        protocol: names, with their options: "kfold@folds=10".
        splits: how many; None: the protocol's own number.
        seed: of splits and models.
        metrics: keys, that the tables show; all are computed.
        coverage: nominal coverage of intervals, where a metric needs them; None: 0.9.
        jobs: how many cells run at once, each in a process of its own. Classes that are defined in
            a script or notebook are computed in this process.
        device: "auto", "cpu" or "cuda", where networks run.
        output: a folder that keeps the results: what it holds is not computed again. None: they
            are gone with the `Results`.

    Raises:
        ConfigError: a name, an option or a value is wrong, or `output` is to keep results of a
            class that is defined in a script or notebook: nobody could tell later what it was.
        DataError: a data set cannot be loaded.
    """
    asked = [model_choice(one, {}) for one in _listed(models)]
    local = [one for one in asked if one.cls.__module__ == "__main__"]
    if local and output is not None:
        raise ConfigError(
            f"{local[0].info.key}: a class of a script or notebook, whose results cannot be kept; "
            "leave out output=..., or define it in a file and call use_plugin(file)"
        )
    if local and jobs > 1:
        raise ConfigError(
            f"jobs={jobs}: {local[0].info.key} is a class of a script or notebook, which other "
            "processes cannot import; leave out jobs=..., or define it in a file and call "
            "use_plugin(file)"
        )
    data = [
        one if isinstance(one, Dataset) else Dataset(choice_of("dataset", one, {}))
        for one in _listed(datasets)
    ]
    names = [choice_of("protocol", one, {}) for one in _listed(protocol)]
    folder = Path(tempfile.mkdtemp(prefix="stiffbench-") if output is None else output)
    plan = plan_run(
        Chosen(asked, [one.choice for one in data], names),
        registry(),
        output=folder,
        metrics=metrics,
        splits=splits,
        seed=seed,
        device=device,
        coverage=coverage,
        command="stiffbench.evaluate(...)",
    )
    threads = threads_asked_for()
    isolate = False if local else None
    execution = chosen_execution(plan, registry(), threads=threads, jobs=jobs, isolate=isolate)
    pin_threads(threads)
    with _script_not_imported(), display() as shown:
        finished = run_cells(
            list(cell_tasks(plan)), plan.command, ResultStore(folder), execution, shown
        )
    results = Results(folder, finished.results, tuple(metrics), plan.command)
    if output is None:
        weakref.finalize(results, shutil.rmtree, folder, ignore_errors=True)
    return results


def _listed(given: Any) -> list[Any]:
    return list(given) if isinstance(given, list | tuple) else [given]


@contextmanager
def _script_not_imported() -> Iterator[None]:
    """Keep the processes inside the block from running the user's script again.

    A process that multiprocessing starts imports the main module, in case that it needs a function
    of it: without a main guard, a script would start itself.
    """
    main = sys.modules["__main__"]
    kept = {name: getattr(main, name, None) for name in ("__file__", "__spec__")}
    main.__spec__ = None
    with suppress(AttributeError):
        del main.__file__
    try:
        yield
    finally:
        for name, value in kept.items():
            if value is not None:
                setattr(main, name, value)
