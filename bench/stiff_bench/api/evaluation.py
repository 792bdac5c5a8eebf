"""Fit and test models under protocols: runs, and studies with their pages."""

from __future__ import annotations

import math
import shlex
import shutil
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from stiff_bench.api.data_sets import Dataset, as_dataset
from stiff_bench.api.model import Model, model_choice
from stiff_bench.console import say
from stiff_bench.parameter_types import Bounds, Device, Fraction, Seed
from stiff_bench.plan.fits import FitTask, RunPlan, fit_tasks, plan_run
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import registry
from stiff_bench.results.results import Results
from stiff_bench.run.execution import REUSED_STATUSES, Execution
from stiff_bench.run.machine import pinned, usable_cores
from stiff_bench.run.runner import chosen_execution, run_fits
from stiff_bench.store.database import RUNS, ResultStore, mean_seconds, stored_statuses
from stiff_bench.store.names import grouped
from stiff_bench.tables.table import Column, Entry, Quantity, Table
from stiff_bench.tables.units import counted, first_few
from stiff_bench.tables.writers import Tables
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.plugin import DatasetInfo
from stiff_protocols.contract.record import FitResult

if TYPE_CHECKING:
    from stiff_bench.paper.study_file import Study

DEFAULT_DATASET = "kr10-twin"


@dataclass(frozen=True)
class Run:
    """A checked run of fits.

    Attributes:
        plans: plans with the same output folder.
        execution: execution of the fits.
    """

    plans: Sequence[RunPlan]
    execution: Execution

    @cached_property
    def tasks(self) -> list[FitTask]:
        """Return all fits of the plans."""
        return list(fit_tasks(*self.plans))

    def forecast(self) -> Tables:
        """Return the numbers of stored and missing fits per model, and the expected time."""
        table, line = forecast(self.tasks, self.plans[0].output, self.execution)
        return Tables([table], self.plans[0].command, line)

    def board(self, results: Results) -> Tables | None:
        """Return tables to print instead of the results; None: print the results."""
        return None

    def compute(self) -> Results:
        """Compute the missing fits, and return all results."""
        plan, tasks = self.plans[0], self.tasks
        store = ResultStore(plan.output)
        for warning in dict.fromkeys(
            task.presentation.warning for task in tasks if task.presentation.warning
        ):
            say(f"warning: {warning}")
        finished = run_fits(tasks, plan.command, store, self.execution)
        metrics = tuple(metric.key for metric in plan.metrics)
        return Results(plan.output, metrics, plan.command, finished)


@dataclass(frozen=True)
class RunAgainst(Run):
    """A run whose results are compared with published ones.

    Attributes:
        study: the whole study, or its short version.
        published: folder of the published results.
    """

    study: Study
    published: Path

    @cached_property
    def published_results(self) -> list[FitResult]:
        """Return published results of other models on the splits of this run.

        Raises:
            ConfigError: the published models have other data, splits or versions.
        """
        from stiff_bench.submissions.published_results import find_published

        return find_published(self.published, self.tasks)

    def compute(self) -> Results:
        """Copy the published results, compute missing fits, and return all results."""
        from stiff_bench.store.merging import merge_fits
        from stiff_bench.submissions.published_results import missing_places

        output, published = self.plans[0].output, self.published_results
        ResultStore(output)
        keys = {result.fit.key for result in published} | {task.fit.key for task in self.tasks}
        if output.resolve() != self.published.resolve():
            merge_fits([self.published], output, keys)
        n_models = counted(len({result.presentation.model for result in published}), "model")
        n_results = counted(len(published), "published result")
        say(f"{n_results} of {n_models} taken from {self.published}")
        if missing := missing_places(published, self.tasks):
            say(f"warning: without published results: {first_few(missing)}")
        computed = super().compute()
        finished = computed.finished
        assert finished is not None  # set by `Run.compute`
        together = replace(
            finished,
            results=(*finished.results, *published),
            cached=finished.cached | {result.fit.key for result in published},
        )
        return replace(computed, finished=together)

    def board(self, results: Results) -> Tables | None:
        """Return the study's board of these results; None: no board, or too few robots."""
        from stiff_bench.page.study_page import StudyResults

        try:
            tables = StudyResults(self.study, results.stored).leaderboard.tables
        except ConfigError:
            return None
        return Tables(tables, self.plans[0].command)


def forecast(tasks: Iterable[FitTask], output: Path, execution: Execution) -> tuple[Table, str]:
    """Return a table with the numbers of fits by model and of all, and a line on all.

    Nothing is computed or written; the results folder need not exist. Times are means of the
    model's stored fits.
    """
    statuses, means = stored_statuses(output), mean_seconds(output)
    reused, jobs = REUSED_STATUSES[execution.rerun], execution.at_once
    rows: dict[str, tuple[int, int, float]] = {}  # numbers of fits and missing fits, seconds
    for model, of_model in grouped(tasks, lambda task: task.presentation.model).items():
        missing = sum(statuses.get(task.fit.key) not in reused for task in of_model)
        seconds = missing * means.get(model, math.nan) if missing else 0.0
        rows[model] = len(of_model), missing, seconds
    n_all, n_missing, seconds = (sum(column) for column in zip(*rows.values(), strict=True))
    unknown = Quantity(status="unknown")
    entries: list[list[Entry]] = [
        [model, n, n - missing, missing, unknown if math.isnan(time) else Quantity(time)]
        for model, (n, missing, time) in [*rows.items(), ("all", (n_all, n_missing, seconds))]
    ]
    columns = [Column("model", "text"), *map(Column, ("fits", "cached", "to compute"))]
    columns.append(Column("time", unit="s", format=lambda time: _clock(time.value or 0.0)))
    if math.isnan(seconds):
        n_unknown = sum(missing for _, missing, time in rows.values() if math.isnan(time))
        about = f"time unknown: {counted(n_unknown, 'fit')} of models without a stored fit"
    else:
        about = f"about {_clock(seconds / jobs)} with {counted(jobs, 'job')}"
    counts = f"{counted(n_all, 'fit')}, {n_all - n_missing} cached, {n_missing} to compute"
    notes = ["time: h:min:s in sequence, from the mean of the model's stored fits"]
    table = Table("Fits to compute", columns, entries, notes, about={"jobs": jobs})
    return table, f"{counts}; {about}"


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


def prepare_run(
    datasets: Sequence[str | Dataset], *, how: Mapping[str, Any], **planned: Any
) -> Run:
    """Return a checked run.

    `how` has the arguments of `chosen_execution`, `planned` the arguments of `plan_run`.
    """
    plan = plan_run(registry(), datasets=_choices(datasets), with_reference=True, **planned)
    return Run([plan], chosen_execution(plan, registry(), **how))


def _choices(datasets: Sequence[str | Dataset]) -> list[str | Choice[DatasetInfo]]:
    return [word.choice if isinstance(word, Dataset) else word for word in datasets]


def model_and_data(
    models: Sequence[str],
    datasets: Sequence[str | Dataset],
    *,
    settings: Sequence[str],
    device: str,
) -> tuple[Model, Dataset]:
    """Return the unfitted model and the data set of `bench fit`."""
    if len(datasets) != 1:
        raise ConfigError("give either --dataset KEY or --data FILE.csv")
    plan = plan_run(
        registry(),
        models=models,
        datasets=_choices(datasets),
        settings=settings,
        output=Path(),
        device=device,
    )
    if len(plan.models) != 1:
        raise ConfigError(f"--model: {len(plan.models)} models; a file holds one model")
    return Model(plan.models[0]), Dataset(plan.datasets[0])


def evaluate(
    models: str | type | object | Sequence[str | type | object],
    datasets: str | Dataset | Sequence[str | Dataset] = DEFAULT_DATASET,
    *,
    protocol: str | Sequence[str] = "holdout",
    splits: Annotated[int, Bounds(at_least=1, at_most=10_000)] | None = None,
    seed: Seed = 0,
    metrics: Sequence[str] = (),
    coverage: Fraction | None = None,
    jobs: int = 1,
    device: Device = "auto",
    output: Path | str | None = None,
) -> Results:
    """Fit and test models on data sets under protocols.

    Args:
        models: models, such as vjm or ft-mlp@freeze=full, and all for every model; in Python also
            models of `make_model`, classes, and objects of them or of scikit-learn, such as
            `Ridge(alpha=0.1)` (each fit makes a new one). May be repeated.
        datasets: data sets, such as kr10-twin@specimen=3; in Python also data sets of
            `load_dataset` and `read_samples`. By default kr10-twin; may be repeated.
        protocol: protocol, such as kfold@folds=10; may be repeated.
        splits: number of splits; by default the protocol's.
        seed: seed of splits and models.
        metrics: metric of the tables, see `bench list metrics`; by default mae, stde and me, and
            for tool paths norm, norm-p95, norm-max and removed; may be repeated.
        coverage: coverage (0..1) of prediction intervals, per axis; by default 0.9.
        jobs: number of fits at the same time, each in a separate process, for which a script needs
            `if __name__ == "__main__":`. Classes of a script or notebook are fitted in this one.
        device: device that networks run on.
        output: folder to store the results; stored results are not computed again. None: the
            results are deleted with the `Results` object.

    Raises:
        ConfigError: a name, an option or a value is wrong, or `output` is given for a class that is
            defined in a script or notebook, whose code could not be identified later.
        DataError: a data set cannot be loaded.
    """
    if splits is not None and splits < 1:
        raise ConfigError(f"splits={splits}: give 1 or more, or None for the protocol's own number")
    model_choices = [model_choice(model, {}) for model in _listed(models)]
    local = [model for model in model_choices if model.cls.__module__ == "__main__"]
    if local and (output is not None or jobs > 1):
        raise ConfigError(
            f"{local[0].info.key}: results of a class of a script or notebook cannot be stored, "
            "and other processes cannot import it; leave out output=... and jobs=..., or define it "
            "in a file and call use_plugin(file)"
        )
    data = [
        dataset if isinstance(dataset, str) else as_dataset(dataset)
        for dataset in _listed(datasets)
    ]
    folder = Path(tempfile.mkdtemp(prefix="stiffbench-") if output is None else output)
    run = prepare_run(
        data,
        models=model_choices,
        protocols=_listed(protocol),
        metrics=metrics,
        coverage=coverage,
        splits=splits,
        seed=seed,
        device=device,
        output=folder,
        command="stiffbench.evaluate(...)",
        how={"threads": pinned(), "jobs": jobs, "isolate": False if local else None},
    )
    results = run.compute()
    if output is None:
        # results of `Results.select` belong to the same run and need the folder, too
        weakref.finalize(results.finished, shutil.rmtree, folder, ignore_errors=True)
    return results


def _listed(given: Any) -> list[Any]:
    return list(given) if isinstance(given, list | tuple) else [given]


@dataclass(frozen=True)
class Reproduction(Run):
    """A study and its page.

    Attributes:
        study: models, data sets and protocols of the run, and content of the page.
        output: parent of the study's folder, which gets page and results.
    """

    study: Study
    output: Path

    def compute(self) -> Results:
        """Print the forecast of the time, and compute the missing fits."""
        ResultStore(self.plans[0].output)  # report an unwritable folder first
        say(self.forecast().text)
        return super().compute()

    def write(self) -> Iterator[Path]:
        """Write the page and files for the available results, and yield each file."""
        from stiff_bench.page.study_page import write_page

        stored = stored_statuses(self.plans[0].output)
        missing = [task.model.info for task in self.tasks if task.fit.key not in stored]
        n_missing = sum(not info.missing() for info in missing)  # others cannot run here
        command = self.plans[0].command
        return write_page(self.study, self.output, command, n_missing)

    def write_site(self, folder: Path) -> Iterator[Path]:
        """Write the web pages of the study's leaderboard, and yield each file.

        Raises:
            ConfigError: the study has no board, or too few results.
        """
        from stiff_bench.api.data_sets import load_dataset
        from stiff_bench.api.registered import show
        from stiff_bench.page.site import LeaderboardSite
        from stiff_bench.page.study_page import StudyResults

        plan = self.plans[0]
        command = f"{plan.command} --site {shlex.quote(str(folder))}"
        stored = Results(plan.output).stored
        board = StudyResults(self.study, stored).leaderboard
        return LeaderboardSite(self.study, board, command, load_dataset, show).write(folder)


def run_of_study(
    name: str,
    *,
    output: Path,
    command: str,
    models: Sequence[str] = (),
    lite: bool = False,
    against: str = "",
    **how: Any,
) -> Run:
    """Return the runs of a study.

    Args:
        name: name of a shipped study, or of a .toml file.
        output: folder of the results.
        command: command of the run, stored with the results.
        models: values of `--model` instead of the study's models, with the VJM; empty: the study's.
        lite: True to run only the first split of the study's data sets `lite`.
        against: "published", or a folder, with results of other models; "": none.
        how: options of `chosen_execution`.

    Raises:
        ConfigError: the study, a model or the folder is unknown, or the published results have
            other data, splits or versions.
    """
    from stiff_bench.paper.study_file import find_study
    from stiff_bench.submissions.published_results import OPTION, published_folder

    study = find_study(name)
    if against and not models:
        raise ConfigError(f"{against} requires --model", OPTION)
    published = published_folder(against, study) if against else None
    if lite:
        study = study.lite_version()
    if models:
        study = study.with_models([*dict.fromkeys([REFERENCE_MODEL, *models])])
    plans = study.plans(registry(), output=output, command=command)
    execution = chosen_execution(plans[0], registry(), **how)
    if published is None:
        return Run(plans, execution)
    run = RunAgainst(plans, execution, study, published)
    run.published_results  # noqa: B018  # raise errors before computing
    return run


def run_facts(results: Results) -> list[str]:
    """Return how the fits ended, where results are stored, and how to repeat old failures."""
    finished = results.finished
    assert finished is not None
    lines = [f"{finished.summary}; {finished.wall_s:.1f} s; stored in {results.folder}"]
    failed = [result.fit.key for result in finished.results if result.status == "failed"]
    if old := len(finished.cached.intersection(failed)):
        lines.append(f"{old} of the failures are of earlier runs; --rerun failed repeats them")
    return lines


def reproduction(name: str, *, output: Path, command: str, **how: Any) -> Reproduction:
    """Return the reproduction of a shipped study, or of a study file.

    Args:
        name: name of the study, or of a .toml file.
        output: parent of the study's folder.
        command: command of the run, stored with the results.
        how: options of `chosen_execution`; by default one job per core.
    """
    from stiff_bench.page.study_page import check_names
    from stiff_bench.paper.study_file import find_study

    study = find_study(name)
    check_names(study)
    if how["jobs"] is None and not how["dask"] and how["isolate"] is not False:
        how["jobs"] = usable_cores()
    plans = study.plans(registry(), output=output / study.name / RUNS, command=command)
    execution = chosen_execution(plans[0], registry(), **how)
    return Reproduction(plans, execution, study, output)
