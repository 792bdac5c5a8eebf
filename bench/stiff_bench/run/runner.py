"""Runs the cells of a plan that have no result yet, and stores each as it ends."""

from __future__ import annotations

import time
import uuid
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Literal

from stiff_bench.console import say
from stiff_bench.plan.cells import CellTask
from stiff_bench.plan.registry import OURS, Registry
from stiff_bench.plan.request import RunPlan
from stiff_bench.run.cell import COUNTING, Execution, Rerun
from stiff_bench.run.costs import peak_memory_bytes
from stiff_bench.run.fit_process import Limits
from stiff_bench.run.isolate import LocalProcesses
from stiff_bench.run.progress import Display
from stiff_bench.run.provenance import environment
from stiff_bench.store.database import ResultStore, read_results
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.record import CellResult, RunManifest


@dataclass(frozen=True, repr=False)
class Finished(BriefFields):
    """What a run has in the end.

    Attributes:
        results: of every cell, in the order of the plan.
        cached: keys of the cells whose results or failures were there.
        wall_s: how long it took, s.
    """

    results: tuple[CellResult, ...]
    cached: frozenset[str]
    wall_s: float

    @property
    def summary(self) -> str:
        """What became of the cells: "18 ok, 2 failed (1 SIGKILL, 1 timed out), 3 cached"."""
        counts, causes = Counter[str](), Counter[str]()
        for result in self.results:
            if result.status == "failed":
                causes[result.cause or "error"] += 1
            else:
                counts["cached" if result.cell.key in self.cached else result.status] += 1
        words = [f"{counts['ok']} ok"] if counts["ok"] or not counts["cached"] else []
        if causes:
            numbered = [f"{number} {cause}" for cause, number in causes.most_common()]
            why = numbered if len(causes) > 1 else causes
            words.append(f"{causes.total()} failed ({', '.join(why)})")
        words += [f"{counts[word]} {word}" for word in ("skipped", "cached") if counts[word]]
        return ", ".join(words)


def chosen_execution(
    plan: RunPlan,
    registry: Registry,
    *,
    threads: int,
    jobs: int | None = None,
    isolate: bool | None = None,
    timeout: float | None = None,
    memory: int | None = None,
    dask: str = "",
    rerun: Rerun = "missing",
) -> Execution:
    """Return how a plan is executed, from the options of the command line.

    Cells are isolated where several run at once, a limit is to hold, or a stranger's model is run.

    Raises:
        ConfigError: two options contradict each other, or there is no such cluster.
    """
    jobs = jobs or 1
    limits = Limits(threads, timeout, memory)
    reasons = {
        f"--jobs {jobs}": jobs > 1,
        f"--dask {dask}": dask,
        "--timeout": timeout is not None,
        "--memory": memory is not None,
    }
    needed = [reason for reason, holds in reasons.items() if holds]
    if isolate is False and needed:
        raise ConfigError(f"--no-isolate: {needed[0]} needs a process for each fit")
    if dask and jobs > 1:
        raise ConfigError(f"--jobs {jobs}: the cluster of --dask says how many run at once")
    keys = {one.info.key for one in plan.models}
    strangers = {key for key in keys if registry.origins.get(key, OURS) != OURS}
    isolated = bool(needed) or (bool(strangers) if isolate is None else isolate)
    facts = {"jobs": str(jobs), "isolated": str(isolated).lower()}
    facts |= {"threads": str(threads), "dask": dask}
    how: dict[str, Any] = {"rerun": rerun, "facts": facts}
    if dask:
        require(f"--dask {dask}", "distributed")
        from stiff_bench.run.dask_cluster import DaskCluster

        return DaskCluster(address=dask, limits=limits, **how)
    if strangers and not isolated:
        names = ", ".join(sorted(strangers))
        say(f"warning: {names}: in the run's own process, where a model could read test labels")
    if isolated:
        return LocalProcesses(at_once=jobs, limits=limits, **how)
    return Execution(**how)


def run_cells(
    tasks: Sequence[CellTask],
    command: str,
    store: ResultStore,
    execution: Execution,
    display: Display,
) -> Finished:
    """Compute the cells that have no result yet, store each as it ends, and return them all.

    The run's manifest, with the command, is written first and completed at the end, also when the
    run is interrupted. A cell that several parts of a study need stands once in `tasks`.

    Raises:
        StoreError: a result cannot be written.
        ConfigError: the cluster does not answer.
    """
    started = time.perf_counter()
    found = _stored(tasks, store, execution.rerun)
    cached = set(found)
    missing = [task for task in tasks if task.cell.key not in found]

    def waiting() -> Iterator[CellTask]:
        """Give a cell when its turn comes, unless another run has finished it meanwhile."""
        for task in missing:
            other = None if execution.rerun == "all" else store.result(task.cell.key)
            if other is None:
                yield task
            else:
                found[task.cell.key] = _as_asked(other, task)
                cached.add(task.cell.key)
                display.end(other)

    display.begin(len(missing), len(cached))
    with _described(tasks, command, store, execution) as run_id:
        sets = {task.cell.data_sha256: task.data for task in tasks}
        sets |= {one.cell.source_sha256: one.source for one in tasks if one.source is not None}
        for data in sets.values():
            store.write_data(data)
        with closing(execution.results(waiting(), run_id, display)) as ended:
            for result in ended:
                store.write_cells([result])
                found[result.cell.key] = result
                display.end(result)
    results = tuple(found[task.cell.key] for task in tasks)
    return Finished(results, frozenset(cached), time.perf_counter() - started)


def _stored(tasks: Sequence[CellTask], store: ResultStore, rerun: Rerun) -> dict[str, CellResult]:
    """Return the results and failures that are there and count.

    A cell that was skipped is looked at again: what it lacked may be installed now.
    """
    if rerun == "all":
        return {}
    wanted = {task.cell.key: task for task in tasks}
    return {
        result.cell.key: _as_asked(result, wanted[result.cell.key])
        for result in read_results(store.folder, wanted.keys())
        if result.status in COUNTING[rerun]
    }


def _as_asked(result: CellResult, task: CellTask) -> CellResult:
    """Return a stored result with what this run puts beside its numbers."""
    return replace(result, shown=task.shown, n_splits=task.n_splits)


@contextmanager
def _described(
    tasks: Sequence[CellTask], command: str, store: ResultStore, execution: Execution
) -> Iterator[str]:
    """Keep the manifest of a run while it lasts, and give its name."""
    started = time.perf_counter()
    manifest = RunManifest(
        run_id=f"{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}-{uuid.uuid4().hex[:6]}",
        command=command,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        status="running",
        environment=environment() | dict(execution.facts),
        cells=tuple(task.cell.key for task in tasks),
    )
    store.write_manifest(manifest)

    def complete(status: Literal["finished", "interrupted"]) -> None:
        measured: dict[str, Any] = {
            "wall_s": time.perf_counter() - started,
            "peak_memory_bytes": peak_memory_bytes(),
        }
        machines = execution.machines
        store.write_manifest(replace(manifest, status=status, machines=machines, **measured))

    try:
        yield manifest.run_id
    except BaseException:
        with suppress(StoreError):  # what stopped the run is what is to be said
            complete("interrupted")
        raise
    complete("finished")
