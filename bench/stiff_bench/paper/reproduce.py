"""Runs all parts of a study as one run: each cell once, one progress display, one manifest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from stiff_bench.analysis.forecast import Forecast, forecast
from stiff_bench.paper.study import SEED, StudyRun
from stiff_bench.plan.cells import CellTask, cell_tasks
from stiff_bench.plan.registry import Registry
from stiff_bench.plan.request import RunPlan, plan_run
from stiff_bench.run.execution import Execution
from stiff_bench.run.progress import display
from stiff_bench.run.runner import Finished, run_cells
from stiff_bench.store.database import ResultStore, stored_statuses

METRICS = ("mae", "stde", "me")


@dataclass(frozen=True)
class Study:
    """What is to be run.

    Attributes:
        plans: its parts, checked; at least one.
        output: folder of the results.
        command: that asked for it.
    """

    plans: tuple[RunPlan, ...]
    output: Path
    command: str

    @classmethod
    def of(
        cls, runs: Sequence[StudyRun], *, output: Path, command: str, registry: Registry
    ) -> Study:
        """Check the parts of a study.

        Raises:
            ConfigError: one of its models is unknown here.
        """
        plans = [
            plan_run(
                run.chosen(registry),
                registry,
                metrics=METRICS,
                splits=run.splits,
                seed=SEED,
                output=output,
                command=command,
            )
            for run in runs
        ]
        return cls(tuple(plans), output, command)

    def tasks(self) -> Iterator[CellTask]:
        """Yield every cell once, in the order of the parts.

        Raises:
            StiffBenchError: a data set cannot be loaded or divided.
        """
        seen: set[str] = set()
        for plan in self.plans:
            for task in cell_tasks(plan):
                if task.cell.key not in seen:
                    seen.add(task.cell.key)
                    yield task

    def n_missing(self) -> int:
        """Return how many cells have neither a result nor a failure in the output.

        Raises:
            StiffBenchError: a data set cannot be loaded or divided.
        """
        stored = stored_statuses(self.output)
        return sum(task.cell.key not in stored for task in self.tasks())


def forecast_of(study: Study, execution: Execution) -> Forecast:
    """Return what a study would compute, and how long that takes.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided.
    """
    jobs = execution.executor.at_once
    return forecast(study.tasks(), study.output, jobs=jobs, rerun=execution.rerun)


def run_study(study: Study, store: ResultStore, execution: Execution) -> Finished:
    """Compute what is missing of a study, store it, and return all of its results.

    Args:
        study: what is asked for.
        store: its output.
        execution: how.

    Raises:
        StiffBenchError: the data cannot be loaded or divided, or the output not written.
    """
    tasks = list(study.tasks())
    with display() as shown:
        return run_cells(tasks, study.command, store, execution, shown)
