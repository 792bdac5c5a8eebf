"""A run that is checked and not yet computed, and what the words of a command line make one of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from stiff_bench.analysis.forecast import forecast, forecast_line, forecast_table
from stiff_bench.api.catalog import registry
from stiff_bench.api.data import Dataset
from stiff_bench.api.model import Model
from stiff_bench.api.results import Results
from stiff_bench.api.tables import Tables
from stiff_bench.console import say
from stiff_bench.plan.cells import CellTask, cell_tasks
from stiff_bench.plan.request import RunPlan, plan_run, with_reference
from stiff_bench.plan.words import RobotWords, choices
from stiff_bench.run.execution import Execution
from stiff_bench.run.progress import display
from stiff_bench.run.runner import chosen_execution, run_cells
from stiff_bench.store.database import ResultStore
from stiff_bench.tables.render import render
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

        Raises:
            StiffBenchError: the data cannot be loaded or divided.
        """
        plan, jobs = self.plans[0], self.execution.at_once
        found = forecast(self.tasks, plan.output, rerun=self.execution.rerun)
        tables = [forecast_table(found, jobs)]
        text_as = partial(render, tables, command=plan.command)
        return Tables(lambda: tables, text_as, forecast_line(found[-1], jobs))

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
    robot: str | None,
    urdf: Path | None,
    tcp: Sequence[float] | None,
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
        no_torque=no_torque,
        robot=RobotWords(robot, urdf, tcp),
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
    robot: str | None,
    urdf: Path | None,
    tcp: Sequence[float] | None,
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
        no_torque=no_torque,
        robot=RobotWords(robot, urdf, tcp),
    )
    plan = plan_run(asked, registry(), output=output, device=device)
    if len(plan.models) != 1:
        raise ConfigError(f"--model: {len(plan.models)} models; a file holds one model")
    check_new_file(output)
    return Model(plan.models[0]), Dataset(plan.datasets[0])
