"""What happens in the process of an isolated cell, which ends with its run and keeps a log."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import pickle
import signal
import sys
import threading
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from multiprocessing import connection, parent_process
from pathlib import Path

from stiff_bench.plan.cells import CellTask, version_of
from stiff_bench.plan.registry import import_plugin_file, plugin_files
from stiff_bench.run.cell import compute_cell, short, unfinished
from stiff_bench.run.machine import pin_threads
from stiff_bench.store.codec import Content, cell_content, json_text
from stiff_protocols.contract.errors import said_by
from stiff_protocols.contract.progress import Progress, listening
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import BenchmarkData

SECONDS_BETWEEN_REPORTS = 0.2
LAST_WORDS = 0.9
"""Part of the time limit after which a process prints where it is."""
PID, PROGRESS, LOG = "pid", "progress", "log"
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36  # prctl(2)
_WHY_OTHER_CODE = (
    "the model's version, its plugin's files or the library that it wraps are not what they were "
    "when the run began, or not the same on the machine that ran this fit"
)


@dataclass(frozen=True)
class Limits:
    """What a cell's process may take.

    Attributes:
        threads: of every library.
        timeout_s: wall time; None: any.
        memory_bytes: resident, of the process and those that it starts; None: any.
    """

    threads: int = 1
    timeout_s: float | None = None
    memory_bytes: int | None = None


@dataclass(frozen=True)
class Work:
    """A cell on its way to a process, perhaps on another machine.

    Attributes:
        task: the pickled CellTask without data; read in the cell's process alone, since that may
            need the code of a plugin.
        data: sha256 -> a pickled data set; empty where the process has it.
        plugins: files to be imported first.
        imports: modules that the server of the processes imports once, when it starts: those that
            the run's process needed to make its models.
        run_id: the run that it is for.
        limits: of the process.
        fresh: no other cell was or will be computed in the process.
    """

    task: bytes
    data: Mapping[str, bytes]
    plugins: tuple[Path, ...]
    imports: tuple[str, ...]
    run_id: str
    limits: Limits
    fresh: bool


def begin_process(folder: Path, threads: int) -> None:
    """Prepare a process: what it and all that it starts prints goes to a log."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _end_with_parent()
    log = os.open(folder / LOG, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    for descriptor in (1, 2):
        os.dup2(log, descriptor)
    os.close(log)
    faulthandler.enable(all_threads=False)
    with suppress(OSError):  # Linux: where memory runs out, this process goes before the others
        Path("/proc/self/oom_score_adj").write_text("1000")
    if os.environ.get("OMP_NUM_THREADS") != str(threads):  # else the server began with it
        pin_threads(threads)


def _end_with_parent() -> None:
    """Lead a group of processes of our own, and have it killed when the run's process ends.

    On Linux the kernel does it, whatever this process does: it sends a signal to the group when the
    pipe that the parent holds is closed (fcntl(2), F_SETOWN and F_SETSIG). Processes that are
    started below and detach themselves stay our descendants. Elsewhere a thread waits.
    """
    os.setsid()
    parent = parent_process()
    if parent is None:
        return
    if sys.platform == "linux":
        import fcntl

        for what, how in ((_PR_SET_CHILD_SUBREAPER, 1), (_PR_SET_PDEATHSIG, signal.SIGKILL)):
            ctypes.CDLL(None).prctl(what, how, 0, 0, 0)
        fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, -os.getpgrp())
        fcntl.fcntl(parent.sentinel, fcntl.F_SETSIG, signal.SIGKILL)
        flags = fcntl.fcntl(parent.sentinel, fcntl.F_GETFL)
        fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, flags | os.O_ASYNC)
        if connection.wait([parent.sentinel], 0):  # it was gone before
            os.killpg(0, signal.SIGKILL)
    else:

        def wait_and_end() -> None:
            parent.join()
            os.killpg(0, signal.SIGKILL)

        threading.Thread(target=wait_and_end, daemon=True).start()


def computed_content(work: Work, folder: Path) -> tuple[Content, bool]:
    """Return a cell's result as plain content, and whether processes that it started are left."""
    (folder / PID).write_text(str(os.getpid()))  # pebble may start another without a word
    os.truncate(folder / LOG, 0)
    if work.limits.timeout_s is not None:
        faulthandler.dump_traceback_later(LAST_WORDS * work.limits.timeout_s)
    try:
        content: Content = {"result": cell_content(_result(work, folder))}
    except BaseException as error:  # such as a plugin that cannot be imported here
        content = {"cause": type(error).__name__, "reason": short(said_by(error))}
    faulthandler.cancel_dump_traceback_later()
    sys.stdout.flush()
    try:
        left = os.waitpid(-1, os.WNOHANG) is not None
    except ChildProcessError:
        left = False
    return content, left


def _result(work: Work, folder: Path) -> CellResult:
    for path in set(work.plugins).difference(plugin_files()):
        import_plugin_file(path)
    found = {sha: pickle.loads(data) if data else _held[sha] for sha, data in work.data.items()}
    _held.clear()
    _held.update(found)
    last = 0.0

    def report(progress: Progress) -> None:
        nonlocal last
        if time.monotonic() - last >= SECONDS_BETWEEN_REPORTS:
            last = time.monotonic()
            with suppress(OSError):
                (folder / PROGRESS).write_text(json_text(asdict(progress)))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a cell's own are collected
        task: CellTask = pickle.loads(work.task)  # from our own process
        cell = task.cell
        task = replace(task, data=_held[cell.data_sha256], source=_held.get(cell.source_sha256))
        if not task.model.missing() and version_of(task.model) != cell.model_version:
            return unfinished(task, work.run_id, _WHY_OTHER_CODE, "other code")
        try:
            with listening(report):
                return compute_cell(task, work.run_id)
        except BaseException as error:  # a model may raise what would stop a program
            return unfinished(task, work.run_id, short(said_by(error)), type(error).__name__)


_held: dict[str, BenchmarkData] = {}
"""The data sets of the last cell of this process, by their sha256."""
