"""Fitting and testing of models under protocols: runs, and studies with their pages."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.forecast import (
    LONGEST_FIT_S,
    LONGEST_S,
    forecast,
    forecast_line,
    forecast_table,
    time_fits,
    untimed_fits,
)
from stiff_bench.api.data_sets import Dataset, as_dataset
from stiff_bench.api.model import Model, model_choice
from stiff_bench.api.registered import registry
from stiff_bench.api.stored_results import Results
from stiff_bench.api.tables import Tables
from stiff_bench.console import say
from stiff_bench.paper.study_file import Study, find_study
from stiff_bench.plan.cells import CellTask, cell_tasks
from stiff_bench.plan.options import Choice, Chosen, choices
from stiff_bench.plan.request import RunPlan, plan_run, with_reference
from stiff_bench.run.cell import Execution
from stiff_bench.run.machine import pinned, usable_cores
from stiff_bench.run.progress import display
from stiff_bench.run.runner import chosen_execution, run_cells
from stiff_bench.store.database import ResultStore, stored_statuses
from stiff_bench.store.merging import merge
from stiff_bench.submissions.published_results import (
    OPTION,
    find_published,
    missing_places,
    published_folder,
)
from stiff_bench.submissions.statuses import SUBMISSIONS, board_statuses
from stiff_bench.tables.units import counted, first_few
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.record import CellResult

DEFAULT_DATASET = "kr10-twin"


@dataclass(frozen=True)
class Run:
    """Fits to be computed, checked.

    Attributes:
        plans: for one folder.
        execution: how.
    """

    plans: Sequence[RunPlan]
    execution: Execution

    @cached_property
    def tasks(self) -> list[CellTask]:
        """Every cell of the plans."""
        return list(cell_tasks(*self.plans))

    def forecast(self) -> Tables:
        """Return what would be computed of each model, and how long all takes, in a sentence.

        One fit is timed of each model and data set whose model has no stored fit, not on a cluster.
        """
        plan, jobs, rerun = self.plans[0], self.execution.at_once, self.execution.rerun
        untimed = untimed_fits(self.tasks, plan.output, rerun=rerun)
        facts, timed = self.execution.facts, list[CellResult]()
        if untimed and not facts["dask"]:
            n_models = len({task.shown.model for task in untimed})
            say(
                f"timing a fit of {counted(n_models, 'model')} without a stored one, for at most "
                f"{LONGEST_S + LONGEST_FIT_S:g} s"
            )
            timing = chosen_execution(
                plan, registry(), threads=int(facts["threads"]), timeout=LONGEST_FIT_S
            )
            timed = time_fits(untimed, timing)
        forecasts = forecast(self.tasks, plan.output, rerun=rerun, timed=timed)
        tables = [forecast_table(forecasts, jobs)]
        return Tables(tables, plan.command, forecast_line(forecasts[-1], jobs))

    def board(self, results: Results) -> Tables | None:
        """Return tables that are printed in place of the results; None: there are none."""
        return None

    def compute(self) -> Results:
        """Compute what is missing; return the results of all."""
        plan, tasks = self.plans[0], self.tasks
        store = ResultStore(plan.output)
        for warning in dict.fromkeys(task.shown.warning for task in tasks if task.shown.warning):
            say(f"warning: {warning}")
        with display() as progress:
            finished = run_cells(tasks, plan.command, store, self.execution, progress)
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
    def published_results(self) -> list[CellResult]:
        """The published results of other models on the splits of this run.

        Raises:
            ConfigError: data, splits or versions of the published models are others.
        """
        return find_published(self.published, self.tasks)

    def compute(self) -> Results:
        """Copy the published results, compute what is missing, and return all together."""
        output, published = self.plans[0].output, self.published_results
        ResultStore(output)
        keys = {result.cell.key for result in published} | {task.cell.key for task in self.tasks}
        if output.resolve() != self.published.resolve():
            merge([self.published], output, keys)
        n_models = counted(len({result.shown.model for result in published}), "model")
        n_results = counted(len(published), "published result")
        say(f"{n_results} of {n_models} taken from {self.published}")
        if missing := missing_places(published, self.tasks):
            say(f"warning: without published results: {first_few(missing)}")
        computed = super().compute()
        finished = computed.finished
        assert finished is not None  # it was computed now
        together = replace(
            finished,
            results=(*finished.results, *published),
            cached=finished.cached | {result.cell.key for result in published},
        )
        return replace(computed, finished=together)

    def board(self, results: Results) -> Tables | None:
        """Return the study's board of these results; None: it has none, or too few robots."""
        from stiff_bench.paper.study_board import StudyResults

        stored = StoredResults.of_results(results.folder, results.cells)
        try:
            tables = StudyResults(self.study, stored).board_tables
        except ConfigError:
            return None
        return Tables(tables, self.plans[0].command)


def prepare_run(
    models: Sequence[str | Choice[ModelInfo]],
    datasets: Sequence[str | Dataset],
    protocols: Sequence[str],
    *,
    settings: Sequence[str] = (),
    how: Mapping[str, Any],
    **planned: Any,
) -> Run:
    """Return a run that is checked; `settings` are of the words among the first three arguments.

    `how` is of `chosen_execution`, the other arguments are those of `plan_run`.
    """
    chosen = with_reference(_chosen(models, datasets, protocols, settings), registry())
    plan = plan_run(chosen, registry(), **planned)
    return Run([plan], chosen_execution(plan, registry(), **how))


def _chosen(
    models: Sequence[str | Choice[ModelInfo]],
    datasets: Sequence[str | Dataset],
    protocols: Sequence[str],
    settings: Sequence[str],
) -> Chosen:
    data_sets = [word.choice if isinstance(word, Dataset) else word for word in datasets]
    return choices(
        registry(), models=models, datasets=data_sets, protocols=protocols, settings=settings
    )


def model_and_data(
    models: Sequence[str],
    datasets: Sequence[str | Dataset],
    *,
    settings: Sequence[str] = (),
    device: str = "auto",
) -> tuple[Model, Dataset]:
    """Return the model and the data set of `bench fit`, checked as those of a run."""
    if len(datasets) != 1:
        raise ConfigError("give one of --dataset KEY and --data FILE.csv")
    chosen = _chosen(models, datasets, (), settings)
    plan = plan_run(chosen, registry(), output=Path(), device=device)
    if len(plan.models) != 1:
        raise ConfigError(f"--model: {len(plan.models)} models; a file holds one model")
    return Model(plan.models[0]), Dataset(plan.datasets[0])


def evaluate(
    models: str | type | Model | Sequence[str | type | Model],
    datasets: str | Dataset | Sequence[str | Dataset] = DEFAULT_DATASET,
    *,
    protocol: str | Sequence[str] = "holdout",
    splits: int | None = None,
    seed: int = 0,
    metrics: Sequence[str] = (),
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
        metrics: keys, that the tables show; none: mae, stde and me, of tool paths norm, norm-p95,
            norm-max and removed. All are computed.
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
    if splits is not None and splits < 1:
        raise ConfigError(f"splits={splits}: give 1 or more, or None for the protocol's own number")
    model_choices = [model_choice(model, {}) for model in _listed(models)]
    local = [model for model in model_choices if model.cls.__module__ == "__main__"]
    if local and (output is not None or jobs > 1):
        raise ConfigError(
            f"{local[0].info.key}: a class of a script or notebook, whose results cannot be kept, "
            "and which other processes cannot import; leave out output=... and jobs=..., or define "
            "it in a file and call use_plugin(file)"
        )
    data = [
        dataset if isinstance(dataset, str) else as_dataset(dataset)
        for dataset in _listed(datasets)
    ]
    folder = Path(tempfile.mkdtemp(prefix="stiffbench-") if output is None else output)
    run = prepare_run(
        model_choices,
        data,
        _listed(protocol),
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
        # `Results.select` has results of the same run, which need the folder as well
        weakref.finalize(results.finished, shutil.rmtree, folder, ignore_errors=True)
    return results


def _listed(given: Any) -> list[Any]:
    return list(given) if isinstance(given, list | tuple) else [given]


@dataclass(frozen=True)
class Reproduction(Run):
    """A study, and the page that is written of it.

    Attributes:
        study: what is run, and what stands on the page.
        output: folder of the study's folder, which takes page and results.
    """

    study: Study
    output: Path

    def compute(self) -> Results:
        """Say how long it takes, and compute what is missing."""
        ResultStore(self.plans[0].output)  # a folder that cannot be written is said before all else
        say(self.forecast().text)
        return super().compute()

    def write(self) -> Iterator[Path]:
        """Write what the results allow, and yield each file."""
        from stiff_bench.paper.study_page import write_page

        stored = stored_statuses(self.plans[0].output)
        n_missing = sum(task.cell.key not in stored for task in self.tasks)
        command = self.plans[0].command
        return write_page(self.study, self.output, command, n_missing, self.model_statuses)

    @property
    def model_statuses(self) -> dict[str, str]:
        """Model -> "verified" or "reported"; empty without models of submissions."""
        return board_statuses(self.plans[0].output, self.output / SUBMISSIONS.name)

    def write_site(self, folder: Path) -> Iterator[Path]:
        """Write the web pages of the study's leaderboard, and yield each file.

        Raises:
            ConfigError: the study has no board, or too few results.
        """
        from stiff_bench.api.leaderboard_site import LeaderboardSite

        plan = self.plans[0]
        site = LeaderboardSite(self.study, plan.output, plan.command, self.model_statuses)
        return site.write(folder)


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
        name: of a study that is shipped, or of a file that ends in .toml.
        output: folder of the results.
        command: for the record.
        models: words of `--model` in place of the study's own, with the VJM; none: the study's.
        lite: only the first split of the study's data sets `lite`.
        against: "published", or a folder, with results of other models; "": none.
        how: the options of `chosen_execution`.

    Raises:
        ConfigError: the study, a model or the folder is unknown, or the published results have
            other data, splits or versions.
    """
    study = find_study(name)
    if against and not models:
        raise ConfigError(f"{against} requires --model", OPTION)
    published = published_folder(against, study) if against else None
    if lite:
        study = study.lite_version()
    if models:
        study = study.with_models(with_reference_word(models))
    plans = study.plans(registry(), output=output, command=command)
    execution = chosen_execution(plans[0], registry(), **how)
    if published is None:
        return Run(plans, execution)
    run = RunAgainst(plans, execution, study, published)
    run.published_results  # noqa: B018  # refused before anything is computed
    return run


def with_reference_word(models: Sequence[str]) -> list[str]:
    """Return words of models with the reference model before the others."""
    return [*dict.fromkeys([REFERENCE_MODEL, *models])]


def reproduction(name: str, *, output: Path, command: str, **how: Any) -> Reproduction:
    """Return a study that is shipped, or that a file describes.

    Args:
        name: of the study, or of a file that ends in .toml.
        output: folder of the folder of the study's name.
        command: for the record.
        how: the options of `chosen_execution`; as many jobs as there are cores by default.
    """
    from stiff_bench.paper.study_page import check_names

    study = find_study(name)
    check_names(study)
    if how["jobs"] is None and not how["dask"] and how["isolate"] is not False:
        how["jobs"] = usable_cores()
    plans = study.plans(registry(), output=output / study.name / "runs", command=command)
    execution = chosen_execution(plans[0], registry(), **how)
    return Reproduction(plans, execution, study, output)
