"""Compute fits on a Dask cluster, each in a separate process that a worker watches.

As many fits are submitted as there are workers, so that a lost worker costs only its own fit.
Dask submits a fit whose worker ended to another worker.
"""

from __future__ import annotations

import logging
import multiprocessing
import re
import time
from collections.abc import Generator, Iterable
from concurrent.futures import wait
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

from distributed import Client, Future, KilledWorker, get_worker

import stiff_bench
import stiff_models
import stiff_protocols
from stiff_bench.plan.fits import FitTask
from stiff_bench.run.execution import Execution, fit_input, score
from stiff_bench.run.fit import FitOutcome
from stiff_bench.run.fit_process import Limits, Work
from stiff_bench.run.isolate import SECONDS_BETWEEN_LOOKS, RunningFit, work_of
from stiff_bench.run.machine import LIBRARIES, environment, pinned
from stiff_bench.run.progress import Display
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.evaluation import FitInput
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.source_code import code_below

SECONDS_TO_CONNECT, SECONDS_BETWEEN_COUNTS = 10.0, 1.0
RESUME_HINT = "run the same command again to continue"


@dataclass(eq=False, kw_only=True)
class DaskCluster(Execution):
    """Compute fits on a cluster.

    Attributes:
        address: "tcp://HOST:PORT" of a scheduler.
        limits: limits of the process of every fit.

    Raises:
        ConfigError: the address is invalid.
    """

    address: str
    limits: Limits

    def __post_init__(self) -> None:
        """Check the address; nothing is started yet."""
        if not re.fullmatch(r"(?:tcp|tls)://[^/:]+:\d+", self.address):
            raise ConfigError(f"--dask {self.address!r}: not an address (valid: tcp://HOST:PORT)")

    def results(
        self, tasks: Iterable[FitTask], run_id: str, display: Display
    ) -> Generator[FitResult, None, None]:
        """Yield the result of every fit as it ends."""
        waiting = iter(tasks)
        if (task := next(waiting, None)) is None:
            return  # no cluster is needed
        running: dict[Future, tuple[FitTask, FitInput]] = {}
        n_workers, counted = -1, 0.0
        with self._connected() as client:
            try:
                while task is not None or running:
                    if time.monotonic() - counted >= SECONDS_BETWEEN_COUNTS:
                        workers = client.scheduler_info(n_workers=-1)[
                            "workers"
                        ]  # the default lists five
                        n_before, n_workers, counted = n_workers, len(workers), time.monotonic()
                        if n_workers == 0 != n_before:
                            display.note(f"--dask {self.address}: no workers yet; waiting")
                    while task is not None and len(running) < n_workers:
                        display.start(task)
                        given = fit_input(task)
                        work = work_of(task, given, self.limits)
                        future = client.submit(
                            compute_in_child_process, work, shared_code(), pure=False
                        )
                        running[future], task = (task, given), next(waiting, None)
                    time.sleep(SECONDS_BETWEEN_LOOKS / 10)
                    for future in [future for future in running if future.done()]:
                        with suppress(TimeoutError):  # its worker ended: computed again
                            outcome = self._outcome(future)
                            of_future, given = running.pop(future)
                            yield score(of_future, given, run_id, outcome)
            except OSError as error:  # Dask may notice it only now
                message = f"--dask {self.address}: the scheduler has stopped; {RESUME_HINT}"
                raise ConfigError(message) from error

    def _connected(self) -> Client:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # our own messages suffice
        try:
            return Client(self.address, timeout=SECONDS_TO_CONNECT)
        except (OSError, ValueError) as error:
            reason = f"no scheduler answers there ({error}); start it, or check the address"
            raise ConfigError(f"--dask {self.address}: {reason}") from error

    def _outcome(self, future: Future) -> FitOutcome:
        """Return the outcome of a fit.

        Raises:
            ConfigError: a worker has other code than this process.
            OSError: the scheduler has stopped.
            TimeoutError: its worker ended, and the result is lost.
        """
        if future.status == "finished":
            worker, machine, outcome = future.result(timeout=SECONDS_TO_CONNECT)
            self.machines[worker] = machine
            return outcome  # type: ignore[no-any-return]
        if future.status != "error":
            raise ConnectionError
        error = future.exception()
        if isinstance(error, KilledWorker):
            n_workers = error.allowed_failures + 1
            reason = f"{n_workers} workers ended while they computed it"
            return FitOutcome(failure=reason, cause="killed its workers")
        raise ConfigError(
            f"--dask {self.address}: a worker cannot run this stiffbench: {type(error).__name__}: "
            f"{error}; stop this worker, and {RESUME_HINT}"
        )


@cache
def shared_code() -> str:
    """Return hashes of our packages and versions of the libraries that affect numbers."""
    packages = (stiff_bench, stiff_models, stiff_protocols)
    hashes = [code_below(Path(str(package.__file__)).parent) for package in packages]
    return " ".join([*hashes, *map(version, LIBRARIES)])


_environment = cache(environment)


def compute_in_child_process(
    work: Work, code: str
) -> tuple[str, dict[str, str], FitOutcome | None]:
    """Compute a fit in a child process of this worker.

    The worker's address, its environment and the outcome are returned.

    Raises:
        ConfigError: the worker's code differs from the code of the run.
    """
    worker = get_worker()
    if code != shared_code():
        raise ConfigError(f"{worker.address} has a different version of stiffbench or of a library")
    multiprocessing.current_process().daemon = False  # a daemon may not start children
    pinned(work.limits.threads)  # before the server of the fits' processes starts
    fit, key, outcome = RunningFit(work), worker.get_current_task(), None
    try:
        while outcome is None and (task := worker.state.tasks.get(key)) is not None:
            if task.state == "cancelled":
                break
            wait([fit.future], SECONDS_BETWEEN_LOOKS)
            outcome = fit.outcome()
    finally:
        fit.end()
    return worker.address, _environment(), outcome
