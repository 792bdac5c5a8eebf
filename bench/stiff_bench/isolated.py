"""Computes a cell in a process of its own, whatever may become of that.

The processes are forked from a server that has imported what they need, so that one costs
milliseconds; the server itself never runs a model's code.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import pickle
import shutil
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerProcess

import orjson
import psutil

from stiff_bench.cell_content import cell_result
from stiff_bench.cell_process import Limits, Work, compute
from stiff_bench.crash import Crash, ended, no_result, out_of_memory, timed_out
from stiff_bench.process_family import end_family
from stiff_bench.registry import plugin_files
from stiff_bench.tasks import CellTask
from stiff_protocols.errors import DataError
from stiff_protocols.progress import Progress
from stiff_protocols.record import CellResult

LONGEST_TEMPDIR = 70
"""Bytes."""
BYTES_A_READ = 2**16
READS_AT_THE_END = 16
"""As much as a pipe holds, even where the system was told to make it larger."""
LOG_LINES = 30
LONGEST_LINE = 500
"""Bytes that are kept of a line of the log."""
_NOISE = ("Extension modules:", "/multiprocessing/", 'File "<string>"', "/stiff_bench/cell")
"""In lines of faulthandler that say nothing of the model: names of modules, our own beginning."""
SECONDS_BETWEEN_LOOKS = 0.1
SECONDS_TO_LEAVE = 5.0
"""How long a process that sent its result may take to end."""


def work_of(task: CellTask, run_id: str, limits: Limits) -> Work:
    """Return what is sent to the process that will compute a cell."""
    return Work(
        task=pickle.dumps(task),
        plugins=plugin_files(),
        run_id=run_id,
        limits=limits,
        imports=_imports(),
    )


def _imports() -> tuple[str, ...]:
    """Return which modules a cell will need, as this process shows that has made its model."""
    known = list(sys.modules)  # another thread may import meanwhile
    ours = sorted(name for name in known if name.startswith("stiff_models."))
    return ("stiff_bench.cells", *(("torch",) if "torch" in known else ()), *ours)


def compute_isolated(
    work: Work,
    *,
    heard: Callable[[Progress], None] = lambda _: None,
    unwanted: Callable[[], bool] = lambda: False,
) -> CellResult | Crash | None:
    """Compute a cell in a process of its own and return its result, or how that process ended.

    Args:
        work: the cell.
        heard: is told what the cell reports.
        unwanted: is asked ten times a second whether the result is still wanted.

    Returns:
        None where the result became unwanted.
    """
    _keep_socket_names_short()
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(work.imports))
    result_end, results = context.Pipe(duplex=False)
    log_end, log = context.Pipe(duplex=False)
    process = context.Process(target=compute, args=(work, results, log))
    with result_end, log_end, _may_have_children():
        process.start()
        results.close()
        log.close()
        try:
            return _Watch(process, result_end, log_end, work.limits).outcome(heard, unwanted)
        finally:
            _end(process)


class _Watch:
    """Follows one process to its end."""

    def __init__(
        self, process: ForkServerProcess, results: Connection, log: Connection, limits: Limits
    ) -> None:
        self._process, self._results, self._log, self._limits = process, results, log, limits
        for end in (results, log):
            os.set_blocking(end.fileno(), False)
        self._received, self._closed = b"", False
        self._lines: deque[bytes] = deque([b""], maxlen=LOG_LINES + 1)
        self._start = self._looked = time.monotonic()

    def outcome(
        self, heard: Callable[[Progress], None], unwanted: Callable[[], bool]
    ) -> CellResult | Crash | None:
        ends: list[Connection | int] = [self._results, self._log, self._process.sentinel]
        while not unwanted():
            ready = wait(ends, SECONDS_BETWEEN_LOOKS)
            if self._log in ready and not self._read_log():
                ends.remove(self._log)  # all who could print have ended
            if self._results in ready:
                for line in self._lines_received():
                    if (found := self._understood(line, heard)) is not None:
                        return found
                if self._closed:
                    return self._without_result()
            elif self._process.sentinel in ready:  # and nothing more to receive
                return self._without_result()
            if (crash := self._over_a_limit()) is not None:
                return crash
        return None

    def _lines_received(self) -> list[bytes]:
        """Return the lines that are complete now."""
        try:
            part = os.read(self._results.fileno(), BYTES_A_READ)
        except BlockingIOError:
            return []
        self._closed = not part
        self._received += part
        if b"\n" not in part:
            return []
        *lines, self._received = self._received.split(b"\n")
        return lines

    def _understood(
        self, line: bytes, heard: Callable[[Progress], None]
    ) -> CellResult | Crash | None:
        """Pass on what the process reports; return its result, or that it sent what is none."""
        try:
            sent = orjson.loads(line)
            if "progress" in sent:
                heard(Progress(**sent["progress"]))
                return None
            result = cell_result(sent["result"])
        except (ValueError, KeyError, TypeError, AttributeError, DataError) as error:
            return no_result(f"{type(error).__name__}: {error}", self._last_lines())
        self._process.join(SECONDS_TO_LEAVE)
        self._drain_log()
        return replace(result, log=self._last_lines()) if result.status == "failed" else result

    def _without_result(self) -> Crash:
        seconds = time.monotonic() - self._start
        self._process.join(SECONDS_TO_LEAVE)
        self._drain_log()
        exit_code = self._process.exitcode
        if exit_code is None:
            return no_result("it closed the way to send one", self._last_lines())
        return ended(exit_code, seconds, self._last_lines())

    def _drain_log(self) -> None:
        for _ in range(READS_AT_THE_END):
            self._read_log()

    def _over_a_limit(self) -> Crash | None:
        limits, now = self._limits, time.monotonic()
        if now - self._looked < SECONDS_BETWEEN_LOOKS:  # a process that prints wakes us often
            return None
        self._looked = now
        if limits.timeout_s is not None and now - self._start > limits.timeout_s:
            return timed_out(limits.timeout_s, self._last_lines())
        if limits.memory_bytes is not None:
            taken = _resident(self._process.pid)
            if taken > limits.memory_bytes:
                return out_of_memory(limits.memory_bytes, taken, self._last_lines())
        return None

    def _read_log(self) -> bool:
        """Keep the last lines of some of what was printed; False where nothing more can come."""
        try:
            part = os.read(self._log.fileno(), BYTES_A_READ)
        except BlockingIOError:
            return True
        first, *more = part.split(b"\n")
        self._lines[-1] = (self._lines[-1] + first)[:LONGEST_LINE]
        self._lines.extend(line[:LONGEST_LINE] for line in more)
        return bool(part)

    def _last_lines(self) -> tuple[str, ...]:
        lines = [line.decode(errors="replace").rstrip() for line in self._lines]
        telling = [line for line in lines if line and not any(noise in line for noise in _NOISE)]
        return tuple(telling[-LOG_LINES:])


def _resident(pid: int | None) -> int:
    """Return the resident memory of a process and of those that it started, bytes."""
    total = 0
    with suppress(psutil.Error):
        process = psutil.Process(pid)
        for one in (process, *process.children(recursive=True)):
            with suppress(psutil.Error):
                total += one.memory_info().rss
    return total


def _end(process: ForkServerProcess) -> None:
    """End a process, if it runs, with those that it started."""
    if process.pid is not None:
        end_family(process.pid)
    process.kill()
    process.join()
    process.close()


def _keep_socket_names_short() -> None:
    """Have the server's socket in /tmp where TMPDIR is long, as batch systems make it.

    A socket's whole name has at most 107 bytes (unix(7)), of which multiprocessing needs 33.
    """
    config = multiprocessing.current_process()._config  # type: ignore[attr-defined]
    if "tempdir" not in config and len(os.fsencode(tempfile.gettempdir())) > LONGEST_TEMPDIR:
        config["tempdir"] = tempfile.mkdtemp(prefix="bench-", dir="/tmp")
        atexit.register(shutil.rmtree, config["tempdir"], ignore_errors=True)


@contextmanager
def _may_have_children() -> Iterator[None]:
    """Let a worker of Dask, which multiprocessing calls a daemon, start a process.

    A daemon's children would be left behind when it is killed; ours end by themselves.
    """
    config = multiprocessing.current_process()._config  # type: ignore[attr-defined]
    before = config.get("daemon", False)
    config["daemon"] = False
    try:
        yield
    finally:
        config["daemon"] = before
