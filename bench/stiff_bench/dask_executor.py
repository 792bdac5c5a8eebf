"""Computes cells on a Dask cluster: each in a process of its own, beside a worker.

`Client.submit` and `as_completed`, not joblib's backend: there a cell that kills its worker hangs
the whole run, here it costs that cell alone. A worker has one cell at a time, given to it by name,
so that nobody else's is lost with it; what the cluster loses (a worker with its result, the
scheduler with all that it knew) is submitted again.
"""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Generator, Iterable, Mapping
from contextlib import suppress
from itertools import chain
from pathlib import Path

from distributed import Client

from stiff_bench.cell_process import Limits
from stiff_bench.cluster_words import cluster_of
from stiff_bench.crash import Crash
from stiff_bench.dask_connection import SECONDS_BETWEEN_COUNTS, Connection, Lost
from stiff_bench.executor import result_of
from stiff_bench.isolated import work_of
from stiff_bench.messages import say
from stiff_bench.progress import Display
from stiff_bench.tasks import CellTask
from stiff_protocols.errors import ConfigError
from stiff_protocols.record import CellResult

PATIENCE_S = 300.0
"""How long a run waits for a scheduler that has gone, before it gives up."""
MOST_DEATHS = 3
"""How many workers may end while they compute a cell, before it is the cell's fault."""


class DaskExecutor:
    """Computes cells on a cluster, one a worker at once.

    Args:
        words: of --dask.
        limits: of every cell's process.
        output: folder for what a cluster of our own writes.
        patience_s: how long it waits for a scheduler that has gone.
    """

    def __init__(
        self, words: str, limits: Limits, output: Path, patience_s: float = PATIENCE_S
    ) -> None:
        """Check the words; nothing is started yet.

        Raises:
            ConfigError: they name no cluster.
        """
        self._words, self._limits, self._patience_s = words, limits, patience_s
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters, we say
        self._cluster = cluster_of(words, limits, output)
        self._machines: dict[str, Mapping[str, str]] = {}
        self.at_once = self._cluster.workers

    def job_script(self) -> str:
        """Return the script of a job that would be submitted; "" where there are no jobs."""
        return self._cluster.job_script()

    def machines(self) -> Mapping[str, Mapping[str, str]]:
        """Return the environments of the workers that were given cells, by their addresses."""
        return self._machines

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends.

        Raises:
            ConfigError: there is no scheduler, or it stays away.
        """
        fresh = iter(tasks)
        first = next(fresh, None)
        if first is None:
            return  # and no cluster is needed
        queue = _Queue(chain([first], fresh))
        with self._cluster.entered as address:
            while queue:
                with Connection(address, self._words, self._machines) as connection:
                    yield from self._until_gone(connection, queue, run_id, display)
                if queue:
                    gone = "the scheduler is gone; waiting for another, and for workers of it"
                    say(f"--dask {self._words}: {gone}")
                    self._wait_for_scheduler(address)

    def _until_gone(
        self, connection: Connection, queue: _Queue, run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield results until all are there or the scheduler is gone; the queue has the rest."""
        while queue or connection.running:
            for worker in connection.free_workers():
                if (task := queue.next()) is not None:
                    display.start(task)
                    connection.submit(work_of(task, run_id, self._limits), task, worker)
            for task, found in connection.ended():
                if isinstance(found, Lost):
                    if (crash := queue.lost(task)) is not None:
                        yield result_of(task, run_id, crash)
                else:
                    yield result_of(task, run_id, found)
            if connection.gone():
                for task in connection.running:
                    queue.again(task)
                return

    def _wait_for_scheduler(self, address: str) -> None:
        end = time.monotonic() + self._patience_s
        while time.monotonic() < end:
            with suppress(OSError), Client(address, timeout=SECONDS_BETWEEN_COUNTS):
                return
            time.sleep(SECONDS_BETWEEN_COUNTS)
        raise ConfigError(
            f"--dask {self._words}: the scheduler has been gone for {self._patience_s:.0f} s; the "
            "same command goes on where this run stopped"
        )


class _Queue:
    """The cells that nobody computes now: those that were lost first, then new ones.

    Args:
        fresh: the new ones, taken when their turn comes.
    """

    def __init__(self, fresh: Iterable[CellTask]) -> None:
        self._fresh = iter(fresh)
        self._waiting: deque[CellTask] = deque()
        self._deaths: Counter[str] = Counter()
        self._look_ahead()

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def next(self) -> CellTask | None:
        """Return the next cell; None where there is none."""
        if not self._waiting:
            return None
        task = self._waiting.popleft()
        self._look_ahead()
        return task

    def again(self, task: CellTask) -> None:
        """Take a cell back."""
        self._waiting.appendleft(task)

    def lost(self, task: CellTask) -> Crash | None:
        """Take a cell back whose worker has ended; return its end where that is too often."""
        self._deaths[task.cell.key] += 1
        if self._deaths[task.cell.key] < MOST_DEATHS:
            self.again(task)
            return None
        return Crash("killed its workers", f"{MOST_DEATHS} workers ended while they computed it")

    def _look_ahead(self) -> None:
        """Have a cell waiting while there are any, so that the end is seen without a worker."""
        if not self._waiting and (task := next(self._fresh, None)) is not None:
            self._waiting.append(task)
