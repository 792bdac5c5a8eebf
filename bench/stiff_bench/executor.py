"""Where the cells of a run are computed: in this process, or each in a process of its own."""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from itertools import islice
from typing import Protocol

from stiff_bench.cell_process import Limits
from stiff_bench.cells import compute_cell, failed
from stiff_bench.company import Company
from stiff_bench.crash import Crash
from stiff_bench.isolated import compute_isolated, work_of
from stiff_bench.progress import Display
from stiff_bench.tasks import CellTask
from stiff_protocols.errors import said_by
from stiff_protocols.record import CellResult


class Executor(Protocol):
    """Computes cells."""

    at_once: int
    """How many cells are computed side by side, as far as that is known."""

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends, in any order.

        A task is taken from `tasks` when its turn comes. Closing the generator ends what runs.
        """

    def machines(self) -> Mapping[str, Mapping[str, str]]:
        """Return the environments of other machines that took part, by their addresses."""

    def job_script(self) -> str:
        """Return the script of a job that would be submitted to a cluster; "" for none."""


class OnThisMachine:
    """What has no other machine."""

    def machines(self) -> Mapping[str, Mapping[str, str]]:
        """Return none."""
        return {}

    def job_script(self) -> str:
        """Return none."""
        return ""


class InProcess(OnThisMachine):
    """Computes one cell after another in this process."""

    at_once = 1

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield every cell's result, in order."""
        for task in tasks:
            display.start(task)
            yield result_of(task, run_id, compute_cell(task, run_id))


class LocalProcesses(OnThisMachine):
    """Computes every cell in a process of its own on this machine, some side by side.

    Args:
        jobs: how many at once.
        limits: of each.
    """

    def __init__(self, jobs: int, limits: Limits) -> None:
        """Store them."""
        self.at_once, self._limits = jobs, limits

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends."""
        waiting = iter(tasks)
        stopped = threading.Event()
        company = Company()
        running: dict[Future[CellResult | Crash | None], CellTask] = {}
        with ThreadPoolExecutor(self.at_once) as pool:  # a thread waits for each process

            def compute(task: CellTask) -> CellResult | Crash | None:
                with company.shared():
                    found = self._computed(task, run_id, display, stopped)
                if isinstance(found, Crash) and found.server_gone:
                    with company.alone():  # whoever killed it ends itself alone this time
                        found = self._computed(task, run_id, display, stopped)
                return found

            try:
                while True:
                    for task in islice(waiting, self.at_once - len(running)):
                        display.start(task)
                        running[pool.submit(compute, task)] = task
                    if not running:
                        return
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        task, found = running.pop(future), future.result()
                        if found is not None:
                            yield result_of(task, run_id, found)
            finally:
                stopped.set()

    def _computed(
        self, task: CellTask, run_id: str, display: Display, stopped: threading.Event
    ) -> CellResult | Crash | None:
        try:
            work = work_of(task, run_id, self._limits)
            return compute_isolated(work, heard=display.step, unwanted=stopped.is_set)
        except Exception as error:  # it could not be started: no reason to stop the others
            return Crash(
                type(error).__name__,
                f"no process could be started: {said_by(error)}",
                server_gone=isinstance(error, EOFError | OSError),
            )


def result_of(task: CellTask, run_id: str, found: CellResult | Crash) -> CellResult:
    """Return the row of a cell, whatever became of its process.

    What was computed is what was asked for, whatever a model made of it.
    """
    if isinstance(found, Crash):
        return failed(task, run_id, found.cause, found.reason, found.log)
    return replace(found, cell=task.cell, shown=task.shown, run_id=run_id, n_splits=task.n_splits)
