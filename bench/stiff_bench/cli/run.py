"""`bench run`: from a checked plan to tables on standard output."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stiff_bench.analysis.forecast import Forecast, forecast, forecast_line, forecast_table
from stiff_bench.api.evaluation import computed
from stiff_bench.api.results import Results
from stiff_bench.console import print_text, say
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.plan.request import RunPlan
from stiff_bench.run.execution import IN_THIS_PROCESS, Execution
from stiff_bench.run.runner import Finished
from stiff_bench.tables.render import render


def execute(
    plan: RunPlan, fmt: str, execution: Execution = IN_THIS_PROCESS, *, verbose: bool = False
) -> int:
    """Run a plan, print its tables, and return the exit status: 1 if a cell failed or was skipped.

    Raises:
        StiffBenchError: the data cannot be loaded or divided, or the output not written.
    """
    finished = computed([plan], execution)
    metrics = tuple(one.key for one in plan.metrics)
    results = Results(plan.output, metrics, plan.command, finished.results)
    print_text(results.table(verbose=verbose).text_as(fmt))
    say_summary(finished, plan.output)
    return 0 if all(result.status == "ok" for result in finished.results) else 1


def say_summary(finished: Finished, folder: Path) -> None:
    """Say what became of the cells, where results are, and how old failures are computed again."""
    say(f"{finished.tally}; {finished.wall_s:.1f} s; stored in {folder}")
    failed = [one.cell.key for one in finished.results if one.status == "failed"]
    if old := len(finished.cached.intersection(failed)):
        say(f"{old} of the failures are of earlier runs; --rerun failed computes them again")


def foreseen(plans: Sequence[RunPlan], execution: Execution) -> Forecast:
    """Return what plans for one folder would compute, and how long that takes.

    Raises:
        StiffBenchError: the data cannot be loaded or divided.
    """
    jobs = execution.executor.at_once
    return forecast(cell_tasks(*plans), plans[0].output, jobs=jobs, rerun=execution.rerun)


def show_plan(plans: Sequence[RunPlan], fmt: str, execution: Execution) -> int:
    """Print what a run would compute, and compute nothing.

    Raises:
        StiffBenchError: the data cannot be loaded or divided.
    """
    found = foreseen(plans, execution)
    print_text(render([forecast_table(found)], fmt, plans[0].command))
    say(forecast_line(found))
    return 0
