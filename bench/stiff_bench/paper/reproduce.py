"""Runs all parts of a study as one run: each cell once, one progress display, one manifest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from stiff_bench.config import RunPlan, RunRequest, plan_run
from stiff_bench.execution import Execution
from stiff_bench.forecast import Forecast, forecast
from stiff_bench.paper.expected_time import expected_s
from stiff_bench.paper.study import SEED, StudyRun
from stiff_bench.progress import Expected, display
from stiff_bench.registry import Registry
from stiff_bench.robot_words import RobotWords
from stiff_bench.run import warn
from stiff_bench.runner import Finished, run_cells
from stiff_bench.store import ResultStore, stored_keys
from stiff_bench.tasks import CellTask, cell_tasks
from stiff_protocols.record import Presentation

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
            ConfigError: one of its words is unknown here.
        """
        requests = (
            RunRequest(
                models=run.models,
                datasets=run.datasets,
                protocols=run.protocols,
                metrics=METRICS,
                splits=run.splits,
                seed=SEED,
                settings=(),
                device="auto",
                output=output,
                data=None,
                robot=RobotWords(None, None, ""),
                command=command,
            )
            for run in runs
        )
        return cls(tuple(plan_run(request, registry) for request in requests), output, command)

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
        stored = stored_keys(self.output, warn)
        return sum(task.cell.key not in stored for task in self.tasks())


def forecast_of(study: Study, execution: Execution) -> Forecast:
    """Return what a study would compute, and how long that takes.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided.
    """
    return forecast(study.tasks(), study.output, execution, warn, prior=expected_s)


def run_study(
    study: Study, store: ResultStore, execution: Execution, foreseen: Forecast
) -> Finished:
    """Compute what is missing of a study, store it, and return all of its results.

    Args:
        study: what is asked for.
        store: its output.
        execution: how.
        foreseen: the forecast, for the time left.

    Raises:
        StiffBenchError: the data cannot be loaded or divided, or the output not written.
    """
    tasks = list(study.tasks())
    with display() as shown:
        return run_cells(tasks, study.command, store, execution, shown, _expected(foreseen))


def _expected(foreseen: Forecast) -> Expected:
    """Return the forecast's times as shares of the run's wall time."""
    of_part = {
        (part.model, part.dataset, part.protocol): (part.cell_s or 0.0) / foreseen.jobs
        for part in foreseen.parts
    }

    def of_cell(shown: Presentation) -> float:
        return of_part.get((shown.model, shown.dataset, shown.protocol), 0.0)

    return Expected(foreseen.seconds, of_cell)
