"""The two processes of an isolated fit: one computes, one watches over it.

The watching process never runs a model's code. All that the computing process starts stays below
it, in whatever session or group (Linux: it is their subreaper, prctl(2)), and is ended with it.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from multiprocessing import connection, forkserver, parent_process, reduction
from pathlib import Path
from typing import Any, NoReturn

import orjson
import psutil

from stiff_bench.plan.cells import version_of
from stiff_bench.plan.registry import import_plugin_file, plugin_files
from stiff_bench.run.fit import FitOutcome, FitTask, fit_and_predict, short
from stiff_bench.run.machine import pin_threads
from stiff_bench.run.outcome import outcome_text
from stiff_protocols.contract.errors import said_by
from stiff_protocols.contract.progress import Progress, listening

SECONDS_BETWEEN_REPORTS = 0.2
SECONDS_BETWEEN_LOOKS = 0.05
LAST_WORDS = 0.9
"""Part of the time limit after which a process prints where it is."""
BEGUN, DONE = b"b", b"d"
"""What a computing process says."""
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
    """A fit on its way to a process, perhaps on another machine.

    Attributes:
        task: the pickled `FitTask`; read in the computing process, since that may need the
            code of a plugin.
        model_version: that the model had when the run began.
        plugins: files to be imported first.
        imports: modules that the server of the processes imports once, when it starts: those that
            the run's process needed to make its models.
        limits: of the process.
        fresh: no other fit was or will be computed in the process.
        most_bytes: how long the text of its outcome can become.
    """

    task: bytes
    model_version: str
    plugins: tuple[Path, ...]
    imports: tuple[str, ...]
    limits: Limits
    fresh: bool
    most_bytes: int


class Descriptor:
    """A number of an open pipe that multiprocessing hands on to the process that it starts."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __reduce__(self) -> Any:
        return _handed_on, (type(self), reduction.DupFd(self.number))

    def close(self) -> None:
        """Close it."""
        os.close(self.number)


def _handed_on(kind: type[Descriptor], handed: Any) -> Descriptor:
    descriptor = object.__new__(kind)
    descriptor.number = handed.detach()
    return descriptor


class SharedFile(Descriptor):
    """A file without a name through which two processes speak.

    No model can delete it or put a pipe in its place, and nobody ever waits for it.
    """

    def __init__(self) -> None:
        """Make an empty one."""
        with tempfile.TemporaryFile() as made:
            super().__init__(os.dup(made.fileno()))

    @property
    def size(self) -> int:
        """Bytes that it holds."""
        return os.fstat(self.number).st_size

    def write(self, content: bytes) -> None:
        """Replace what it holds."""
        os.ftruncate(self.number, 0)
        done = 0
        while done < len(content):
            done += os.pwrite(self.number, content[done : done + 2**30], done)

    def read(self, most: int, start: int = 0) -> bytes:
        """Return what it holds from `start` on, at most `most` bytes."""
        parts = []
        while most > 0 and (part := os.pread(self.number, min(most, 2**24), start)):
            parts.append(part)
            start, most = start + len(part), most - len(part)
        return b"".join(parts)


@dataclass(frozen=True)
class Channels:
    """Files and pipes that the run's process and a computing one share.

    Attributes:
        work: a pickled `Work`.
        outcome: the text of what became of it.
        progress: the newest report, as JSON.
        log: what is printed.
        go: end of a pipe on which a byte asks for the work.
        answers: end of a pipe on which `BEGUN` and `DONE` come back.
    """

    work: SharedFile
    outcome: SharedFile
    progress: SharedFile
    log: SharedFile
    go: Descriptor
    answers: Descriptor


def watch_over_fits(channels: Channels, scratch: Path, threads: int) -> NoReturn:
    """Compute fits in a process below this one, and end as it does, with all that is below.

    It is ended by SIGTERM, and where the run's process ends. What is printed goes to the log, and
    temporary files into the folder `scratch`.
    """
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _stop)
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    with suppress(OSError):  # Linux: where memory runs out, these processes go before the others
        Path("/proc/self/oom_score_adj").write_text("1000")
    status = 0
    try:
        pid = os.fork()
        if pid == 0:
            _compute_fits(channels, scratch, threads)
        status = _status_of(pid)
    except _Stopped:
        pass
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        _end_all_below()
        shutil.rmtree(scratch, ignore_errors=True)
    if status < 0:
        with suppress(OSError):  # of SIGKILL there is no other
            signal.signal(-status, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.kill(os.getpid(), -status)
    os._exit(status)


class _Stopped(BaseException):
    """The run asked the process to end."""


def _stop(*_: object) -> NoReturn:
    raise _Stopped


def _prctl(what: int, how: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(what, how, 0, 0, 0)


def _status_of(pid: int) -> int:
    """Wait until a process below has ended; return its exit code, negative for a signal's number.

    Raises:
        _Stopped: the run's process has ended before.
    """
    parent = parent_process()
    assert parent is not None
    while True:
        ended, status = os.waitpid(-1, os.WNOHANG)  # orphans, too
        if ended == pid:
            return os.waitstatus_to_exitcode(status)
        if not ended and connection.wait([parent.sentinel], SECONDS_BETWEEN_LOOKS):
            raise _Stopped


def _end_all_below() -> None:
    """Kill every process below this one, also those that are started meanwhile."""
    while True:
        for process in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                process.kill()
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:  # there is none
            return
        time.sleep(0.002)


def _compute_fits(channels: Channels, scratch: Path, threads: int) -> NoReturn:
    """Compute a fit whenever the run's process asks for one."""
    status = 1
    try:
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number in (1, 2):
            os.dup2(channels.log.number, number)
        faulthandler.enable(all_threads=False)
        os.environ["TMPDIR"] = tempfile.tempdir = str(scratch)
        # else what a model starts by multiprocessing's server would be below that of all
        vars(forkserver)["_forkserver"].__init__()
        if os.environ.get("OMP_NUM_THREADS") != str(threads):  # else the server began with it
            pin_threads(threads)
        while os.read(channels.go.number, 1):
            os.write(channels.answers.number, BEGUN)
            channels.outcome.write(outcome_text(_outcome(channels)))
            sys.stdout.flush()
            os.write(channels.answers.number, DONE)
        status = 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
        sys.stderr.flush()
    finally:
        os._exit(status)


def _outcome(channels: Channels) -> FitOutcome:
    """Return what becomes of the work, whatever a model or a plugin's file raises."""
    try:
        work: Work = pickle.loads(channels.work.read(channels.work.size))  # from the run's process
        if work.limits.timeout_s is not None:
            faulthandler.dump_traceback_later(LAST_WORDS * work.limits.timeout_s)
        for path in set(work.plugins).difference(plugin_files()):
            import_plugin_file(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a fit's own are collected
            task: FitTask = pickle.loads(work.task)
            if not task.model.missing() and version_of(task.model) != work.model_version:
                return FitOutcome(failure=_WHY_OTHER_CODE, cause="other code")
            given = task.given
            validation = None if given.validation is None else replace(given.validation)
            given = replace(given, train=replace(given.train), validation=validation)  # read-only
            task = replace(task, given=given)
            with listening(_reporter(channels.progress)):
                return fit_and_predict(task)
    except BaseException as error:  # a model may raise what would stop a program
        return FitOutcome(failure=short(said_by(error)), cause=type(error).__name__)
    finally:
        faulthandler.cancel_dump_traceback_later()


def _reporter(file: SharedFile) -> Callable[[Progress], None]:
    """Return what writes reports into a file, not too often."""
    last = 0.0

    def report(progress: Progress) -> None:
        nonlocal last
        if time.monotonic() - last >= SECONDS_BETWEEN_REPORTS:
            last = time.monotonic()
            file.write(orjson.dumps(asdict(progress)))

    return report
