"""A plugin file with one good model and models that each misbehave in one way."""

from __future__ import annotations

import ctypes
import gc
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import psutil

from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.types import Samples


class Good:
    """Predicts the mean deflection after a delay."""

    def __init__(self, *, seconds: float = 0.0):
        self.seconds = seconds

    def get_params(self, deep=True):
        return {"seconds": self.seconds}

    def fit(self, train, *, robot, validation=None, seed=0):
        time.sleep(self.seconds)
        self.mean_ = train.deflection.mean(axis=0)
        return self

    def predict(self, q, wrench):
        return np.repeat(self.mean_[None], len(q), axis=0)


class Reports(Good):
    """Reports its progress, and prints without Python's streams."""

    def fit(self, train, **options):
        report("thinking", 3, 7)
        os.write(1, b"past Python")
        time.sleep(0.5)
        return super().fit(train, **options)


class Raises(Good):
    def fit(self, train, **_):
        print("about to raise")
        raise RuntimeError("no licence")


class KillsTheServer(Good):
    """Ends the process that starts all fits, while others compute."""

    def fit(self, train, **_):
        time.sleep(0.3)
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(60)


class KillsTheGroup(Good):
    def fit(self, train, **_):
        os.killpg(os.getpgid(os.getppid()), signal.SIGKILL)
        time.sleep(60)


class Hangs(Good):
    def fit(self, train, **_):
        print("going to sleep", flush=True)
        time.sleep(1e6)


class Eats(Good):
    def fit(self, train, **_):
        arrays = []
        while True:
            arrays.append(np.ones(2**20))


class FeedsChildren(Good):
    """Starts a process that takes the memory."""

    def fit(self, train, **_):
        if os.fork() == 0:
            Eats().fit(train)
        time.sleep(1e6)


class Talks(Good):
    """Prints without end."""

    def fit(self, train, **_):
        while True:
            print("words " * 100)


class Quits(Good):
    def fit(self, train, **_):
        raise SystemExit("enough")


def with_method(name, **method):
    return type(name, (Good,), method)


Segfaults = with_method("Segfaults", fit=lambda *_, **__: ctypes.string_at(0))
Exits = with_method("Exits", fit=lambda *_, **__: os._exit(3))
KillsItself = with_method("KillsItself", fit=lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL))
TellsLies = with_method("TellsLies", predict=lambda self, q, wrench: "rubbish")


class LeavesAChild(Good):
    def fit(self, train, **options):
        if os.fork() == 0:
            time.sleep(1e6)
        return super().fit(train, **options)


class DetachesAChild(Good):
    """Starts a process in its own session, as daemons do."""

    def fit(self, train, **options):
        subprocess.Popen(["sleep", "1000"], start_new_session=True)
        return super().fit(train, **options)


class HoldsTheInterpreter(Good):
    """Starts a process, then computes without releasing the interpreter lock."""

    def fit(self, train, **_):
        subprocess.Popen(["sleep", "1000"])
        re.match(r"(a+)+$", "a" * 60 + "b")


class KillsWorkers(Good):
    """Kills the process that its server belongs to: the worker of a cluster."""

    def fit(self, train, **_):
        psutil.Process(os.getppid()).parent().kill()
        time.sleep(1e6)


class StealsTest(Good):
    """Searches the stack and all objects for the deflections of its test samples."""

    def predict(self, q, wrench):
        frame = sys._getframe()
        while frame is not None:
            held = [*frame.f_locals.values()]
            held += [getattr(getattr(value, "data", None), "samples", None) for value in held]
            for candidate in held:
                if (answer := self.answers(candidate, q, wrench)) is not None:
                    return answer
            frame = frame.f_back
        for candidate in gc.get_objects():
            if (answer := self.answers(candidate, q, wrench)) is not None:
                return answer
        return super().predict(q, wrench)

    def answers(self, samples, q, wrench):
        """Return the measured deflections if samples hold all these poses and loads."""
        if not isinstance(samples, Samples) or samples.q.shape[1:] != q.shape[1:]:
            return None
        rows = zip(samples.q.tolist(), samples.wrench.tolist(), strict=True)
        row_of = {(*pose, *load): row for row, (pose, load) in enumerate(rows)}
        requested_rows = zip(q.tolist(), wrench.tolist(), strict=True)
        rows = [row_of.get((*pose, *load)) for pose, load in requested_rows]
        return None if None in rows else samples.deflection[rows].copy()


_OK = ("ok", "", "")
_TIMED_OUT = ("failed", "timed out", "took longer than --timeout ")
_OUT_OF_MEMORY = ("failed", "out of memory", "more than --memory ")
ROWS = {
    "Good": _OK,
    "Raises": ("failed", "RuntimeError", "RuntimeError: no licence (/"),
    **dict.fromkeys(("Hangs", "HoldsTheInterpreter", "Talks"), _TIMED_OUT),
    **dict.fromkeys(("Eats", "FeedsChildren"), _OUT_OF_MEMORY),
    "Segfaults": ("failed", "SIGSEGV", "its process was ended by SIGSEGV after"),
    "Exits": ("failed", "exit status 3", "without a result (exit status 3)"),
    "Quits": ("failed", "SystemExit", "SystemExit: enough"),
    "KillsItself": ("failed", "SIGKILL", "ended by SIGKILL after"),
    "TellsLies": ("failed", "ModelError", "predict returned <U7 values, expected (31, 3)"),
    **dict.fromkeys(("LeavesAChild", "DetachesAChild", "vjm"), _OK),
}
"""Model -> status, cause and reason of its row, with limits of time and memory."""


def assert_rows(results, keys):
    """Check that each model's row has its status, its reason and its last output."""
    for key in keys:
        result, (status, cause, reason) = results[key], ROWS[key]
        assert (result.status, result.cause) == (status, cause), (key, result.failure)
        assert reason in result.failure
    assert results["Raises"].log == ("about to raise",)
    assert results["Hangs"].log[0] == "going to sleep" and results["Good"].log == ()
    for key, words in (("Hangs", "in fit"), ("Segfaults", "string_at")):
        for text in (words, os.path.basename(__file__)):
            assert any(text in line for line in results[key].log), (key, text)
    assert not any("multiprocessing" in line for result in results.values() for line in result.log)


def perfect(*_):
    return 0.0


class PatchesTheEngine(Good):
    """Replaces functions of the engine so that its errors are zero."""

    def fit(self, train, **options):
        for name, module in list(sys.modules.items()):
            if name.startswith(("stiff_bench.", "stiff_protocols.")):
                for function in ("norm_errors", "check_prediction", "check_units"):
                    if hasattr(module, function):
                        setattr(module, function, perfect)
        return super().fit(train, **options)


MODELS = [
    ModelInfo(key=cls.__name__, target=cls, summary="misbehaves")
    for cls in list(vars().values())
    if isinstance(cls, type) and issubclass(cls, Good)
]
