"""Computes cells on a Dask cluster: each in a process of its own, beside a worker of one thread.

`Client.submit` and `as_completed`, not joblib's backend: there a cell that kills its worker hangs
the whole run, here it costs that cell alone. What the cluster loses (a worker with its result, the
scheduler with all that it knew) is submitted again.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path

from distributed import Client, Future, KilledWorker, as_completed

from stiff_bench.cell_process import Limits, Work
from stiff_bench.cluster_words import cluster_of
from stiff_bench.crash import Crash
from stiff_bench.executor import result_of
from stiff_bench.isolated import compute_isolated, work_of
from stiff_bench.messages import say
from stiff_bench.progress import Display
from stiff_bench.provenance import environment
from stiff_bench.tasks import CellTask
from stiff_bench.threads import pin_threads
from stiff_protocols.errors import ConfigError
from stiff_protocols.record import CellResult

PATIENCE_S = 300.0
"""How long a run waits for a scheduler that has gone, before it gives up."""
SECONDS_TO_CONNECT = 10.0
SECONDS_BETWEEN_LOOKS = 0.01
SECONDS_BETWEEN_COUNTS = 2.0
SECONDS_UNTIL_SAID = 30.0
"""How long there is no worker before that is said."""


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
        self._machines: dict[str, Mapping[str, str]] = {}
        self._cluster = cluster_of(words, limits, output)
        self.at_once = self._cluster.workers

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends.

        Raises:
            ConfigError: there is no scheduler, or it stays away.
        """
        lost: deque[CellTask] = deque()
        fresh = iter(tasks)
        with self._cluster.entered as address:
            while True:
                with _Connection(address, self._words) as connection:
                    self._machines |= connection.environments()
                    yield from self._until_gone(connection, lost, fresh, run_id, display)
                if not lost:
                    return
                say(f"--dask {self._words}: the scheduler is gone; waiting for another")
                self._wait_for_scheduler(address)

    def job_script(self) -> str:
        """Return the script of a job that would be submitted; "" where there are no jobs."""
        return self._cluster.job_script()

    def machines(self) -> Mapping[str, Mapping[str, str]]:
        """Return the environments of the workers that were there at the start."""
        return self._machines

    def _until_gone(
        self,
        connection: _Connection,
        lost: deque[CellTask],
        fresh: Iterator[CellTask],
        run_id: str,
        display: Display,
    ) -> Generator[CellResult, None, None]:
        """Yield results until all are there, or the scheduler is gone: then `lost` holds cells."""
        while True:
            while connection.has_room():
                task = lost.popleft() if lost else next(fresh, None)
                if task is None:
                    break
                display.start(task)
                connection.submit(task, work_of(task, run_id, self._limits))
            if not connection.running:
                return
            for task, found in connection.ended():
                if found is None:
                    lost.append(task)
                else:
                    yield result_of(task, run_id, found)
            if connection.gone():
                lost.extend(connection.running.values())
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


class _Connection:
    """A client of a scheduler, and the cells that it was given."""

    def __init__(self, address: str, words: str) -> None:
        """Store what is needed to connect."""
        self._address, self._words = address, words
        self.running: dict[Future, CellTask] = {}
        self._stack = ExitStack()
        self._n_workers, self._counted = 0, -SECONDS_BETWEEN_COUNTS
        self._alone_since: float | None = None

    def __enter__(self) -> _Connection:
        """Connect.

        Raises:
            ConfigError: there is no scheduler.
        """
        try:
            self._client = self._stack.enter_context(
                Client(self._address, timeout=SECONDS_TO_CONNECT)
            )
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"--dask {self._words}: no scheduler answers there ({error})"
            ) from error
        self._done = as_completed(loop=self._client.loop)
        return self

    def __exit__(self, *_: object) -> None:
        """Tell the scheduler that nothing is wanted any more, and leave."""
        with suppress(Exception):  # it may be gone
            self._client.cancel(list(self.running), force=True)
        self._stack.close()

    def environments(self) -> dict[str, Mapping[str, str]]:
        """Return the environment of each worker.

        Raises:
            ConfigError: a worker has no stiffbench.
        """
        try:
            found: dict[str, Mapping[str, str]] = self._client.run(environment)
        except ImportError as error:
            raise ConfigError(
                f"--dask {self._words}: a worker cannot import stiffbench ({error}); install this "
                "version there"
            ) from error
        return found

    def has_room(self) -> bool:
        """Say whether a worker waits for work. One that had two cells could lose both."""
        return len(self.running) < self._workers()

    def submit(self, task: CellTask, work: Work) -> None:
        """Give a cell to the cluster."""
        future = self._client.submit(compute_on_worker, work, pure=False)
        self.running[future] = task
        self._done.add(future)

    def ended(self) -> Iterator[tuple[CellTask, CellResult | Crash | None]]:
        """Yield what has ended: a result, how the cell failed, or None where it must go again."""
        if not self._done.has_ready():
            time.sleep(SECONDS_BETWEEN_LOOKS)
            return
        for future in self._done.next_batch(block=False):
            task = self.running.pop(future)
            yield task, _found(future)
            future.release()

    def gone(self) -> bool:
        """Say whether the scheduler is."""
        return bool(self._client.status != "running")

    def _workers(self) -> int:
        """Return how many threads there are, as of a moment ago; none for long is said."""
        now = time.monotonic()
        if now - self._counted >= SECONDS_BETWEEN_COUNTS:
            self._counted = now
            with suppress(OSError):
                self._n_workers = sum(self._client.nthreads().values())
            self._say_if_alone(now)
        return self._n_workers

    def _say_if_alone(self, now: float) -> None:
        if self._n_workers:
            self._alone_since = None
        elif self._alone_since is None:
            self._alone_since = now
        elif now - self._alone_since > SECONDS_UNTIL_SAID:
            self._alone_since = now
            say(f"--dask {self._words}: no worker is there; waiting for one")


def _found(future: Future) -> CellResult | Crash | None:
    """Return what became of a cell."""
    if future.status == "finished":
        try:
            found: CellResult | Crash | None = future.result(timeout=SECONDS_TO_CONNECT)
            return found
        except (OSError, TimeoutError):  # the worker that held it has gone
            return None
    if future.status != "error":  # cancelled or lost
        return None
    error = future.exception()
    if isinstance(error, KilledWorker):
        return Crash("killed its workers", f"one worker after another ended while it ran: {error}")
    return Crash(type(error).__name__, f"its worker could not run it: {error}")


def compute_on_worker(work: Work) -> CellResult | Crash | None:
    """Compute a cell in a process of its own beside this worker."""
    from distributed import get_worker

    pin_threads(work.limits.threads)
    worker = get_worker()
    key = worker.get_current_task()

    def unwanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    return compute_isolated(work, unwanted=unwanted)
