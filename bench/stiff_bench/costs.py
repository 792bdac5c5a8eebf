"""Measures what a fitted model costs."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

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
