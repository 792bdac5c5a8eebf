"""Measures what a fitted model costs."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from stiff_protocols.contract import PredictsOne, StiffnessModel
from stiff_protocols.types import FloatArray

MOST_SINGLE_PREDICTIONS = 21
ROWS_AT_ONCE = 1024
SECONDS = 0.1
"""A model that is slower than this is not asked again and again."""
SHORTEST = 1e-9  # a clock may stand still


def latency(model: StiffnessModel, q: FloatArray, wrench: FloatArray) -> float:
    """Return the median wall time [s] of predicting one row; `q` and `wrench` hold some rows.

    A model that predicts one sample on plain numbers is asked that way.
    """
    times: list[float] = []
    some = slice(MOST_SINGLE_PREDICTIONS)
    calls = _single_predictions(model, q[some], wrench[some])
    while len(times) < MOST_SINGLE_PREDICTIONS and sum(times) < SECONDS:
        times.append(_seconds(calls[len(times) % len(calls)]))
    return statistics.median(times)


def throughput(model: StiffnessModel, q: FloatArray, wrench: FloatArray, predict_s: float) -> float:
    """Return how many rows a second a large call predicts, larger and larger up to 1,024 rows.

    Args:
        model: fitted.
        q: (n, n_joints) rows, which are repeated to make the call large.
        wrench: (n, 6).
        predict_s: what predicting these rows took; a slow model is not asked for more.
    """
    seconds, times = predict_s, 1
    enough = -(-ROWS_AT_ONCE // len(q))
    while times < enough and seconds < SECONDS / 2:
        # twice the rows take at most about twice the time, so no call lasts much longer than that
        times = min(2 * times, enough)
        many_q, many_wrench = np.tile(q, (times, 1)), np.tile(wrench, (times, 1))
        seconds = _seconds(lambda many=(many_q, many_wrench): model.predict(*many))  # type: ignore[misc]
    return times * len(q) / max(seconds, SHORTEST)


def _single_predictions(
    model: StiffnessModel, q: FloatArray, wrench: FloatArray
) -> list[Callable[[], object]]:
    """Return a prediction of each row as a call."""
    if isinstance(model, PredictsOne):
        rows = zip(q.tolist(), wrench.tolist(), strict=True)
        return [partial(model.predict_one, *row) for row in rows]
    return [partial(model.predict, q[i : i + 1], wrench[i : i + 1]) for i in range(len(q))]


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return max(time.perf_counter() - start, SHORTEST)
