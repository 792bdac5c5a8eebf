"""`bench run`: from a checked plan to tables on standard output."""

from __future__ import annotations

import time
from collections.abc import Sequence

from stiff_bench.analysis.forecast import Forecast, forecast, forecast_line, render_forecast
from stiff_bench.console import print_text, say
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.plan.request import RunPlan
from stiff_bench.run.costs import peak_memory_bytes
from stiff_bench.run.execution import IN_THIS_PROCESS, Execution
from stiff_bench.run.progress import display
from stiff_bench.run.runner import Finished, run_cells, tally
from stiff_bench.store.database import ResultStore
from stiff_bench.tables.render import render
from stiff_bench.tables.table import build_tables


def execute(plan: RunPlan, fmt: str, execution: Execution = IN_THIS_PROCESS) -> int:
    """Run a plan, print its tables, and return the exit status: 1 if a cell failed or was skipped.

    Raises:
        StiffBenchError: the data cannot be loaded or divided, or the output not written.
    """
    start = time.perf_counter()
    warnings = [choice.info.warning for choice in plan.protocols if choice.info.warning]
    finished = computed([plan], execution, warnings)
    print_text(render(build_tables(finished.results, plan.metrics), fmt, plan.command))
    say(
        f"{tally(finished.results, finished.cached)}; {time.perf_counter() - start:.1f} s, peak "
        f"memory of this process {peak_memory_bytes() / 2**20:.0f} MiB; stored in {plan.output}"
    )
    say_old_failures(finished)
    return 0 if all(result.status == "ok" for result in finished.results) else 1


def computed(
    plans: Sequence[RunPlan], execution: Execution, warnings: Sequence[str] = ()
) -> Finished:
    """Compute what is missing of plans for one folder, as one run; return all of their results.

    Warnings are said once it is sure that the plans can be run.

    Raises:
        StiffBenchError: the data cannot be loaded or divided, or the output not written.
    """
    tasks = list(cell_tasks(*plans))
    store = ResultStore(plans[0].output)
    for warning in warnings:
        say(f"warning: {warning}")
    with display() as shown:
        return run_cells(tasks, plans[0].command, store, execution, shown)


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
    print_text(render_forecast(found, fmt, plans[0].command))
    say(forecast_line(found))
    return 0


def say_old_failures(finished: Finished) -> None:
    """Say how many failures were there before, and how they are computed again."""
    failed = [one for one in finished.results if one.status == "failed"]
    old = sum(one.cell.key in finished.cached for one in failed)
    if old:
        say(f"{old} of the failures are of earlier runs; --rerun failed computes them again")
