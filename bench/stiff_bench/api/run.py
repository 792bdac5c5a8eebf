"""A run that is checked and not yet computed, and what the words of a command line make one of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from stiff_bench.analysis.forecast import (
    LONGEST_FIT_S,
    LONGEST_S,
    Timings,
    forecast,
    forecast_line,
    forecast_table,
    time_fits,
    untimed_fits,
)
from stiff_bench.api.catalog import registry
from stiff_bench.api.data import Dataset
from stiff_bench.api.model import Model
from stiff_bench.api.results import Results
from stiff_bench.api.tables import Tables
from stiff_bench.console import say
from stiff_bench.plan.cells import CellTask, cell_tasks
from stiff_bench.plan.options import choices
from stiff_bench.plan.request import RunPlan, plan_run, with_reference
from stiff_bench.plan.robot_words import RobotWords
from stiff_bench.run.execution import Execution
from stiff_bench.run.progress import display
from stiff_bench.run.runner import chosen_execution, run_cells
from stiff_bench.store.database import ResultStore
from stiff_bench.tables.render import render
from stiff_bench.tables.units import counted
from stiff_datasets.measured.file_options import FileOptions
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.files import check_new_file


@dataclass(frozen=True)
class Run:
    """What is to be computed, checked.

    Attributes:
        plans: for one folder.
        execution: how.
    """

    plans: Sequence[RunPlan]
    execution: Execution

    @cached_property
    def tasks(self) -> list[CellTask]:
        """Every cell of the plans.

        Raises:
            StiffBenchError: the data cannot be loaded or divided.
        """
        return list(cell_tasks(*self.plans))

    def forecast(self) -> Tables:
        """Return what would be computed of each model, and how long all takes, in a sentence.

        One fit is timed of each model and data set whose model has no stored fit, not on a cluster.

        Raises:
            StiffBenchError: the data cannot be loaded or divided.
        """
        plan, jobs, rerun = self.plans[0], self.execution.at_once, self.execution.rerun
        untimed = untimed_fits(self.tasks, plan.output, rerun=rerun)
        timed: Timings = {}
        facts = self.execution.facts
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
        text_as = partial(render, tables, command=plan.command)
        return Tables(lambda: tables, text_as, forecast_line(forecasts[-1], jobs))

    def compute(self) -> Results:
        """Compute what is missing; return the results of all.

        Raises:
            StiffBenchError: the data cannot be loaded or divided, or the output not written.
        """
        plan, tasks = self.plans[0], self.tasks
        store = ResultStore(plan.output)
        for warning in dict.fromkeys(task.shown.warning for task in tasks if task.shown.warning):
            say(f"warning: {warning}")
        with display() as shown:
            finished = run_cells(tasks, plan.command, store, self.execution, shown)
        metrics = tuple(one.key for one in plan.metrics)
        return Results(plan.output, metrics, plan.command, finished)


def run_of_words(
    *,
    models: Sequence[str],
    datasets: Sequence[str],
    protocols: Sequence[str],
    settings: Sequence[str],
    data: Sequence[Path],
    no_torque: bool,
    sheet: str | None,
    pose_tolerance: float,
    robot: str | None,
    urdf: Path | None,
    tcp: Sequence[float] | None,
    tip: str | None,
    metrics: Sequence[str],
    coverage: float | None,
    splits: int | None,
    seed: int,
    device: str,
    output: Path,
    command: str,
    **how: Any,
) -> Run:
    """Return the run that the options of `bench run` ask for; `how` is of `chosen_execution`.

    Raises:
        ConfigError: an option or a value is wrong.
    """
    asked = choices(
        registry(),
        models=models,
        datasets=datasets,
        protocols=protocols,
        settings=settings,
        data=data,
        options=FileOptions(no_torque, sheet, pose_tolerance),
        robot=RobotWords(robot, urdf, tcp, tip),
    )
    plan = plan_run(
        with_reference(asked, registry()),
        registry(),
        output=output,
        metrics=metrics,
        splits=splits,
        seed=seed,
        device=device,
        command=command,
        coverage=coverage,
    )
    return Run([plan], chosen_execution(plan, registry(), **how))


def model_and_data(
    output: Path,
    *,
    models: Sequence[str],
    datasets: Sequence[str],
    settings: Sequence[str],
    data: Sequence[Path],
    no_torque: bool,
    sheet: str | None,
    pose_tolerance: float,
    robot: str | None,
    urdf: Path | None,
    tcp: Sequence[float] | None,
    tip: str | None,
    device: str,
) -> tuple[Model, Dataset]:
    """Return the model and the data set that the options of `bench fit` ask for.

    Raises:
        ConfigError: an option or a value is wrong, or they name several.
        StoreError: the output cannot be written, or exists.
    """
    if len(datasets) + len(data) != 1:
        raise ConfigError("give one of --dataset KEY and --data FILE.csv")
    asked = choices(
        registry(),
        models=models,
        datasets=datasets,
        settings=settings,
        data=data,
        options=FileOptions(no_torque, sheet, pose_tolerance),
        robot=RobotWords(robot, urdf, tcp, tip),
    )
    plan = plan_run(asked, registry(), output=output, device=device)
    if len(plan.models) != 1:
        raise ConfigError(f"--model: {len(plan.models)} models; a file holds one model")
    check_new_file(output)
    return Model(plan.models[0]), Dataset(plan.datasets[0])
