"""Measures what a fitted model costs."""

from __future__ import annotations

import re
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from stiff_protocols.contract.stiffness_model import StiffnessModel
from stiff_protocols.contract.types import FloatArray


def peak_memory_bytes() -> int:
    """Return the largest resident memory of this process so far; 0 where it is not known."""
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max(MemoryMeter.highest, peak if sys.platform == "darwin" else peak * 1024)


class MemoryMeter:
    """Says how far the resident memory of this process rises; on Linux alone."""

    highest = 0
    """Peak before the kernel was last told to forget it, bytes."""

    def __init__(self) -> None:
        """Start anew: the kernel forgets the peak so far, which `peak_memory_bytes` remembers."""
        self._start: int | None = None
        MemoryMeter.highest = peak_memory_bytes()
        try:
            Path("/proc/self/clear_refs").write_text("5")  # proc(5): resets VmHWM
            self._start = _status("VmRSS")
        except OSError:
            pass

    def rise(self) -> int | None:
        """Return the peak since the start above the start, bytes; None where it is not known."""
        return None if self._start is None else max(0, _status("VmHWM") - self._start)


def _status(name: str) -> int:
    """Return an entry of /proc/self/status, bytes."""
    found = re.search(rf"^{name}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(found.group(1)) * 1024 if found else 0


MOST_SINGLE_PREDICTIONS = 21
ROWS_AT_ONCE = 1024
SECONDS = 0.1
"""A model that is slower than this is not asked again and again."""
SHORTEST = 1e-9  # a clock may stand still


def latency(model: StiffnessModel, q: FloatArray, wrench: FloatArray) -> float:
    """Return the median wall time [s] of predicting one row; `q` and `wrench` hold some rows."""
    times: list[float] = []
    rows = [slice(i, i + 1) for i in range(min(len(q), MOST_SINGLE_PREDICTIONS))]
    while len(times) < MOST_SINGLE_PREDICTIONS and sum(times) < SECONDS:
        row = rows[len(times) % len(rows)]
        times.append(_seconds(partial(model.predict, q[row], wrench[row])))
    return statistics.median(times)


def throughput(model: StiffnessModel, q: FloatArray, wrench: FloatArray, predict_s: float) -> float:
    """Return how many rows a second a large call predicts, larger and larger up to 1,024 rows.

    The (n, n_joints) and (n, 6) rows are repeated. Predicting them once took `predict_s`; a slow
    model is not asked for more.
    """
    seconds, times = predict_s, 1
    enough = -(-ROWS_AT_ONCE // len(q))
    while times < enough and seconds < SECONDS / 2:
        # twice the rows take at most about twice the time, so no call lasts much longer than that
        times = min(2 * times, enough)
        many = [np.tile(rows, (times, 1)) for rows in (q, wrench)]
        seconds = _seconds(partial(model.predict, *many))
    return times * len(q) / max(seconds, SHORTEST)


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return max(time.perf_counter() - start, SHORTEST)
