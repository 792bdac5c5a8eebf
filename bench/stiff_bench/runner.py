"""Runs the cells of a plan and stores each as it ends."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime

from stiff_bench.cells import compute_cell
from stiff_bench.config import RunPlan
from stiff_bench.memory import peak_memory_bytes
from stiff_bench.provenance import environment
from stiff_bench.store import ResultStore
from stiff_bench.tasks import CellTask
from stiff_protocols.record import (
    CellResult,
    RunManifest,
)

Watcher = Callable[[int, int, CellTask], None]
"""Is told the number of the cell that starts, how many there are, and the cell."""


def run_cells(
    tasks: Sequence[CellTask], plan: RunPlan, store: ResultStore, watcher: Watcher
) -> Iterator[CellResult]:
    """Compute the cells one after another, store each as it ends, and yield it.

    The run's manifest is written first and completed at the end, also when it is interrupted.
    """
    started = time.perf_counter()
    manifest = RunManifest(
        run_id=f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{uuid.uuid4().hex[:6]}",
        command=plan.command,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        status="running",
        environment=environment(),
        cells=tuple(task.cell.key for task in tasks),
    )
    store.write_manifest(manifest)
    kept = {task.cell.data_sha256: task.data for task in tasks}
    kept |= {task.cell.source_sha256: task.source for task in tasks if task.source is not None}
    for data in kept.values():
        store.write_data(data)
    done = 0
    try:
        for number, task in enumerate(tasks):
            watcher(number, len(tasks), task)
            result = compute_cell(task, manifest.run_id)
            store.write_cell(result)
            done += 1
            yield result
    finally:
        store.write_manifest(
            replace(
                manifest,
                status="finished" if done == len(tasks) else "interrupted",
                wall_s=time.perf_counter() - started,
                peak_memory_bytes=peak_memory_bytes(),
            )
        )
