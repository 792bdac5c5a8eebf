"""Computes fits in other processes, whatever may become of those.

The processes are forked from multiprocessing's server, which has imported what they need and never
runs a model's code. A model of ours gets one that others had before it; a stranger's gets its own.
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
from stiff_models.catalog import REFERENCE_MODEL, model_info
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
    known = list(sys.modules)  # another thread may import meanwhile
    ours = sorted(name for name in known if name.startswith("stiff_models."))
    given = fit_task(task)
    return Work(
        task=pickle.dumps(given),
        model_version=task.cell.model_version,
        plugins=plugin_files(),
        imports=(__name__, *(("torch",) if "torch" in known else ()), *ours),
        limits=limits,
        fresh=fresh,
        most_bytes=most_bytes(given),
    )


class FitProcess:
    """Where one fit at a time is computed."""

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
            said = f"no process could be started: {said_by(error)}"
            self._outcome = FitOutcome(failure=said, cause=type(error).__name__, innocent=True)

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
        self._begun, self._heard = False, b""
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
        (go, self._go), (self._said, said) = os.pipe(), os.pipe()
        os.set_blocking(self._said, False)
        self._channels = Channels(
            work=SharedFile(),
            outcome=SharedFile(),
            progress=SharedFile(),
            log=SharedFile(),
            go=Descriptor(go),
            said=Descriptor(said),
        )
        log = self._channels.log.number
        fcntl.fcntl(log, fcntl.F_SETFL, fcntl.fcntl(log, fcntl.F_GETFL) | os.O_APPEND)
        arguments = (self._channels, self._scratch, self._work.limits.threads)
        self._process = context.Process(target=watch_over_fits, args=arguments)
        try:
            self._process.start()
        finally:
            self._channels.go.close()
            self._channels.said.close()

    @property
    def signs(self) -> list[int]:
        """What is readable where there may be an outcome."""
        if self._outcome is not None or self._process is None:
            return []
        return [self._process.sentinel, *([self._said] if self._listens else [])]

    def outcome(self, heard: Callable[[Progress], None] = lambda _: None) -> FitOutcome | None:
        """Return what became of the fit, None while it is computed and is `heard`."""
        found = self._outcome or self._found(heard)
        if found is not None and (found.fitted is None or self._work.fresh):
            self.end()
        return found

    def _found(self, heard: Callable[[Progress], None]) -> FitOutcome | None:
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
        return self._looked_at(process, heard)

    def _is_done(self) -> bool:
        said = b""
        with suppress(BlockingIOError):
            said = os.read(self._said, 2**10)
            self._listens = bool(said)
        if BEGUN in said:
            self._begun, self._began = True, time.monotonic()
        return DONE in said

    def _read(self) -> FitOutcome:
        file, most = self._channels.outcome, self._work.most_bytes
        try:
            if file.size > most:
                raise DataError(f"its process sent {file.size} bytes, more than {most}")
            found = read_outcome(file.read(most))
        except DataError as error:
            return self._failed(NO_OUTCOME, str(error))
        return found if found.fitted is not None else replace(found, log=self._last_lines())

    def _looked_at(
        self, process: ForkServerProcess, heard: Callable[[Progress], None]
    ) -> FitOutcome | None:
        now = time.monotonic()
        if now - self._looked < SECONDS_BETWEEN_LOOKS:
            return None
        self._looked = now
        self._pass_on(heard)
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
            said = f"its process ended after {seconds:.1f} s without a result ({cause})"
            return self._failed(cause, said, innocent=exit_code == _SERVER_GONE)
        known = {one.value: one.name for one in signal.Signals}
        name = known.get(-exit_code, f"signal {-exit_code}")
        hint = ", as the system does where memory runs out" if name == "SIGKILL" else ""
        return self._failed(name, f"its process was ended by {name} after {seconds:.1f} s{hint}")

    def _failed(self, cause: str, reason: str, *, innocent: bool = False) -> FitOutcome:
        log = self._last_lines()
        return FitOutcome(failure=reason, cause=cause, log=log, innocent=innocent)

    def _pass_on(self, heard: Callable[[Progress], None]) -> None:
        said = self._channels.progress.read(LARGEST_REPORT)
        if said != self._heard:
            with suppress(ValueError, TypeError):  # half written
                heard(Progress(**orjson.loads(said)))
                self._heard = said

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
        os.close(self._said)
        shutil.rmtree(self._scratch, ignore_errors=True)


def _resident_below(pid: int) -> int:
    """Return the resident memory of all processes below one, bytes."""
    total = 0
    for one in _below(pid):
        with suppress(psutil.Error):
            total += one.memory_info().rss
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


def compute_isolated(work: Work, wanted: Callable[[], bool]) -> FitOutcome | None:
    """Compute one fit in a process of its own; None where its outcome is no longer `wanted`."""
    place = FitProcess()
    try:
        place.begin(lambda: work)
        while wanted():
            connection.wait(place.signs, SECONDS_BETWEEN_LOOKS)
            if (found := place.outcome()) is not None:
                return found
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

        A cell whose process ended with the server of all is computed again, alone, after the
        others: whoever killed the server does so to itself then.
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
                    if (found := place.outcome(display.step)) is None:
                        continue
                    del running[place]
                    key = task.cell.key
                    if found.innocent and key not in seen:
                        seen.add(key)
                        again.append(task)
                    else:
                        yield score(task, run_id, found)
        finally:
            for place in places:
                place.kill()
            for place in places:
                place.end()
