"""Run the fits of a plan without a stored result, and store each as it ends."""

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
from stiff_bench.plan.fits import FitTask, RunPlan
from stiff_bench.plan.registry import OURS, Registry
from stiff_bench.run.execution import REUSED_STATUSES, Execution, Rerun
from stiff_bench.run.fit_process import Limits
from stiff_bench.run.isolate import LocalProcesses
from stiff_bench.run.machine import environment, peak_memory_bytes
from stiff_bench.run.progress import display
from stiff_bench.store.database import ResultStore, read_results
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.record import FitResult, RunManifest


@dataclass(frozen=True, repr=False)
class Finished(BriefFields):
    """Results of a finished run.

    Attributes:
        results: results of every fit, in the order of the plan.
        cached: keys of the fits whose results or failures were already stored.
        wall_s: wall time, s.
    """

    results: tuple[FitResult, ...]
    cached: frozenset[str]
    wall_s: float

    @property
    def summary(self) -> str:
        """Count the fits by status: "18 ok, 2 failed (1 SIGKILL, 1 timed out), 3 cached"."""
        counts, causes = Counter[str](), Counter[str]()
        for result in self.results:
            if result.status == "failed":
                causes[result.cause or "error"] += 1
            else:
                counts["cached" if result.fit.key in self.cached else result.status] += 1
        words = [f"{counts['ok']} ok"] if counts["ok"] or not counts["cached"] else []
        if causes:
            numbered = [f"{number} {cause}" for cause, number in causes.most_common()]
            shown_causes = numbered if len(causes) > 1 else causes
            words.append(f"{causes.total()} failed ({', '.join(shown_causes)})")
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
    """Return the execution of a plan for the options of the command line.

    Fits run in separate processes if several run in parallel, if a limit is set, or if a
    third-party model is run.

    Raises:
        ConfigError: two options contradict each other, or the cluster does not exist.
    """
    jobs = jobs or 1
    limits = Limits(threads, timeout, memory)
    reasons: dict[str, object] = {
        f"--jobs {jobs}": jobs > 1,
        f"--dask {dask}": dask,
        "--timeout": timeout is not None,
        "--memory": memory is not None,
    }
    needed = [reason for reason, is_set in reasons.items() if is_set]
    if isolate is False and needed:
        raise ConfigError(f"--no-isolate: {needed[0]} needs a process for each fit")
    if dask and jobs > 1:
        raise ConfigError(
            f"--jobs {jobs}: omit it with --dask; the cluster sets the number of parallel fits"
        )
    keys = {model.info.key for model in plan.models}
    third_party_keys = {key for key in keys if registry.origins.get(key, OURS) != OURS}
    isolated = bool(needed) or (bool(third_party_keys) if isolate is None else isolate)
    facts = {"jobs": str(jobs), "isolated": str(isolated).lower()}
    facts |= {"threads": str(threads), "dask": dask}
    options: dict[str, Any] = {"rerun": rerun, "facts": facts}
    if dask:
        require(f"--dask {dask}", "distributed")
        from stiff_bench.run.dask_cluster import DaskCluster

        return DaskCluster(address=dask, limits=limits, **options)
    if third_party_keys and not isolated:
        names = ", ".join(sorted(third_party_keys))
        say(f"warning: {names}: not isolated; a model could read the test labels")
    if isolated:
        return LocalProcesses(at_once=jobs, limits=limits, **options)
    return Execution(**options)


def run_fits(
    tasks: Sequence[FitTask],
    command: str,
    store: ResultStore,
    execution: Execution,
) -> Finished:
    """Compute the fits that have no result yet, store each as it ends, and return them all.

    The run's manifest, with the command, is written first and completed at the end, also when the
    run is interrupted. `tasks` contains each fit once, also if several parts of a study need it.

    Raises:
        StoreError: a result cannot be written.
        ConfigError: the cluster does not answer.
    """
    started = time.perf_counter()
    results_by_key = _stored(tasks, store, execution.rerun)
    cached = set(results_by_key)
    missing = [task for task in tasks if task.fit.key not in results_by_key]

    def waiting() -> Iterator[FitTask]:
        """Yield each fit in its turn, unless another run has finished it meanwhile."""
        for task in missing:
            stored = None if execution.rerun == "all" else store.result(task.fit.key)
            if stored is None:
                yield task
            else:
                results_by_key[task.fit.key] = _with_labels(stored, task)
                cached.add(task.fit.key)
                progress.end(stored)

    with _recorded_run(tasks, command, store, execution) as run_id:
        if missing:
            sets = {task.fit.data_sha256: task.data for task in tasks}
            sets |= {
                task.fit.source_sha256: task.source for task in tasks if task.source is not None
            }
            for data in sets.values():
                store.write_data(data)
            with display() as progress:
                progress.begin(len(missing), len(cached))
                with closing(execution.results(waiting(), run_id, progress)) as ended_results:
                    for result in ended_results:
                        store.write_fits([result])
                        results_by_key[result.fit.key] = result
                        progress.end(result)
    results = tuple(results_by_key[task.fit.key] for task in tasks)
    return Finished(results, frozenset(cached), time.perf_counter() - started)


def _stored(tasks: Sequence[FitTask], store: ResultStore, rerun: Rerun) -> dict[str, FitResult]:
    """Return the stored results and failures that are reused.

    A skipped fit is tried again: the missing package may be installed now.
    """
    if rerun == "all":
        return {}
    tasks_by_key = {task.fit.key: task for task in tasks}
    return {
        result.fit.key: _with_labels(result, tasks_by_key[result.fit.key])
        for result in read_results(store.folder, tasks_by_key.keys())
        if result.status in REUSED_STATUSES[rerun]
    }


def _with_labels(result: FitResult, task: FitTask) -> FitResult:
    """Return a stored result with the names and number of splits of this run."""
    return replace(result, presentation=task.presentation, n_splits=task.n_splits)


@contextmanager
def _recorded_run(
    tasks: Sequence[FitTask], command: str, store: ResultStore, execution: Execution
) -> Iterator[str]:
    """Write the manifest of a run at its start and end, and yield its name."""
    started = time.perf_counter()
    manifest = RunManifest(
        run_id=f"{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}-{uuid.uuid4().hex[:6]}",
        command=command,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        status="running",
        environment=environment() | dict(execution.facts),
        cells=tuple(task.fit.key for task in tasks),
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
        with suppress(StoreError):  # the first error is reported
            complete("interrupted")
        raise
    complete("finished")
