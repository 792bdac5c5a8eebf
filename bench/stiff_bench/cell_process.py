"""The inside of a cell's own process: it computes one cell, says so, and ends."""

from __future__ import annotations

import faulthandler
import os
import pickle
import sys
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from pathlib import Path

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
    """Compute a cell and send its result, after what it reports on the way.

    Everything that it prints, and so does what it starts, goes to `log`.
    """
    os.setsid()  # so that a limit ends the processes that the model started, too
    for descriptor in (1, 2):
        os.dup2(log.fileno(), descriptor)
    faulthandler.enable(all_threads=False)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(OSError):  # Linux: where memory runs out, this process goes before the others
        Path("/proc/self/oom_score_adj").write_text("1000")
    if work.limits.timeout_s is not None:
        faulthandler.dump_traceback_later(_LAST_WORDS * work.limits.timeout_s)
    results.send(_result(work, _throttled(results.send)))
    sys.stdout.flush()


def _result(work: Work, listener: Callable[[object], None]) -> object:
    from stiff_bench.cells import compute_cell, failed
    from stiff_bench.registry import import_plugin_file
    from stiff_bench.tasks import CellTask, code_of_model
    from stiff_bench.threads import pin_threads
    from stiff_protocols.progress import listening

    pin_threads(work.limits.threads)
    for path in work.plugins:
        import_plugin_file(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a cell's own are collected
        task: CellTask = pickle.loads(work.task)  # from our own process
        if not task.model.missing() and code_of_model(task.model) != task.cell.code_sha256:
            return failed(task, work.run_id, *OTHER_CODE)
        with listening(listener):
            return compute_cell(task, work.run_id)


OTHER_CODE = (
    "other code",
    "the model's code, stiffbench or a library it uses is not what it was when the run began, or "
    "not the same on the machine that ran this cell",
)
"""Cause and reason where a key would not be true."""


def _throttled(send: Callable[[object], None]) -> Callable[[object], None]:
    last = 0.0

    def report(progress: object) -> None:
        nonlocal last
        if time.monotonic() - last >= SECONDS_BETWEEN_REPORTS:
            last = time.monotonic()
            send(progress)

    return report


def _end_with_parent() -> None:
    """Wait until the process that asked for the cell is gone; nobody wants the result then."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
