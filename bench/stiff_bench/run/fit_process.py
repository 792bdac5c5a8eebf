"""A fit in a process of its own: what happens there, and in the server that forks the processes.

`isolate.py` starts a fit and watches it.
"""

from __future__ import annotations

import atexit
import ctypes
import faulthandler
import os
import pickle
import shutil
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
from stiff_bench.run.machine import pinned
from stiff_protocols.contract.errors import said_by
from stiff_protocols.contract.progress import Progress, listening

SERVER = "multiprocessing.forkserver"
"""A word of the command line of the server, which has imported this module."""
PID, LOG, PROGRESS, TEMPORARY = "pid", "log", "progress", "tmp"
"""Names in the folder of a fit: what its process says, and its folder for temporary files."""
SECONDS_BETWEEN_REPORTS = 0.2
TRACEBACK_AT_TIMEOUT_SHARE = 0.9
"""Share of the time limit after which a process prints where it is."""
_SIGNAL_AT_END_OF_PARENT, _ADOPT_ORPHANS = 1, 36  # prctl(2): PR_SET_PDEATHSIG, CHILD_SUBREAPER
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
    _prctl(_SIGNAL_AT_END_OF_PARENT, signal.SIGKILL)
    _prctl(_ADOPT_ORPHANS, 1)
    with suppress(OSError):  # Linux: where memory runs out, these processes go before the others
        Path("/proc/self/oom_score_adj").write_text("1000")
    log = os.open(folder / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for number in (1, 2):
        os.dup2(log, number)
    faulthandler.enable(all_threads=False)
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder / TEMPORARY)
    (folder / TEMPORARY).mkdir()
    if os.environ.get("OMP_NUM_THREADS") != str(work.limits.threads):  # else the server began so
        pinned(work.limits.threads)
    if work.limits.timeout_s is not None:
        faulthandler.dump_traceback_later(TRACEBACK_AT_TIMEOUT_SHARE * work.limits.timeout_s)
    try:
        return _outcome(work, folder)
    except BaseException as error:  # a model may raise what would stop a program
        return FitOutcome(failure=short(said_by(error)), cause=type(error).__name__)
    finally:
        faulthandler.cancel_dump_traceback_later()
        sys.stdout.flush()
        _end_all_below()


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


def _prctl(what: int, how: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(what, how, 0, 0, 0)


def _end_all_below() -> None:
    """Kill every process below this one, also those that are started meanwhile."""
    while below := psutil.Process().children(recursive=True):
        for process in below:
            with suppress(psutil.Error):
                process.kill()
        psutil.wait_procs(below, timeout=0.1)


def folder_prefix(run: int) -> str:
    """Return how the names of the folders begin that the fits of a run's process have."""
    return f"bench-{run}-"


def _begin_server() -> None:
    """Have this process end with the run's, however that ended, with all that is below it (Linux).

    It adopts what fits leave behind.
    """
    server, run = os.getpid(), os.getppid()

    def end(*_: object) -> None:
        if os.getpid() != server:
            os._exit(1)  # forked a moment ago
        _end_all_below()
        for folder in Path(tempfile.gettempdir()).glob(f"{folder_prefix(run)}*"):
            shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)

    _prctl(_ADOPT_ORPHANS, 1)
    _prctl(_SIGNAL_AT_END_OF_PARENT, signal.SIGTERM)
    signal.signal(signal.SIGTERM, end)
    atexit.register(end)
    warnings.filterwarnings("ignore", "forkserver: waitpid returned unexpected pid")  # an orphan


if any(SERVER in word for word in sys.orig_argv):
    _begin_server()
