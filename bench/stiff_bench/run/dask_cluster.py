"""Computes cells on a Dask cluster: each in a process of its own, beside a worker.

As many cells are given away as there are workers, so that nobody else's is lost with one. Dask
gives a cell whose worker ends to another one.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import re
import signal
import threading
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from distributed import Client, Future, KilledWorker, get_worker

import stiff_bench
import stiff_models
import stiff_protocols
from stiff_bench.console import say
from stiff_bench.plan.cells import CellTask
from stiff_bench.run.cell import fit_task, score
from stiff_bench.run.cell_process import Limits, Work
from stiff_bench.run.execution import Execution
from stiff_bench.run.fit import FitOutcome
from stiff_bench.run.isolate import compute_isolated, work_of
from stiff_bench.run.machine import pin_threads
from stiff_bench.run.progress import Display
from stiff_bench.run.provenance import environment
from stiff_bench.store.versions import LIBRARIES
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.source_code import code_below

SECONDS_TO_CONNECT = 10.0
SECONDS_BETWEEN_LOOKS = 0.01
SECONDS_BETWEEN_COUNTS = 1.0
GOES_ON = "the same command goes on where this run stopped"


@dataclass(eq=False, kw_only=True)
class DaskCluster(Execution):
    """Computes cells on a cluster.

    Attributes:
        words: "tcp://HOST:PORT" of a scheduler, or "local:N" workers of our own.
        limits: of every cell's process.
        output: folder for what workers of our own write.

    Raises:
        ConfigError: the words name no cluster.
    """

    words: str
    limits: Limits
    output: Path

    def __post_init__(self) -> None:
        """Check the words; nothing is started yet."""
        found = re.fullmatch(r"local:0*([1-9]\d*)|(?:tcp|tls)://[^/:]+:\d+", self.words)
        if not found:
            valid = "(valid: tcp://HOST:PORT, local:N)"
            raise ConfigError(f"--dask {self.words!r}: no cluster {valid}")
        self._said = f"--dask {self.words}"
        self._address = "" if found[1] else self.words
        self.at_once = int(found[1] or 1)

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends."""
        waiting = iter(tasks)
        task = next(waiting, None)
        if task is None:
            return  # and no cluster is needed
        code = shared_code()
        given: dict[Future, CellTask] = {}
        n_workers, counted = -1, 0.0
        with ExitStack() as stack:
            client = self._connected(stack)
            while task is not None or given:
                if time.monotonic() - counted >= SECONDS_BETWEEN_COUNTS:
                    with self._scheduler_may_go():
                        every = client.scheduler_info(n_workers=-1)["workers"]  # some count five
                    before, n_workers, counted = n_workers, len(every), time.monotonic()
                    if n_workers == 0 != before:
                        say(f"{self._said}: there is no worker; waiting for one")
                while task is not None and len(given) < n_workers:
                    display.start(task)
                    work = work_of(task, self.limits, fresh=True)
                    given[client.submit(compute_beside_worker, work, code, pure=False)] = task
                    task = next(waiting, None)
                time.sleep(SECONDS_BETWEEN_LOOKS)
                for future in [future for future in given if future.done()]:
                    with suppress(TimeoutError):  # its worker has gone with it: Dask makes it anew
                        with self._scheduler_may_go():
                            found = self._outcome(future)
                        task_of = given.pop(future)
                        yield score(task_of, fit_task(task_of), run_id, found)

    def _connected(self, stack: ExitStack) -> Client:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters, we say
        how: dict[str, Any] = {"address": self._address, "timeout": SECONDS_TO_CONNECT}
        if not self._address:
            scratch = stack.enter_context(TemporaryDirectory(dir=self.output, prefix=".dask-"))
            how = {"n_workers": self.at_once, "threads_per_worker": 1, "local_directory": scratch}
            how["dashboard_address"] = ":0"
        try:
            with _undisturbed():
                return stack.enter_context(Client(**how))
        except (OSError, ValueError) as error:
            raise ConfigError(f"{self._said}: no scheduler answers there ({error})") from error

    @contextmanager
    def _scheduler_may_go(self) -> Iterator[None]:
        """Turn a lost connection, which Dask may notice only now, into our error."""
        try:
            yield
        except TimeoutError:
            raise
        except OSError as error:
            raise ConfigError(f"{self._said}: the scheduler has gone; {GOES_ON}") from error

    def _outcome(self, future: Future) -> FitOutcome:
        """Return what became of a fit.

        Raises:
            ConfigError: a worker computes otherwise than we would.
            OSError: the scheduler has gone.
            TimeoutError: its worker has gone, with the result.
        """
        if future.status == "finished":
            worker, machine, found = future.result(timeout=SECONDS_TO_CONNECT)
            self.machines[worker] = machine
            return found  # type: ignore[no-any-return]
        if future.status != "error":
            raise ConnectionError
        error = future.exception()
        if isinstance(error, KilledWorker):
            n_workers = error.allowed_failures + 1
            reason = f"{n_workers} workers ended while they computed it"
            return FitOutcome(failure=reason, cause="killed its workers")
        raise ConfigError(
            f"{self._said}: a worker cannot run this stiffbench: {type(error).__name__}: {error}; "
            f"stop it, and {GOES_ON}"
        )


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Keep Ctrl-C until the block ends, and what is started in it from standard error.

    Ctrl-C comes to our own workers, too, which would print a traceback each; stopped in the middle
    of its start, Dask prints more of them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # no signal comes here
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    stderr = os.dup(2)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        signal.signal(signal.SIGINT, before)
        if came:
            os.kill(os.getpid(), signal.SIGINT)


@cache
def shared_code() -> str:
    """Return hashes of our packages and versions of the libraries that numbers go through."""
    packages = (stiff_bench, stiff_models, stiff_protocols)
    hashes = [code_below(Path(str(package.__file__)).parent) for package in packages]
    return " ".join([*hashes, *map(version, LIBRARIES)])


_environment = cache(environment)


def compute_beside_worker(work: Work, code: str) -> tuple[str, dict[str, str], FitOutcome | None]:
    """Compute a cell beside this worker; return the worker's address, its environment, the outcome.

    Raises:
        ConfigError: the worker's code is another than that of who asks.
    """
    worker = get_worker()
    if code != shared_code():
        raise ConfigError(f"{worker.address} has another version of stiffbench or of a library")
    pin_threads(work.limits.threads)
    multiprocessing.current_process().daemon = False  # one may not have children; ours end with it
    key = worker.get_current_task()

    def is_wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return worker.address, _environment(), compute_isolated(work, is_wanted)
