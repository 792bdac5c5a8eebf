"""`bench run`: from a checked plan to tables on standard output."""

from __future__ import annotations

import time

from stiff_bench.config import RunPlan
from stiff_bench.execution import IN_THIS_PROCESS, Execution
from stiff_bench.forecast import forecast
from stiff_bench.forecast_text import forecast_line, render_forecast
from stiff_bench.memory import peak_memory_bytes
from stiff_bench.messages import print_text, say
from stiff_bench.packing import pack_if_many
from stiff_bench.progress import display
from stiff_bench.render import render
from stiff_bench.runner import Finished, run_cells
from stiff_bench.store import ResultStore
from stiff_bench.tables import build_tables
from stiff_bench.tally import tally
from stiff_bench.tasks import cell_tasks
from stiff_protocols.errors import StoreError


def execute(plan: RunPlan, fmt: str, execution: Execution = IN_THIS_PROCESS) -> int:
    """Run a plan, print its tables, and return the exit status: 1 if a cell failed or was skipped.

    Raises:
        StiffBenchError: the data cannot be loaded or divided, or the output not written.
    """
    start = time.perf_counter()
    tasks = list(cell_tasks(plan))
    store = ResultStore(plan.output)
    for choice in plan.protocols:
        if choice.info.warning:
            say(f"warning: {choice.info.warning}")
    with display() as shown:
        finished = run_cells(tasks, plan.command, store, execution, shown)
    print_text(render(build_tables(finished.results, plan.metrics), fmt, plan.command))
    say(
        f"{tally(finished.results, finished.cached)}; {time.perf_counter() - start:.1f} s, peak "
        f"memory of this process {peak_memory_bytes() / 2**20:.0f} MiB; stored in {plan.output}"
    )
    say_old_failures(finished)
    pack_if_many(plan.output)
    return 0 if all(result.status == "ok" for result in finished.results) else 1


def show_plan(plan: RunPlan, fmt: str, execution: Execution) -> int:
    """Print what a run would compute, and compute nothing.

    Raises:
        StiffBenchError: the data cannot be loaded or divided.
    """
    found = forecast(cell_tasks(plan), plan.output, execution, warn)
    print_text(render_forecast(found, fmt, plan.command))
    say(forecast_line(found))
    return 0


def warn(error: StoreError) -> None:
    """Say what is wrong with a stored file that others stand in for."""
    say(f"warning: {error}")


def say_old_failures(finished: Finished) -> None:
    """Say how many failures were there before, and how they are computed again."""
    failed = [one for one in finished.results if one.status == "failed"]
    old = sum(one.cell.key in finished.cached for one in failed)
    if old:
        say(f"{old} of the failures are of earlier runs; --rerun failed computes them again")
