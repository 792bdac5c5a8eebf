"""Computes cells on a Dask cluster: each in a process of its own, beside a worker.

A worker has one cell at a time, given to it by name, so that nobody else's is lost with it; that
of a worker that ends is given to another one.
"""

from __future__ import annotations

import logging
import multiprocessing
import re
import time
from collections import Counter, deque
from collections.abc import Generator, Iterable, Mapping
from contextlib import ExitStack, suppress
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from distributed import Client, Future, LocalCluster, as_completed, get_worker

import stiff_bench
import stiff_models
import stiff_protocols
from stiff_bench.isolate import (
    Crash,
    Limits,
    Work,
    compute_isolated,
    result_of,
    work_of,
    work_of_run,
)
from stiff_bench.messages import say
from stiff_bench.progress import Display
from stiff_bench.provenance import environment
from stiff_bench.result_source import LIBRARIES
from stiff_bench.tasks import CellTask
from stiff_bench.threads import pin_threads
from stiff_protocols.errors import ConfigError
from stiff_protocols.record import CellResult
from stiff_protocols.source_code import code_below

SECONDS_TO_CONNECT = 10.0
SECONDS_BETWEEN_LOOKS = 0.01
SECONDS_BETWEEN_COUNTS = 1.0
SECONDS_UNTIL_SAID = 30.0
"""How long there is no worker before that is said."""
MOST_DEATHS = 3
"""How many workers may end while they compute a cell, before it is the cell's fault."""


class DaskCluster:
    """Computes cells on a cluster.

    Args:
        words: "tcp://HOST:PORT" of a scheduler, or "local:N" workers of our own.
        limits: of every cell's process.
        output: folder for what workers of our own write.
    """

    def __init__(self, words: str, limits: Limits, output: Path) -> None:
        """Check the words; nothing is started yet.

        Raises:
            ConfigError: they name no cluster.
        """
        self._said, self._limits, self._output = f"--dask {words}", limits, output
        self._address = words if re.fullmatch(r"(tcp|tls)://[^/:]+:\d+", words) else ""
        local = re.fullmatch(r"local:0*([1-9]\d*)", words)
        if not self._address and not local:
            raise ConfigError(f"--dask {words!r}: no cluster (valid: tcp://HOST:PORT, local:N)")
        self.at_once = int(local[1]) if local else 1
        self._machines: dict[str, Mapping[str, str]] = {}

    def machines(self) -> Mapping[str, Mapping[str, str]]:
        """Return the environments of the workers that were given cells, by their addresses."""
        return self._machines

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends.

        Raises:
            ConfigError: there is no scheduler, or it has gone.
        """
        waiting = iter(tasks)
        queue = deque(islice(waiting, 1))  # holds one while there are any
        if not queue:
            return  # and no cluster is needed
        common = work_of_run(run_id, self._limits)
        deaths: Counter[str] = Counter()
        given: dict[Future, tuple[str, CellTask]] = {}
        with ExitStack() as stack:
            client = self._connected(stack)
            stack.callback(lambda: _forget(client, given))
            workers, done = _Workers(client, self._said, self._machines), as_completed()
            while True:
                busy = {worker for worker, _ in given.values()}
                for worker in workers.usable() - busy:
                    if not queue:
                        break
                    task = queue.popleft()
                    queue.extend(islice(waiting, 0 if queue else 1))
                    if not deaths[task.cell.key]:
                        display.start(task)
                    work = work_of(common, task, fresh=True)
                    future = _submit(client, worker, compute_beside_worker, work)
                    given[future] = worker, task
                    done.add(future)
                if not given and not queue:
                    return
                if not done.has_ready():
                    time.sleep(SECONDS_BETWEEN_LOOKS)
                ended = done.next_batch(block=False) if done.has_ready() else []
                gone = [future for future, (one, _) in given.items() if one not in workers.alive]
                for future in {*ended, *gone} & given.keys():
                    _, task = given.pop(future)
                    found = _outcome(future)
                    future.cancel()
                    if found is None:
                        deaths[task.cell.key] += 1
                        if deaths[task.cell.key] < MOST_DEATHS:
                            queue.appendleft(task)
                            continue
                        said = f"{MOST_DEATHS} workers ended while they computed it"
                        found = Crash("killed its workers", said)
                    yield result_of(task, run_id, found)
                if client.status != "running":
                    raise ConfigError(
                        f"{self._said}: the scheduler has gone; the same command goes on where "
                        "this run stopped"
                    )

    def _connected(self, stack: ExitStack) -> Client:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters, we say
        address = self._address
        if not address:
            scratch = stack.enter_context(TemporaryDirectory(dir=self._output, prefix=".dask-"))
            cluster = LocalCluster(
                n_workers=self.at_once,
                threads_per_worker=1,
                dashboard_address=":0",
                local_directory=scratch,
            )
            address = stack.enter_context(cluster).scheduler_address
        try:
            return stack.enter_context(Client(address, timeout=SECONDS_TO_CONNECT))
        except (OSError, ValueError) as error:
            said = f"{self._said}: no scheduler answers there ({error})"
            raise ConfigError(said) from error


class _Workers:
    """Which workers there are, and which of them compute as we would.

    Args:
        client: of their scheduler.
        said: words of the option, for messages.
        machines: address of a worker -> its environment; those that are met are added.
    """

    def __init__(self, client: Client, said: str, machines: dict[str, Mapping[str, str]]) -> None:
        self._client, self._said, self._machines = client, said, machines
        self.alive: set[str] = set()
        self._asked: dict[str, Future | None] = {}
        self._counted, self._last_seen = -SECONDS_BETWEEN_COUNTS, time.monotonic()

    def usable(self) -> set[str]:
        """Return the workers of our code; one of another, and none for long, is said."""
        now = time.monotonic()
        if now - self._counted >= SECONDS_BETWEEN_COUNTS:
            self._counted = now
            with suppress(OSError):
                self.alive = set(self._client.nthreads())
            for worker in self.alive - self._asked.keys():
                self._asked[worker] = _submit(self._client, worker, about_worker)
            for worker, answer in self._asked.items():
                if answer is not None and answer.done():
                    self._asked[worker] = None
                    self._judge(worker, answer)
            if self._machines.keys() & self.alive:
                self._last_seen = now
            elif now - self._last_seen > SECONDS_UNTIL_SAID:
                self._last_seen = now
                say(f"{self._said}: there is no worker; waiting for one")
        return self._machines.keys() & self.alive

    def _judge(self, worker: str, answer: Future) -> None:
        if answer.status != "finished":
            if worker not in self.alive:
                return
            why = f"it cannot run stiffbench ({answer.exception()})"
        else:
            machine, code = answer.result()
            if code == shared_code():
                self._machines[worker] = machine
                return
            why = "it has another version of stiffbench or of a library"
        say(f"{self._said}: worker {worker} is given no cells: {why}")


def _submit(client: Client, worker: str, function: object, *words: object) -> Future:
    return client.submit(function, *words, workers=[worker], allow_other_workers=False, pure=False)


def _forget(client: Client, given: Iterable[Future]) -> None:
    """Tell the scheduler that nothing is wanted any more."""
    with suppress(Exception):  # it may be gone
        client.cancel(list(given), force=True)


def _outcome(future: Future) -> CellResult | Crash | None:
    """Return what became of a cell; None where its worker has gone, perhaps with the result."""
    if future.status == "error":
        error = future.exception()
        return Crash(type(error).__name__, f"its worker could not run it: {error}")
    found: CellResult | Crash | None = None
    if future.status == "finished":
        with suppress(OSError, TimeoutError):
            found = future.result(timeout=SECONDS_TO_CONNECT)
    return found


def shared_code() -> str:
    """Return hashes of our packages and versions of the libraries that numbers go through."""
    hashes = [code_below(Path(str(package.__file__)).parent) for package in _PACKAGES]
    return " ".join([*hashes, *map(version, LIBRARIES)])


_PACKAGES = (stiff_bench, stiff_models, stiff_protocols)


def about_worker() -> tuple[dict[str, str], str]:
    """Return a worker's environment, and the hash of its code."""
    return environment(), shared_code()


def compute_beside_worker(work: Work) -> CellResult | Crash | None:
    """Compute a cell in a process of its own beside this worker, which may be a daemon."""
    pin_threads(work.limits.threads)
    multiprocessing.current_process().daemon = False  # one may not have children; ours end with it
    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return compute_isolated(work, wanted)
