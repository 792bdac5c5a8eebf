"""Measures what a fitted model costs."""

from __future__ import annotations

import re
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from stiff_protocols.contract import StiffnessModel
from stiff_protocols.types import FloatArray

MOST_SINGLE_PREDICTIONS = 21
ROWS_AT_ONCE = 1024
SECONDS = 0.1
"""A model that is slower than this is not asked again and again."""


def latency(model: StiffnessModel, q: FloatArray, wrench: FloatArray) -> float:
    """Return the median wall time [s] of predicting one row; `q` and `wrench` hold some rows."""
    times: list[float] = []
    while len(times) < MOST_SINGLE_PREDICTIONS and sum(times) < SECONDS:
        row = slice(len(times) % len(q), len(times) % len(q) + 1)
        times.append(_seconds(lambda row=row: model.predict(q[row], wrench[row])))  # type: ignore[misc]
    return statistics.median(times)


def throughput(model: StiffnessModel, q: FloatArray, wrench: FloatArray, predict_s: float) -> float:
    """Return how many rows a second one large call predicts.

    Args:
        model: fitted.
        q: (n, n_joints) rows, which are repeated to make the call large.
        wrench: (n, 6).
        predict_s: what predicting these rows took; a slow model is not asked for more.
    """
    if predict_s >= SECONDS:
        return len(q) / predict_s
    times = -(-ROWS_AT_ONCE // len(q))
    many_q, many_wrench = np.tile(q, (times, 1)), np.tile(wrench, (times, 1))
    return len(many_q) / _seconds(lambda: model.predict(many_q, many_wrench))


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return max(time.perf_counter() - start, 1e-9)  # a clock may stand still


class MemoryMeter:
    """Says how far the resident memory of this process rises; on Linux alone."""

    def __init__(self) -> None:
        """Start anew: the kernel forgets the peak so far."""
        self._start: int | None = None
        try:
            Path("/proc/self/clear_refs").write_text("5")  # proc(5): resets VmHWM
            self._start = _status("VmRSS")
        except OSError:
            return

    def rise(self) -> int | None:
        """Return the peak since the start above the start, bytes; None where it is not known."""
        return None if self._start is None else max(0, _status("VmHWM") - self._start)


def _status(name: str) -> int:
    """Return an entry of /proc/self/status, bytes."""
    found = re.search(rf"^{name}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(found.group(1)) * 1024 if found else 0
