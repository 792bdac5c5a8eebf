"""Computes fits in other processes, whatever may become of those.

The processes are forked from multiprocessing's server, which has imported what they need and never
runs a model's code. A built-in model gets one that others had before it; a plugin's gets its own.
What they send is text and bytes, never objects: reading those would run code of the sender's.
"""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Set
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import connection
from multiprocessing.context import ForkServerProcess
from pathlib import Path

import orjson
import psutil

from stiff_bench.plan.cells import CellTask
from stiff_bench.plan.registry import plugin_files
from stiff_bench.run.cell import fit_task, score
from stiff_bench.run.cell_process import (
    BEGUN,
    DONE,
    Channels,
    Descriptor,
    Limits,
    SharedFile,
    Work,
    watch_over_fits,
)
from stiff_bench.run.execution import Execution
from stiff_bench.run.fit import FitOutcome
from stiff_bench.run.outcome import most_bytes, read_outcome
from stiff_bench.run.progress import Display
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import DataError, said_by
from stiff_protocols.contract.progress import Progress
from stiff_protocols.contract.record import CellResult

SECONDS_BETWEEN_LOOKS = 0.1
SECONDS_TO_END = 5.0
"""How long a process may take to end all that is below it."""
LONGEST_TEMPDIR = 70
"""Bytes: a socket's whole name has at most 107 (unix(7)), of which multiprocessing needs 33."""
LOG_LINES, LONGEST_LINE = 30, 500
LOG_END, LARGEST_LOG, LARGEST_REPORT = 2**16, 2**24, 2**12
"""Bytes of a log that are read, how large it gets before the rest is thrown away, of a report."""
_NOISE = ("Extension modules:", "/multiprocessing/", 'File "<string>"', "/stiff_bench/")
"""In lines of faulthandler that say nothing of the model: names of modules, our own beginning."""

TIMED_OUT, OUT_OF_MEMORY, NO_OUTCOME = "timed out", "out of memory", "no outcome"
_SERVER_GONE = 255
"""Exit code that multiprocessing gives where the server that forks the processes has ended."""


def work_of(task: CellTask, limits: Limits, *, fresh: bool) -> Work:
    """Return what is sent to the process that computes the fit of a cell."""
    model_info(REFERENCE_MODEL).load()
    loaded = list(sys.modules)  # another thread may import meanwhile
    ours = sorted(name for name in loaded if name.startswith("stiff_models."))
    given = fit_task(task)
    return Work(
        task=pickle.dumps(given),
        model_version=task.cell.model_version,
        plugins=plugin_files(),
        imports=(__name__, *(("torch",) if "torch" in loaded else ()), *ours),
        limits=limits,
        fresh=fresh,
        most_bytes=most_bytes(given),
    )


class FitProcess:
    """A process that computes one fit at a time."""

    def __init__(self) -> None:
        """Start nothing yet."""
        self._process: ForkServerProcess | None = None
        self._outcome: FitOutcome | None = None

    def begin(self, make: Callable[[], Work]) -> None:
        """Start the fit that is made, in the process of the last one where that may be."""
        self._outcome = None
        try:
            self._work = make()
            self._start()
        except Exception as error:  # no process could be started
            reason = f"no process could be started: {said_by(error)}"
            self._outcome = FitOutcome(
                failure=reason, cause=type(error).__name__, can_be_retried=True
            )

    def _start(self) -> None:
        work, process = self._work, self._process
        if process is None or work.fresh or process.exitcode is not None:
            self._open()
        else:
            self._used = True
        files = self._channels
        for file in (files.outcome, files.progress, files.log):
            file.write(b"")
        files.work.write(pickle.dumps(work))
        self._begun, self._last_report = False, b""
        self._began = self._looked = time.monotonic()
        with suppress(BrokenPipeError):  # it has just ended, which is seen below
            os.write(self._go, b".")

    def _open(self) -> None:
        _keep_socket_names_short()
        self.end()
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(self._work.imports))
        self._used, self._listens = False, True
        self._scratch = Path(tempfile.mkdtemp(prefix="bench-"))
        (go, self._go), (self._answers, answers) = os.pipe(), os.pipe()
        os.set_blocking(self._answers, False)
        self._channels = Channels(
            work=SharedFile(),
            outcome=SharedFile(),
            progress=SharedFile(),
            log=SharedFile(),
            go=Descriptor(go),
            answers=Descriptor(answers),
        )
        log = self._channels.log.number
        fcntl.fcntl(log, fcntl.F_SETFL, fcntl.fcntl(log, fcntl.F_GETFL) | os.O_APPEND)
        arguments = (self._channels, self._scratch, self._work.limits.threads)
        self._process = context.Process(target=watch_over_fits, args=arguments)
        try:
            self._process.start()
        finally:
            self._channels.go.close()
            self._channels.answers.close()

    @property
    def signs(self) -> list[int]:
        """Descriptors that are readable as soon as there may be an outcome."""
        if self._outcome is not None or self._process is None:
            return []
        return [self._process.sentinel, *([self._answers] if self._listens else [])]

    def outcome(self, listener: Callable[[Progress], None] = lambda _: None) -> FitOutcome | None:
        """Return what became of the fit, None while it is computed, which `listener` is told of."""
        outcome = self._outcome or self._result(listener)
        if outcome is not None and (outcome.fitted is None or self._work.fresh):
            self.end()
        return outcome

    def _result(self, listener: Callable[[Progress], None]) -> FitOutcome | None:
        process = self._process
        assert process is not None
        exit_code = process.exitcode  # before what it said last
        if self._is_done():
            return self._read()
        if exit_code is not None:
            if self._used and not self._begun:  # it had ended before
                self.begin(lambda: self._work)
                return self._outcome
            return self._ended(exit_code)
        return self._looked_at(process, listener)

    def _is_done(self) -> bool:
        answer = b""
        with suppress(BlockingIOError):
            answer = os.read(self._answers, 2**10)
            self._listens = bool(answer)
        if BEGUN in answer:
            self._begun, self._began = True, time.monotonic()
        return DONE in answer

    def _read(self) -> FitOutcome:
        file, most = self._channels.outcome, self._work.most_bytes
        try:
            if file.size > most:
                raise DataError(f"its process sent {file.size} bytes, more than {most}")
            outcome = read_outcome(file.read(most))
        except DataError as error:
            return self._failed(NO_OUTCOME, str(error))
        return outcome if outcome.fitted else replace(outcome, log=self._last_lines())

    def _looked_at(
        self, process: ForkServerProcess, listener: Callable[[Progress], None]
    ) -> FitOutcome | None:
        now = time.monotonic()
        if now - self._looked < SECONDS_BETWEEN_LOOKS:
            return None
        self._looked = now
        self._pass_on(listener)
        limits, files = self._work.limits, self._channels
        if limits.timeout_s is not None and now - self._began > limits.timeout_s:
            return self._failed(TIMED_OUT, f"took longer than --timeout {limits.timeout_s:g} s")
        if files.log.size > LARGEST_LOG:
            files.log.write(b"")
        if limits.memory_bytes is None or process.pid is None:
            return None
        if (taken := _resident_below(process.pid)) <= limits.memory_bytes:
            return None
        if self._used:  # earlier fits may have left something there
            self.end()
            self.begin(lambda: self._work)
            return self._outcome
        most = f"--memory {limits.memory_bytes / 2**20:.0f} MiB"
        return self._failed(OUT_OF_MEMORY, f"took {taken / 2**20:.0f} MiB, more than {most}")

    def _ended(self, exit_code: int) -> FitOutcome:
        """Return what became of a process with this exit code (negative: a signal's number)."""
        seconds = time.monotonic() - self._began
        if exit_code >= 0:
            cause = f"exit status {exit_code}"
            if exit_code == _SERVER_GONE:
                cause += ", or its server was killed"
            reason = f"its process ended after {seconds:.1f} s without a result ({cause})"
            return self._failed(cause, reason, can_be_retried=exit_code == _SERVER_GONE)
        names = {number.value: number.name for number in signal.Signals}
        name = names.get(-exit_code, f"signal {-exit_code}")
        hint = ", as the system does where memory runs out" if name == "SIGKILL" else ""
        return self._failed(name, f"its process was ended by {name} after {seconds:.1f} s{hint}")

    def _failed(self, cause: str, reason: str, *, can_be_retried: bool = False) -> FitOutcome:
        log = self._last_lines()
        return FitOutcome(failure=reason, cause=cause, log=log, can_be_retried=can_be_retried)

    def _pass_on(self, listener: Callable[[Progress], None]) -> None:
        report = self._channels.progress.read(LARGEST_REPORT)
        if report != self._last_report:
            with suppress(ValueError, TypeError):  # half written
                listener(Progress(**orjson.loads(report)))
                self._last_report = report

    def _last_lines(self) -> tuple[str, ...]:
        log = self._channels.log
        end = log.read(LOG_END, max(0, log.size - LOG_END))
        lines = [line[:LONGEST_LINE].decode(errors="replace").rstrip() for line in end.split(b"\n")]
        telling = [line for line in lines if line and not any(noise in line for noise in _NOISE)]
        return tuple(telling[-LOG_LINES:])

    def kill(self) -> None:
        """Have the process end, if there is one, with all that it started."""
        if self._process is not None and self._process.pid is not None:
            with suppress(ProcessLookupError):
                if self._process.exitcode in (None, _SERVER_GONE):
                    os.kill(self._process.pid, signal.SIGTERM)

    def end(self) -> None:
        """Have it end, and wait for it."""
        self.kill()
        process, self._process = self._process, None
        if process is None:
            return
        if process.pid is not None:
            process.join(SECONDS_TO_END)
            if process.exitcode in (None, -signal.SIGKILL, _SERVER_GONE):
                with suppress(psutil.Error):  # the server, which knows when it ends, may be gone
                    psutil.Process(process.pid).wait(SECONDS_TO_END)
                _end_family(process.pid)
        files = self._channels
        for file in (files.work, files.outcome, files.progress, files.log):
            file.close()
        os.close(self._go)
        os.close(self._answers)
        shutil.rmtree(self._scratch, ignore_errors=True)


def _resident_below(pid: int) -> int:
    """Return the resident memory of all processes below one, bytes."""
    total = 0
    for process in _below(pid):
        with suppress(psutil.Error):
            total += process.memory_info().rss
    return total


def _below(pid: int) -> list[psutil.Process]:
    """Return the processes below one, of other sessions too; none where it is gone."""
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.Error:
        return []


def _end_family(pid: int) -> None:
    """Kill a process that leads a group, with the group and every process below it."""
    family = _below(pid)  # before they lose their parent
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)
    for process in family:
        with suppress(psutil.Error):
            process.kill()


def _keep_socket_names_short() -> None:
    """Have multiprocessing's sockets in /tmp where TMPDIR is long, as batch systems make it.

    It chooses a folder for them when the first one is made, and keeps to it.
    """
    if len(os.fsencode(tempfile.gettempdir())) > LONGEST_TEMPDIR:
        before, tempfile.tempdir = tempfile.tempdir, "/tmp"
        try:
            connection.Listener(family="AF_UNIX").close()
        finally:
            tempfile.tempdir = before


def compute_isolated(work: Work, is_wanted: Callable[[], bool]) -> FitOutcome | None:
    """Compute one fit in a process of its own; None once `is_wanted` denies it."""
    place = FitProcess()
    try:
        place.begin(lambda: work)
        while is_wanted():
            connection.wait(place.signs, SECONDS_BETWEEN_LOOKS)
            if (outcome := place.outcome()) is not None:
                return outcome
    finally:
        place.end()
    return None


@dataclass(eq=False, kw_only=True)
class LocalProcesses(Execution):
    """Computes cells in processes on this machine, some side by side.

    Attributes:
        limits: of each.
        strangers: keys of the models that are not ours, of which each cell gets a fresh process.
    """

    limits: Limits
    strangers: Set[str] = frozenset()

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends.

        A cell whose process ended with the server of all is computed again after all
        others, one at a time: a fit that killed the server then costs its own row.
        """
        waiting, again, seen = iter(tasks), deque[CellTask](), set[str]()
        running: dict[FitProcess, CellTask] = {}
        places = [FitProcess() for _ in range(self.at_once)]
        try:
            while True:
                for place in places:
                    if place in running:
                        continue
                    if (task := next(waiting, None)) is not None:
                        display.start(task)
                    elif again and not running:
                        task = again.popleft()
                    else:
                        break
                    running[place] = task
                    fresh = task.cell.model in self.strangers
                    place.begin(partial(work_of, task, self.limits, fresh=fresh))
                if not running:
                    return
                signs = [sign for place in running for sign in place.signs]
                connection.wait(signs, SECONDS_BETWEEN_LOOKS)
                for place, task in list(running.items()):
                    if (outcome := place.outcome(display.step)) is None:
                        continue
                    del running[place]
                    key = task.cell.key
                    if outcome.can_be_retried and key not in seen:
                        seen.add(key)
                        again.append(task)
                    else:
                        yield score(task, fit_task(task), run_id, outcome)
        finally:
            for place in places:
                place.kill()
            for place in places:
                place.end()
