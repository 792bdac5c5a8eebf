"""`bench run`: from a checked plan to tables on standard output."""

from __future__ import annotations

import time
from collections import Counter

import click

from stiff_bench.config import RunPlan
from stiff_bench.memory import peak_memory_bytes
from stiff_bench.messages import print_text
from stiff_bench.progress import display
from stiff_bench.render import render
from stiff_bench.runner import run_cells
from stiff_bench.store import ResultStore
from stiff_bench.tables import build_tables
from stiff_bench.tasks import cell_tasks


def execute(plan: RunPlan, fmt: str) -> int:
    """Run a plan, print its tables, and return the exit status: 1 if a cell failed or was skipped.

    Raises:
        StiffBenchError: the data cannot be loaded or divided, or the output not written.
    """
    start = time.perf_counter()
    tasks = cell_tasks(plan)
    store = ResultStore(plan.output)
    for choice in plan.protocols:
        if choice.info.warning:
            click.echo(f"bench: warning: {choice.info.warning}", err=True)
    with display() as shown:
        results = list(run_cells(tasks, plan, store, shown.cell))
    print_text(render(build_tables(results, plan.metrics), fmt, plan.command))
    count = Counter(result.status for result in results)
    skipped = f", {count['skipped']} skipped" if count["skipped"] else ""
    click.echo(
        f"bench: {count['ok']} cells ok, {count['failed']} failed{skipped}; "
        f"{time.perf_counter() - start:.1f} s, peak memory "
        f"{peak_memory_bytes() / 2**20:.0f} MiB; stored in {plan.output}",
        err=True,
    )
    return 0 if count["ok"] == len(results) else 1
