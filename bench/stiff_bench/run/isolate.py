"""Compute fits in separate processes, so that a crash costs only one fit.

pebble starts a process for each fit. It is forked from multiprocessing's server, which has imported
the modules that fits need and never runs a model's code. The process is ended with its children.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import orjson
import psutil
from pebble import ProcessExpired, ProcessFuture, concurrent

from stiff_bench.plan.fits import FitTask
from stiff_bench.plan.registry import plugin_files
from stiff_bench.run.execution import Execution, fit_input, score
from stiff_bench.run.fit import FitOutcome
from stiff_bench.run.fit_process import (
    LOG,
    PID,
    PROGRESS,
    SERVER,
    Limits,
    Work,
    bytes_beyond,
    compute_fit,
    family,
    folder_prefix,
    kill,
)
from stiff_bench.run.progress import Display
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import describe_error
from stiff_protocols.contract.evaluation import FitInput
from stiff_protocols.contract.progress import Progress
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.source_code import is_script_file

SECONDS_BETWEEN_LOOKS = 0.1
SERVER_ENDED = "server ended"
"""Cause of a fit whose server was killed, by this fit, by another one, or by the system."""
SECONDS_TO_HEAR = 5.0
"""Time that the result of an ended process may take to arrive."""
LOG_LINES, LONGEST_LINE = 30, 500
LARGEST_LOG = 2**22
"""Size of a log at which all of it is deleted, bytes."""
_NOISE = ("Extension modules:", "/multiprocessing/", 'File "<string>"', "/stiff_bench/", "/pebble/")
"""Parts of faulthandler's lines that do not concern the model."""
_OURS = ("stiff_models.", "stiff_protocols.")
_SERVER_GONE = (EOFError, ConnectionError)
"""Errors of a start whose server has ended a moment ago."""
_NOT_STARTED = (OSError, pickle.PicklingError, AttributeError, TypeError)
"""Errors of the system, and of what cannot be sent to a process."""
TIMED_OUT, OUT_OF_MEMORY, NO_OUTCOME = "timed out", "out of memory", "no outcome"
_WITHOUT_SERVER = (NO_OUTCOME, "SIGKILL", "exit status 255")
"""Causes of fits whose server has ended: they are killed, and nobody knows their status."""


def work_of(task: FitTask, given: FitInput, limits: Limits) -> Work:
    """Return the input for the process that computes a fit."""
    model_info(REFERENCE_MODEL).load()
    loaded = list(sys.modules)  # another thread may import meanwhile
    return Work(
        task=pickle.dumps((task.model, given)),
        model_version=task.fit.model_version,
        plugins=plugin_files(),
        imports=tuple(name for name in loaded if name == "torch" or name.startswith(_OURS)),
        limits=limits,
    )


class RunningFit:
    """Watch a fit in a separate process.

    Attributes:
        future: done when the process has ended, or has sent the outcome of the fit.
    """

    def __init__(self, work: Work) -> None:
        """Start the process.

        Raises:
            OSError: no further process can be started.
        """
        self._limits, self._began = work.limits, time.monotonic()
        self._folder = Path(tempfile.mkdtemp(prefix=folder_prefix(os.getpid())))
        self._family: set[psutil.Process] = set()
        self._too_much = 0
        self._report = b""
        main = vars(sys.modules["__main__"])
        if not is_script_file(main.get("__file__")):
            main.pop("__file__", None)  # "<stdin>": multiprocessing would run this file again
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["stiff_bench.run.fit_process", "pebble", *work.imports])
        start = concurrent.process(  # type: ignore[call-overload]  # pebble's type hints have mp_context
            daemon=False, timeout=work.limits.timeout_s, context=context
        )
        try:
            self.future: ProcessFuture[FitOutcome] = start(compute_fit)(work, self._folder)
            self._servers = _servers()
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        self._looked = self._there = (
            time.monotonic()
        )  # the first fit starts the server, which takes seconds

    def outcome(self, listener: Callable[[Progress], None] = lambda _: None) -> FitOutcome | None:
        """Return the outcome of the fit, and end it; None while it is computed.

        `listener` receives its progress.
        """
        if not self.future.done() and not self._is_lost(listener):
            return None
        outcome = self._ended()
        if outcome.cause in _WITHOUT_SERVER and not any(map(_runs, self._servers)):
            reason = f"{outcome.failure}; the server of the fits' processes had been killed"
            outcome = replace(outcome, failure=reason, cause=SERVER_ENDED)
        if outcome.fitted is None:
            outcome = replace(outcome, log=self._last_lines())
        self.end()
        return outcome

    def end(self) -> None:
        """Kill the process and its children, and delete its folder."""
        kill(self._family)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _is_lost(self, listener: Callable[[Progress], None]) -> bool:
        """Check the process; return whether it ended and no result will arrive."""
        now = time.monotonic()
        if now - self._looked < SECONDS_BETWEEN_LOOKS:
            return False
        self._looked = now
        with suppress(OSError, TypeError, ValueError):  # not yet written, or half written
            report = (self._folder / PROGRESS).read_bytes()
            if report != self._report:
                listener(Progress(**orjson.loads(report)))
                self._report = report
        with suppress(OSError):
            if (self._folder / LOG).stat().st_size > LARGEST_LOG:
                os.truncate(self._folder / LOG, 0)
        try:
            alive = family(int((self._folder / PID).read_text()))
        except (OSError, ValueError):
            return False  # it has not started
        if not alive:
            kill(self._family)  # a pipe stays open while a child of the process holds it
            return now - self._there > SECONDS_TO_HEAR
        self._there = now
        self._family.update(alive)
        self._too_much = bytes_beyond(self._limits, alive) or self._too_much
        return False

    def _ended(self) -> FitOutcome:
        """Return the outcome of a process that has ended."""
        limits, seconds = self._limits, time.monotonic() - self._began
        if self._too_much:
            limit = f"--memory {(limits.memory_bytes or 0) / 2**20:.0f} MiB"
            reason = f"took {self._too_much / 2**20:.0f} MiB, more than {limit}"
            return FitOutcome(failure=reason, cause=OUT_OF_MEMORY)
        if not self.future.done():
            reason = f"its process ended after {seconds:.1f} s without a result"
            return FitOutcome(failure=reason, cause=NO_OUTCOME)
        try:
            return self.future.result()
        except TimeoutError:
            reason = f"took longer than --timeout {limits.timeout_s:g} s"
            return FitOutcome(failure=reason, cause=TIMED_OUT)
        except ProcessExpired as error:
            return _expired(error.exitcode, seconds)
        except Exception as error:  # the result cannot be unpickled
            return FitOutcome(
                failure=f"no outcome of the fit: {describe_error(error)}", cause=NO_OUTCOME
            )

    def _last_lines(self) -> tuple[str, ...]:
        try:
            lines = (self._folder / LOG).read_text(errors="replace").splitlines()
        except OSError:
            return ()
        model_lines = [
            line for line in lines if line and not any(noise in line for noise in _NOISE)
        ]
        return tuple(line[:LONGEST_LINE].rstrip() for line in model_lines[-LOG_LINES:])


def _expired(exit_code: int, seconds: float) -> FitOutcome:
    """Return the outcome of a process with this exit code (negative: a signal's number)."""
    if exit_code >= 0:
        cause = f"exit status {exit_code}"
        reason = f"its process ended after {seconds:.1f} s without a result ({cause})"
        return FitOutcome(failure=reason, cause=cause)
    names = {number.value: number.name for number in signal.Signals}
    cause = names.get(-exit_code, f"signal {-exit_code}")
    hint = ", as the system does when memory runs out" if cause == "SIGKILL" else ""
    reason = f"its process was ended by {cause} after {seconds:.1f} s{hint}"
    return FitOutcome(failure=reason, cause=cause)


def end_all_fits() -> None:
    """Kill all children of the server that forks the fits' processes."""
    for server in _servers():
        with suppress(psutil.Error):
            kill(server.children(recursive=True))


def _servers() -> list[psutil.Process]:
    """Return the running servers of this process: one, or none."""
    servers = []
    for process in psutil.Process().children():
        with suppress(psutil.Error):
            if any(SERVER in word for word in process.cmdline()):
                servers.append(process)
    return servers


def _runs(process: psutil.Process) -> bool:
    """Check whether a process runs; one that has ended may still have an entry."""
    with suppress(psutil.Error):
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    return False


@dataclass(eq=False, kw_only=True)
class LocalProcesses(Execution):
    """Compute fits in processes on this machine, several in parallel.

    Attributes:
        limits: limits of each process.
    """

    limits: Limits

    def results(
        self, tasks: Iterable[FitTask], run_id: str, display: Display
    ) -> Generator[FitResult, None, None]:
        """Yield the result of every fit as it ends.

        A fit whose server ended is computed once more, without neighbours.
        """
        lost = list[FitTask]()
        try:
            yield from self._results(tasks, run_id, display, lost)
            yield from self._results(lost, run_id, display)
        finally:
            end_all_fits()

    def _results(
        self,
        tasks: Iterable[FitTask],
        run_id: str,
        display: Display,
        lost: list[FitTask] | None = None,
    ) -> Generator[FitResult, None, None]:
        """Yield the results; fits whose server ended are added to `lost` instead.

        Without `lost` it is the second time: one fit after another.
        """
        is_repetition = lost is None
        at_once = 1 if is_repetition else self.at_once
        waiting = iter(tasks)
        running: dict[RunningFit, tuple[FitTask, FitInput]] = {}

        def ended(
            task: FitTask, given: FitInput, outcome: FitOutcome
        ) -> Generator[FitResult, None, None]:
            if lost is not None and outcome.cause == SERVER_ENDED:
                lost.append(task)
            else:
                yield score(task, given, run_id, outcome)

        try:
            while True:
                while len(running) < at_once and (task := next(waiting, None)) is not None:
                    if not is_repetition:
                        display.start(task)
                    given = fit_input(task)
                    try:
                        running[RunningFit(work_of(task, given, self.limits))] = task, given
                    except _SERVER_GONE as error:
                        reason = f"its server ended: {describe_error(error)}"
                        yield from ended(
                            task, given, FitOutcome(failure=reason, cause=SERVER_ENDED)
                        )
                    except _NOT_STARTED as error:
                        reason = f"no process could be started: {describe_error(error)}"
                        outcome = FitOutcome(failure=reason, cause=type(error).__name__)
                        yield from ended(task, given, outcome)
                if not running:
                    return
                futures = [fit.future for fit in running]
                wait(futures, SECONDS_BETWEEN_LOOKS, return_when=FIRST_COMPLETED)
                for fit, (task, given) in list(running.items()):
                    if (result := fit.outcome(display.step)) is not None:
                        del running[fit]
                        yield from ended(task, given, result)
        finally:
            for fit in running:
                fit.end()
