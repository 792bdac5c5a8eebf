"""Computes cells in other processes, whatever may become of those.

The processes are pebble's, forked from a server that has imported what they need and never runs a
model's code. A model of ours gets one that others had before it; a stranger's gets its own. A pool
holds one process, so that nothing that this one does can harm another.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Set
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from multiprocessing import connection
from pathlib import Path
from typing import Any

import orjson
import psutil
from pebble import CONSTS, ProcessExpired, ProcessPool

from stiff_bench.plan.cells import CellTask
from stiff_bench.plan.registry import plugin_files
from stiff_bench.run.cell import unfinished
from stiff_bench.run.cell_process import (
    LOG,
    PID,
    PROGRESS,
    Limits,
    Work,
    begin_process,
    computed_content,
)
from stiff_bench.run.execution import Execution
from stiff_bench.run.progress import Display
from stiff_bench.store.codec import Content, cell_result
from stiff_models.catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import DataError, said_by
from stiff_protocols.contract.progress import Progress
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import BenchmarkData

CONSTS.sleep_unit = 0.02
"""How often pebble looks whether a process has ended, s."""
SECONDS_BETWEEN_LOOKS = 0.1
SECONDS_TO_SAY = 1.0
"""How long pebble may take to say how a process ended; it never does where the status was 0."""
LONGEST_TEMPDIR = 70
"""Bytes: a socket's whole name has at most 107 (unix(7)), of which multiprocessing needs 33."""
LOG_LINES, LONGEST_LINE = 30, 500
LOG_END, LARGEST_LOG = 2**16, 2**24
"""Bytes of a log that are read, and how large it gets before the rest is thrown away."""
_NOISE = ("Extension modules:", "/multiprocessing/", "/pebble/", 'File "<string>"', "/stiff_bench/")
"""In lines of faulthandler that say nothing of the model: names of modules, our own beginning."""

TIMED_OUT, OUT_OF_MEMORY = "timed out", "out of memory"
_SERVER_GONE = 255
"""Exit code that multiprocessing gives where the server that forks the processes has ended."""


@dataclass(frozen=True)
class Crash:
    """A cell that ended without a result.

    Attributes:
        cause: in a word or two that count it: "SIGKILL", "exit status 3", "timed out".
        reason: the whole sentence.
        log: the last lines that it printed.
        innocent: perhaps another cell has killed the server of all processes.
    """

    cause: str
    reason: str
    log: tuple[str, ...] = ()
    innocent: bool = False


def work_of(task: CellTask, run_id: str, limits: Limits, *, fresh: bool) -> Work:
    """Return what is sent to the process that computes a cell."""
    model_info(REFERENCE_MODEL).load()
    known = list(sys.modules)  # another thread may import meanwhile
    ours = sorted(name for name in known if name.startswith("stiff_models."))
    without: Any = {"data": None, "source": None}
    data = {task.cell.data_sha256: task.data, task.cell.source_sha256: task.source}
    return Work(
        task=pickle.dumps(replace(task, **without)),
        data={sha: _pickled(one) for sha, one in data.items() if one is not None},
        plugins=plugin_files(),
        imports=(__name__, *(("torch",) if "torch" in known else ()), *ours),
        run_id=run_id,
        limits=limits,
        fresh=fresh,
    )


@lru_cache(maxsize=2)
def _pickled(data: BenchmarkData) -> bytes:
    """Return a data set as it is sent; the cells of one follow each other."""
    return pickle.dumps(data)


class CellProcess:
    """Where one cell at a time is computed."""

    def __init__(self, scratch: Path) -> None:
        """Start nothing yet; the processes' files will lie in a folder below `scratch`."""
        self.future: Future[tuple[Content, bool]] = Future()
        self._scratch, self._heard = scratch, b""
        self._start: float | None = None
        self._pool: ProcessPool | None = None
        self._known: Set[str] = frozenset()

    def begin(self, make: Callable[[], Work]) -> None:
        """Start the cell that is made, in the process of the last one where that may be."""
        self._start, self._looked = None, 0.0
        try:
            self._work = work = make()
            if self._pool is None or work.fresh:
                self._open(work)
            self._used = bool(self._known)
            data = {sha: b"" if sha in self._known else one for sha, one in work.data.items()}
            assert self._pool is not None
            self.future = self._pool.schedule(
                computed_content, [replace(work, data=data), self._folder]
            )
            self._known = work.data.keys()
        except Exception as error:  # no process could be started
            self.future = Future()
            self.future.set_exception(error)

    def _open(self, work: Work) -> None:
        _keep_socket_names_short()
        self.end()
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(list(work.imports))
        self._folder = Path(tempfile.mkdtemp(dir=self._scratch))
        arguments = (self._folder, work.limits.threads)
        self._pool = ProcessPool(1, initializer=begin_process, initargs=arguments, context=context)

    def outcome(
        self, heard: Callable[[Progress], None] = lambda _: None
    ) -> CellResult | Crash | None:
        """Return the result of the cell or how it ended, None while it runs and is `heard`."""
        found = self._finished() if self.future.done() else self._looked_at(heard)
        if isinstance(found, Crash) or (found is not None and self._work.fresh):
            self.end()
        return found

    def _finished(self) -> CellResult | Crash:
        try:
            content, left = self.future.result()
            if "result" not in content:
                return self._crash(**content, innocent=True)
            found = cell_result(content["result"])
        except ProcessExpired as error:
            return self._ended(error.exitcode)
        except (ValueError, KeyError, TypeError, AttributeError, DataError) as error:
            return self._crash("no result", f"its process sent no result: {said_by(error)}")
        except Exception as error:
            said = f"no process could be started: {said_by(error)}"
            return Crash(type(error).__name__, said, innocent=True)
        if found.status == "failed":
            found = replace(found, log=self._last_lines())
        if left:
            self.end()
        return found

    def _looked_at(self, heard: Callable[[Progress], None]) -> Crash | None:
        now = time.monotonic()
        if now - self._looked < SECONDS_BETWEEN_LOOKS or not self.future.running():
            return None
        self._looked = now
        self._start = self._start or now
        self._pass_on(heard)
        pid, limits = self._pid(), self._work.limits
        if pid is None:
            return None
        if not psutil.pid_exists(pid):
            wait([self.future], SECONDS_TO_SAY)
            return None if self.future.done() else self._ended(0)
        if limits.timeout_s is not None and now - self._start > limits.timeout_s:
            return self._crash(TIMED_OUT, f"took longer than --timeout {limits.timeout_s:g} s")
        if (self._folder / LOG).stat().st_size > LARGEST_LOG:
            os.truncate(self._folder / LOG, 0)
        if limits.memory_bytes is None or (taken := _resident(pid)) <= limits.memory_bytes:
            return None
        if self._used:  # earlier cells may have left something there
            self.end()
            self.begin(lambda: self._work)
            return None
        most = f"--memory {limits.memory_bytes / 2**20:.0f} MiB"
        return self._crash(OUT_OF_MEMORY, f"took {taken / 2**20:.0f} MiB, more than {most}")

    def _ended(self, exit_code: int) -> Crash:
        """Return what became of a process with this exit code (negative: a signal's number)."""
        seconds = time.monotonic() - (self._start or time.monotonic())
        if exit_code >= 0:
            cause = f"exit status {exit_code}"
            if exit_code == _SERVER_GONE:
                cause += ", or its server was killed"
            said = f"its process ended after {seconds:.1f} s without a result ({cause})"
            return self._crash(cause, said, innocent=exit_code == _SERVER_GONE)
        known = {one.value: one.name for one in signal.Signals}
        name = known.get(-exit_code, f"signal {-exit_code}")
        hint = ", as the system does where memory runs out" if name == "SIGKILL" else ""
        return self._crash(name, f"its process was ended by {name} after {seconds:.1f} s{hint}")

    def _crash(self, cause: str, reason: str, *, innocent: bool = False) -> Crash:
        return Crash(cause, reason, self._last_lines(), innocent)

    def _pass_on(self, heard: Callable[[Progress], None]) -> None:
        with suppress(OSError, ValueError, TypeError):  # none yet, or half written
            said = (self._folder / PROGRESS).read_bytes()
            if said != self._heard:
                heard(Progress(**orjson.loads(said)))
                self._heard = said

    def _last_lines(self) -> tuple[str, ...]:
        end = b""
        with suppress(OSError), (self._folder / LOG).open("rb") as log:
            log.seek(max(0, log.seek(0, os.SEEK_END) - LOG_END))
            end = log.read(LOG_END)
        lines = [line[:LONGEST_LINE].decode(errors="replace").rstrip() for line in end.split(b"\n")]
        telling = [line for line in lines if line and not any(noise in line for noise in _NOISE)]
        return tuple(telling[-LOG_LINES:])

    def _pid(self) -> int | None:
        with suppress(OSError, ValueError):
            return int((self._folder / PID).read_text())
        return None

    def kill(self) -> None:
        """Kill the process, if there is one, with all that it started."""
        if self._pool is not None:
            if (pid := self._pid()) is not None:
                _end_family(pid)
                (self._folder / PID).unlink()
            self._pool.stop()  # type: ignore[no-untyped-call]

    def end(self) -> None:
        """Kill them, and wait for it."""
        self.kill()
        if self._pool is not None:
            self._pool.join()
        self._pool, self._known = None, frozenset()


def _resident(pid: int) -> int:
    """Return the resident memory of a process and of those that it started, bytes."""
    total = 0
    for one in _family(pid):
        with suppress(psutil.Error):
            total += one.memory_info().rss
    return total


def _family(pid: int) -> list[psutil.Process]:
    """Return a process and those below it, of other sessions too; none where it is gone."""
    try:
        process = psutil.Process(pid)
        return [process, *process.children(recursive=True)]
    except psutil.Error:
        return []


def _end_family(pid: int) -> None:
    """Kill a process that leads a group, with the group and every process below it."""
    family = _family(pid)  # before they lose their parent
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


def compute_isolated(work: Work, wanted: Callable[[], bool]) -> CellResult | Crash | None:
    """Compute one cell in a process of its own; None where its result is no longer `wanted`."""
    with tempfile.TemporaryDirectory(prefix="bench-") as scratch:
        place = CellProcess(Path(scratch))
        try:
            place.begin(lambda: work)
            while wanted():
                wait([place.future], SECONDS_BETWEEN_LOOKS)
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
        running: dict[CellProcess, CellTask] = {}
        with tempfile.TemporaryDirectory(prefix="bench-") as scratch:
            places = [CellProcess(Path(scratch)) for _ in range(self.at_once)]
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
                        place.begin(partial(work_of, task, run_id, self.limits, fresh=fresh))
                    if not running:
                        return
                    futures = [place.future for place in running]
                    wait(futures, SECONDS_BETWEEN_LOOKS, return_when=FIRST_COMPLETED)
                    for place, task in list(running.items()):
                        if (found := place.outcome(display.step)) is None:
                            continue
                        del running[place]
                        key = task.cell.key
                        if isinstance(found, Crash) and found.innocent and key not in seen:
                            seen.add(key)
                            again.append(task)
                        else:
                            yield result_of(task, run_id, found)
            finally:
                for place in places:
                    place.kill()
                for place in places:
                    place.end()


def result_of(task: CellTask, run_id: str, found: CellResult | Crash) -> CellResult:
    """Return the row of a cell, whatever became of its process.

    What was computed is what was asked for, whatever a model made of it.
    """
    if isinstance(found, Crash):
        return unfinished(task, run_id, found.reason, found.cause, found.log)
    return replace(found, cell=task.cell, shown=task.shown, run_id=run_id, n_splits=task.n_splits)
