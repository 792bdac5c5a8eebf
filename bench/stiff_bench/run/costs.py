"""Measure the time and memory that a fitted model needs."""

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
    """Return the largest resident memory of this process so far; 0 if unknown."""
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max(MemoryMeter.highest, peak if sys.platform == "darwin" else peak * 1024)


class MemoryMeter:
    """Measure by how much the resident memory of this process rises (only on Linux)."""

    highest = 0
    """Peak before the kernel's counter was last reset, bytes."""

    def __init__(self) -> None:
        """Reset the kernel's peak; `peak_memory_bytes` keeps the highest so far."""
        self._start: int | None = None
        MemoryMeter.highest = peak_memory_bytes()
        try:
            Path("/proc/self/clear_refs").write_text("5")  # proc(5): resets VmHWM
            self._start = _status("VmRSS")
        except OSError:
            pass

    def rise(self) -> int | None:
        """Return the rise from the start to the peak since then, bytes; None if unknown."""
        return None if self._start is None else max(0, _status("VmHWM") - self._start)


def _status(name: str) -> int:
    """Return an entry of /proc/self/status, bytes."""
    entry = re.search(rf"^{name}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(entry.group(1)) * 1024 if entry else 0


MOST_SINGLE_PREDICTIONS = 21
ROWS_AT_ONCE = 1024
SECONDS = 0.1
"""A model that takes longer in total is not called again."""
SHORTEST = 1e-9  # a coarse clock may show no difference


def latency(model: StiffnessModel, q: FloatArray, wrench: FloatArray) -> float:
    """Return the median wall time [s] of predicting one row; `q` and `wrench` hold some rows."""
    times: list[float] = []
    rows = [slice(i, i + 1) for i in range(min(len(q), MOST_SINGLE_PREDICTIONS))]
    while len(times) < MOST_SINGLE_PREDICTIONS and sum(times) < SECONDS:
        row = rows[len(times) % len(rows)]
        times.append(_seconds(partial(model.predict, q[row], wrench[row])))
    return statistics.median(times)


def throughput(model: StiffnessModel, q: FloatArray, wrench: FloatArray, predict_s: float) -> float:
    """Return the rows per second of a large call; calls grow up to 1,024 rows.

    The (n, n_joints) and (n, 6) rows are repeated. Predicting them once took `predict_s`. A slow
    model is not called with more rows.
    """
    seconds, times = predict_s, 1
    enough = -(-ROWS_AT_ONCE // len(q))
    while times < enough and seconds < SECONDS / 2:
        # twice the rows take at most about twice the time, so no call takes much longer than that
        times = min(2 * times, enough)
        many = [np.tile(rows, (times, 1)) for rows in (q, wrench)]
        seconds = _seconds(partial(model.predict, *many))
    return times * len(q) / max(seconds, SHORTEST)


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return max(time.perf_counter() - start, SHORTEST)
