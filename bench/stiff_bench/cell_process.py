"""The inside of a cell's own process: it computes one cell, says so, and ends."""

from __future__ import annotations

import faulthandler
import os
import pickle
import sys
import threading
import time
import warnings
from contextlib import suppress
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from stiff_bench.cell_content import cell_content, json_text
from stiff_bench.process_family import end_descendants, end_with_parent
from stiff_protocols.errors import said_by
from stiff_protocols.progress import Progress, listening
from stiff_protocols.record import CellResult

SECONDS_BETWEEN_REPORTS = 0.2
_LAST_WORDS = 0.9
"""Part of the time limit after which a process prints where it is."""


@dataclass(frozen=True)
class Limits:
    """What a cell's own process may take.

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
        task: the pickled CellTask; read in the cell's own process alone, since that may need the
            code of a plugin.
        plugins: files to be imported first.
        run_id: the run that it is for.
        limits: of the process.
        imports: modules that the server of the processes imports once, when the first one starts.
    """

    task: bytes
    plugins: tuple[Path, ...]
    run_id: str
    limits: Limits
    imports: tuple[str, ...]


def compute(work: Work, results: Connection, log: Connection) -> None:
    """Compute a cell and send its result, after what it reports on the way: a line of JSON each.

    Everything that it prints, and so does what it starts, goes to `log`.
    """
    end_with_parent()
    for descriptor in (1, 2):
        os.dup2(log.fileno(), descriptor)
    faulthandler.enable(all_threads=False)
    with suppress(OSError):  # Linux: where memory runs out, this process goes before the others
        Path("/proc/self/oom_score_adj").write_text("1000")
    if work.limits.timeout_s is not None:
        faulthandler.dump_traceback_later(_LAST_WORDS * work.limits.timeout_s)
    sender = _Sender(results.fileno())
    sender.send({"result": cell_content(_result(work, sender))})
    sys.stdout.flush()
    end_descendants(os.getpid())


def _result(work: Work, sender: _Sender) -> CellResult:
    from stiff_bench.cells import compute_cell, failed, short
    from stiff_bench.registry import import_plugin_file
    from stiff_bench.tasks import CellTask, version_of
    from stiff_bench.threads import pin_threads

    pin_threads(work.limits.threads)
    for path in work.plugins:
        import_plugin_file(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a cell's own are collected
        task: CellTask = pickle.loads(work.task)  # from our own process
        if not task.model.missing() and version_of(task.model) != task.cell.model_version:
            return failed(task, work.run_id, OTHER_CODE, _WHY_OTHER_CODE)
        try:
            with listening(sender.report):
                return compute_cell(task, work.run_id)
        except BaseException as error:  # a model may raise what would stop a program
            return failed(task, work.run_id, type(error).__name__, short(said_by(error)))


OTHER_CODE = "other code"
"""Cause where a key would not be true."""
_WHY_OTHER_CODE = (
    "the model's code, stiffbench or a library it uses is not what it was when the run began, or "
    "not the same on the machine that ran this cell"
)


class _Sender:
    """Writes lines of JSON to the process that waits for the result.

    Args:
        descriptor: of the pipe.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._lock, self._last = descriptor, threading.Lock(), 0.0

    def send(self, content: dict[str, Any]) -> None:
        line = memoryview(json_text(content).encode() + b"\n")
        with self._lock:  # a model may report from several threads
            while line:
                line = line[os.write(self._descriptor, line) :]

    def report(self, progress: Progress) -> None:
        """Send what a cell reports, not too often."""
        if time.monotonic() - self._last >= SECONDS_BETWEEN_REPORTS:
            self._last = time.monotonic()
            self.send({"progress": asdict(progress)})
