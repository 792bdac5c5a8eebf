"""A client of a Dask scheduler: which workers may be given cells, and what became of those."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass

from distributed import Client, Future, as_completed

from stiff_bench.cell_process import Work
from stiff_bench.crash import Crash
from stiff_bench.isolated import compute_isolated
from stiff_bench.messages import say
from stiff_bench.provenance import environment
from stiff_bench.tasks import SCORING, CellTask
from stiff_bench.threads import pin_threads
from stiff_models.catalog import REFERENCE_MODEL, model_info
from stiff_protocols.errors import ConfigError
from stiff_protocols.record import CellResult
from stiff_protocols.source_code import code_of

SECONDS_TO_CONNECT = 10.0
SECONDS_BETWEEN_LOOKS = 0.01
SECONDS_BETWEEN_COUNTS = 1.0
SECONDS_UNTIL_SAID = 30.0
"""How long there is no worker before that is said."""


@dataclass(frozen=True)
class Lost:
    """What became of a cell whose worker has gone, perhaps with its result."""


@dataclass(frozen=True, eq=False)
class _Given:
    """A cell that a worker was given."""

    worker: str
    task: CellTask


class Connection:
    """A client of a scheduler, and the cells that its workers were given.

    Args:
        address: of the scheduler.
        words: of --dask, for messages.
        machines: address of a worker -> its environment; those that are met are added.
    """

    def __init__(self, address: str, words: str, machines: dict[str, Mapping[str, str]]) -> None:
        """Store what is needed to connect."""
        self._address, self._words, self._machines = address, words, machines
        self._given: dict[Future, _Given] = {}
        self._asked: dict[str, Future] = {}
        self._trusted: set[str] = set()
        self._judged: set[str] = set()
        self._alive: set[str] = set()
        self._counted = -SECONDS_BETWEEN_COUNTS
        self._last_seen = time.monotonic()
        self._stack = ExitStack()

    def __enter__(self) -> Connection:
        """Connect.

        Raises:
            ConfigError: there is no scheduler.
        """
        try:
            client = Client(self._address, timeout=SECONDS_TO_CONNECT)
            self._client = self._stack.enter_context(client)
        except (OSError, ValueError) as error:
            said = f"--dask {self._words}: no scheduler answers there ({error})"
            raise ConfigError(said) from error
        self._done = as_completed(loop=self._client.loop)
        return self

    def __exit__(self, *_: object) -> None:
        """Tell the scheduler that nothing is wanted any more, and leave."""
        with suppress(Exception):  # it may be gone
            self._client.cancel([*self._given, *self._asked.values()], force=True)
        self._stack.close()

    @property
    def running(self) -> list[CellTask]:
        """The cells that workers have."""
        return [given.task for given in self._given.values()]

    def gone(self) -> bool:
        """Say whether the scheduler is."""
        return bool(self._client.status != "running")

    def free_workers(self) -> list[str]:
        """Return the workers of our code that have no cell; none for long is said."""
        now = time.monotonic()
        if now - self._counted >= SECONDS_BETWEEN_COUNTS:
            self._counted = now
            with suppress(OSError):
                self._alive = set(self._client.nthreads())
            self._meet_new_ones()
            self._say_if_alone(now)
        busy = {given.worker for given in self._given.values()}
        return sorted(self._trusted & self._alive - busy)

    def submit(self, work: Work, task: CellTask, worker: str) -> None:
        """Give a cell to a worker."""
        future = self._client.submit(
            compute_on_worker, work, workers=[worker], allow_other_workers=False, pure=False
        )
        self._given[future] = _Given(worker, task)
        self._done.add(future)

    def ended(self) -> Iterator[tuple[CellTask, CellResult | Crash | Lost]]:
        """Yield a cell and what became of it, for each that has ended."""
        if not self._done.has_ready():
            time.sleep(SECONDS_BETWEEN_LOOKS)
        else:
            for future in self._done.next_batch(block=False):
                given = self._given.pop(future, None)
                if given is not None:
                    yield given.task, _outcome(future)
                    future.release()
        for future, given in list(self._given.items()):
            if given.worker not in self._alive and not future.done():
                del self._given[future]
                future.cancel()
                yield given.task, Lost()

    def _meet_new_ones(self) -> None:
        """Ask every new worker what it is; those that answered as we would are trusted."""
        for worker in self._alive - self._asked.keys():
            self._asked[worker] = self._client.submit(
                about_worker, workers=[worker], allow_other_workers=False, pure=False
            )
        for worker in sorted(self._alive - self._judged):
            if self._asked[worker].done():
                self._judged.add(worker)
                if why := self._why_not(worker, self._asked[worker]):
                    say(f"--dask {self._words}: worker {worker} is given no cells: {why}")
                else:
                    self._trusted.add(worker)

    def _why_not(self, worker: str, answer: Future) -> str:
        """Return why a worker cannot be trusted; "" where it can, and is a machine of this run."""
        if answer.status != "finished":
            return f"it cannot run stiffbench ({answer.exception()})"
        machine, code = answer.result()
        if code != shared_code():
            return "it has another version of stiffbench or of a library"
        self._machines[worker] = machine
        return ""

    def _say_if_alone(self, now: float) -> None:
        if self._trusted & self._alive:
            self._last_seen = now
        elif now - self._last_seen > SECONDS_UNTIL_SAID:
            self._last_seen = now
            say(f"--dask {self._words}: there is no worker; waiting for one")


def _outcome(future: Future) -> CellResult | Crash | Lost:
    if future.status == "finished":
        with suppress(OSError, TimeoutError):  # the worker that holds it may have gone
            found: CellResult | Crash | None = future.result(timeout=SECONDS_TO_CONNECT)
            return Lost() if found is None else found
    if future.status != "error":
        return Lost()
    error = future.exception()
    return Crash(type(error).__name__, f"its worker could not run it: {error}")


def shared_code() -> str:
    """Return the hash of the code that every cell runs."""
    return code_of(model_info(REFERENCE_MODEL).load(), files=SCORING)


def about_worker() -> tuple[dict[str, str], str]:
    """Return a worker's environment, and the hash of its code."""
    return environment(), shared_code()


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
