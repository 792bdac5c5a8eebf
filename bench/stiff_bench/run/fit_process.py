"""A fit in a process of its own: what happens there. `isolate.py` starts and watches it."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import pickle
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import orjson
import psutil

from stiff_bench.plan.cells import version_of
from stiff_bench.plan.registry import import_plugin_file, plugin_files
from stiff_bench.run.fit import FitOutcome, fit_and_predict, short
from stiff_bench.run.machine import pin_threads
from stiff_protocols.contract.errors import said_by
from stiff_protocols.contract.progress import Progress, listening

PID, LOG, PROGRESS, TEMPORARY = "pid", "log", "progress", "tmp"
"""Names in the folder of a fit: what its process says, and its folder for temporary files."""
SECONDS_BETWEEN_REPORTS = 0.2
TRACEBACK_AT_TIMEOUT_SHARE = 0.9
"""Share of the time limit after which a process prints where it is."""
SIGNAL_AT_END_OF_PARENT, ADOPT_ORPHANS = 1, 36  # prctl(2): PR_SET_PDEATHSIG, ..._CHILD_SUBREAPER
_WHY_OTHER_CODE = (
    "the model's version, its plugin's files or the library that it wraps are not what they were "
    "when the run began, or not the same on the machine that ran this fit"
)


@dataclass(frozen=True)
class Limits:
    """What the process of a fit may take.

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
    """A fit on its way to a process, perhaps on another machine.

    Attributes:
        task: the pickled line of the model and its `FitInput`, read in the fit's process after the
            plugins.
        model_version: version of the model when the run began.
        plugins: files to be imported first.
        imports: modules that the server of the processes imports once, when it starts: those that
            the run's process needed to make its models.
        limits: of the process.
    """

    task: bytes
    model_version: str
    plugins: tuple[Path, ...]
    imports: tuple[str, ...]
    limits: Limits


def compute_fit(work: Work, folder: Path) -> FitOutcome:
    """Compute a fit in this process, which ends afterwards, and end what the fit started.

    Args:
        work: the fit.
        folder: the fit's own, where the process says how far it is.
    """
    (folder / PID).write_text(str(os.getpid()))
    os.setsid()
    prctl(SIGNAL_AT_END_OF_PARENT, signal.SIGKILL)
    prctl(ADOPT_ORPHANS, 1)
    with suppress(OSError):  # Linux: where memory runs out, these processes go before the others
        Path("/proc/self/oom_score_adj").write_text("1000")
    log = os.open(folder / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for number in (1, 2):
        os.dup2(log, number)
    faulthandler.enable(all_threads=False)
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder / TEMPORARY)
    (folder / TEMPORARY).mkdir()
    if os.environ.get("OMP_NUM_THREADS") != str(work.limits.threads):  # else the server began so
        pin_threads(work.limits.threads)
    if work.limits.timeout_s is not None:
        faulthandler.dump_traceback_later(TRACEBACK_AT_TIMEOUT_SHARE * work.limits.timeout_s)
    try:
        return _outcome(work, folder)
    except BaseException as error:  # a model may raise what would stop a program
        return FitOutcome(failure=short(said_by(error)), cause=type(error).__name__)
    finally:
        faulthandler.cancel_dump_traceback_later()
        sys.stdout.flush()
        end_all_below()


def _outcome(work: Work, folder: Path) -> FitOutcome:
    """Return what becomes of the work."""
    for path in set(work.plugins).difference(plugin_files()):
        import_plugin_file(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a fit's own are collected
        model, given = pickle.loads(work.task)  # from the run's process
        if not model.missing() and version_of(model) != work.model_version:
            return FitOutcome(failure=_WHY_OTHER_CODE, cause="other code")
        validation = None if given.validation is None else replace(given.validation)
        given = replace(given, train=replace(given.train), validation=validation)  # read-only
        with listening(_reporter(folder / PROGRESS)):
            return fit_and_predict(model, given)


def _reporter(path: Path) -> Callable[[Progress], None]:
    """Return what writes reports into a file, not too often."""
    last = 0.0

    def report(progress: Progress) -> None:
        nonlocal last
        if time.monotonic() - last >= SECONDS_BETWEEN_REPORTS:
            last = time.monotonic()
            path.write_bytes(orjson.dumps(asdict(progress)))

    return report


def prctl(what: int, how: int) -> None:
    """Set an attribute of this process (prctl(2)), on Linux."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(what, how, 0, 0, 0)


def end_all_below() -> None:
    """Kill every process below this one, also those that are started meanwhile."""
    while below := psutil.Process().children(recursive=True):
        for process in below:
            with suppress(psutil.Error):
                process.kill()
        psutil.wait_procs(below, timeout=0.1)
