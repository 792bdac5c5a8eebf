"""Compute a fit in a separate process, which a server forks.

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
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import orjson
import psutil

from stiff_bench.plan.fits import version_of
from stiff_bench.plan.registry import import_plugin_file, plugin_files
from stiff_bench.run.fit import FitOutcome, fit_and_predict, short
from stiff_bench.run.machine import pinned
from stiff_protocols.contract.errors import describe_error
from stiff_protocols.contract.progress import Progress, listening

SERVER = "multiprocessing.forkserver"
"""A word in the command line of the server, which has imported this module."""
PID, LOG, PROGRESS, TEMPORARY = "pid", "log", "progress", "tmp"
"""Names in the folder of a fit: files that its process writes, and its temporary folder."""
SECONDS_BETWEEN_REPORTS = 0.2
TRACEBACK_AT_TIMEOUT_SHARE = 0.9
"""Share of the time limit after which a process prints its traceback."""
_SIGNAL_AT_END_OF_PARENT, _ADOPT_ORPHANS = 1, 36  # prctl(2): PR_SET_PDEATHSIG, CHILD_SUBREAPER
_OTHER_CODE_REASON = (
    "the model's version, the files of its plugin or the library that it wraps changed since the "
    "run began, or differ on the machine that ran this fit"
)


@dataclass(frozen=True)
class Limits:
    """Limits of the process of a fit.

    Attributes:
        threads: number of threads of every library.
        timeout_s: wall time; None: no limit.
        memory_bytes: resident memory of the process and of those that it starts; None: no limit.
    """

    threads: int = 1
    timeout_s: float | None = None
    memory_bytes: int | None = None


@dataclass(frozen=True)
class Work:
    """Input of a fit that is sent to a process, perhaps on another machine.

    Attributes:
        task: the pickled line of the model and its `FitInput`, read in the fit's process after the
            plugins.
        model_version: version of the model when the run began.
        plugins: files to be imported first.
        imports: modules that the server of the processes imports once, when it starts: the ones
            that the run's process needed to make its models.
        limits: limits of the process.
    """

    task: bytes
    model_version: str
    plugins: tuple[Path, ...]
    imports: tuple[str, ...]
    limits: Limits


def compute_fit(work: Work, folder: Path) -> FitOutcome:
    """Compute a fit in this process, and end the processes that the fit started.

    Args:
        work: the fit.
        folder: folder of the fit, to which the process writes its progress.
    """
    (folder / PID).write_text(str(os.getpid()))
    os.setsid()
    _prctl(_SIGNAL_AT_END_OF_PARENT, signal.SIGKILL)
    _prctl(_ADOPT_ORPHANS, 1)
    with suppress(OSError):  # Linux: if memory runs out, the system ends these processes first
        Path("/proc/self/oom_score_adj").write_text("1000")
    log = os.open(folder / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for number in (1, 2):
        os.dup2(log, number)
    faulthandler.enable(all_threads=False)
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder / TEMPORARY)
    (folder / TEMPORARY).mkdir()
    if os.environ.get("OMP_NUM_THREADS") != str(work.limits.threads):  # else the server has set it
        pinned(work.limits.threads)
    if work.limits.timeout_s is not None:
        faulthandler.dump_traceback_later(TRACEBACK_AT_TIMEOUT_SHARE * work.limits.timeout_s)
    try:
        return _outcome(work, folder)
    except BaseException as error:  # a model may raise SystemExit or KeyboardInterrupt
        return FitOutcome(failure=short(describe_error(error)), cause=type(error).__name__)
    finally:
        faulthandler.cancel_dump_traceback_later()
        sys.stdout.flush()
        _end_all_below()


def _outcome(work: Work, folder: Path) -> FitOutcome:
    """Return the outcome of the work."""
    for path in set(work.plugins).difference(plugin_files()):
        import_plugin_file(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the warnings of the fit are collected
        model, given = pickle.loads(work.task)  # from the run's process
        if not model.missing() and version_of(model) != work.model_version:
            return FitOutcome(failure=_OTHER_CODE_REASON, cause="other code")
        validation = None if given.validation is None else replace(given.validation)
        given = replace(given, train=replace(given.train), validation=validation)  # read-only
        with listening(_reporter(folder / PROGRESS)):
            return fit_and_predict(model, given)


def _reporter(path: Path) -> Callable[[Progress], None]:
    """Return a function that writes progress into a file, not too often."""
    last = 0.0

    def report(progress: Progress) -> None:
        nonlocal last
        if time.monotonic() - last >= SECONDS_BETWEEN_REPORTS:
            last = time.monotonic()
            path.write_bytes(orjson.dumps(asdict(progress)))

    return report


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _end_all_below() -> None:
    """Kill every child process, also children that are started meanwhile."""
    while children := psutil.Process().children(recursive=True):
        kill(children)
        psutil.wait_procs(children, timeout=0.1)


def kill(processes: Iterable[psutil.Process]) -> None:
    """Kill processes; some may have ended."""
    for process in processes:
        with suppress(psutil.Error):
            process.kill()


def family(pid: int) -> list[psutil.Process]:
    """Return a process with all that it started; none if it has ended."""
    with suppress(psutil.Error):
        process = psutil.Process(pid)
        return [process, *process.children(recursive=True)]
    return []


def bytes_beyond(limits: Limits, processes: Sequence[psutil.Process]) -> int:
    """Return the resident memory of processes if it is beyond its limit, and kill them; else 0."""
    taken = 0
    for process in processes if limits.memory_bytes is not None else ():
        with suppress(psutil.Error):  # it has ended
            taken += int(process.memory_info().rss)
    if taken <= (limits.memory_bytes or 0):
        return 0
    kill(processes)
    return taken


def folder_prefix(run: int) -> str:
    """Return the prefix of the folder names of the fits of a run."""
    return f"bench-{run}-"


def _set_up_server() -> None:
    """End this process and its children when the process of the run ends (Linux).

    It adopts processes that fits leave behind.
    """
    server, run = os.getpid(), os.getppid()

    def end(*_: object) -> None:
        if os.getpid() != server:
            os._exit(1)  # forked a moment ago
        _end_all_below()
        for folder in Path(tempfile.gettempdir()).glob(f"{folder_prefix(run)}*"):
            shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)

    os.setpgid(0, 0)  # a model that kills its parent's process group leaves the run alive
    _prctl(_ADOPT_ORPHANS, 1)
    _prctl(_SIGNAL_AT_END_OF_PARENT, signal.SIGTERM)
    signal.signal(signal.SIGTERM, end)
    atexit.register(end)
    warnings.filterwarnings(
        "ignore", "forkserver: waitpid returned unexpected pid"
    )  # from an adopted process


if any(SERVER in word for word in sys.orig_argv):
    _set_up_server()
