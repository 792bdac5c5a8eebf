"""Measures of a fit: errors of its predictions, its intervals, and its cost.

They are computed when a stored fit is read, so a new entry of `METRICS` has values for every
folder of results.

With e_i the ABSOLUTE error of sample i in one direction, the source paper defines
MAE = mean(e), STDE = sqrt(mean((e - mean(e))^2)), the population standard deviation of the
absolute error, and ME = max(e).

Intervals are judged by two numbers together: the share of the samples inside, which should be the
nominal one, and the mean width.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from stiff_protocols.contract.errors import unknown_name
from stiff_protocols.contract.record import Cost, FitResult
from stiff_protocols.contract.types import (
    AXES,
    DRAWN,
    TRUTH,
    BoolArray,
    FloatArray,
    Prediction,
    read_along,
)

WHOLE_VECTOR = ("",)
"""The axes of a metric with a single value."""
Unit = Literal["m", "1", "share", "s", "B", "1/s"]


@dataclass(frozen=True)
class Metric:
    """A column of a table.

    Attributes:
        key: name on the command line.
        label: column heading.
        unit: unit of the value; "share" is printed in per cent, "1" as it is.
        meaning: one line for `bench list metrics`.
        of_prediction: predictions -> one value per axis, or None if they do not determine it.
        of_cost: cost -> one value, or None if unknown.
        direction: best value: the smaller, the larger, or the nominal.
        axes: axes of the values: x, y, z, or a single value.
        needs_interval: it is computed from the predictions' intervals, and has no value without.
    """

    key: str
    label: str
    unit: Unit
    meaning: str
    of_prediction: Callable[[Prediction], FloatArray | None] | None = None
    of_cost: Callable[[Cost], float | None] | None = None
    direction: Literal["smaller", "larger", "nominal"] = "smaller"
    axes: tuple[str, ...] = AXES
    needs_interval: bool = False

    def values(self, prediction: Prediction, cost: Cost | None = None) -> dict[str, float]:
        """Return axis -> value; an axis without a finite value is left out.

        `cost` is None if unknown, as for the predictions of several splits together.
        """
        computed: FloatArray | float | None = None
        if self.needs_interval and prediction.interval is None:
            return {}
        if self.axes == AXES and prediction.directions.size:
            return {}  # the readings are not along them
        if self.of_prediction is not None:
            computed = self.of_prediction(prediction)
        elif self.of_cost is not None and cost is not None:
            computed = self.of_cost(cost)
        if computed is None:
            return {}
        values = zip(self.axes, np.atleast_1d(computed).tolist(), strict=True)
        return {axis: value for axis, value in values if np.isfinite(value)}

    def of_result(self, result: FitResult) -> dict[str, float]:
        """Return axis -> value of a fit, in SI units; empty without a prediction."""
        prediction = result.prediction
        return {} if prediction is None else self.values(prediction, result.cost)


def absolute_errors(prediction: Prediction) -> FloatArray:
    """Return the (n, 3) absolute errors, m."""
    return np.abs(prediction.errors(prediction.predicted))


def norm_errors(prediction: Prediction) -> FloatArray:
    """Return the (n,) Euclidean lengths of the error, m; of a single reading, its error."""
    return _lengths(prediction.errors(prediction.predicted))


def reading_errors(prediction: Prediction) -> FloatArray:
    """Return the (n,) mean absolute errors of the numbers that were read in each row, m."""
    directions = prediction.directions
    errors = read_along(directions, prediction.predicted - prediction.measured)
    counts = directions.any(axis=2).sum(axis=1) if directions.size else errors.shape[1]
    return np.asarray(np.abs(errors).sum(axis=1) / counts)


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the (n,) lengths of (n, 3) vectors."""
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))  # a quarter of np.linalg.norm's time


def _of_axes(reduced: Callable[..., Any]) -> Callable[[Prediction], FloatArray]:
    """Return a function that reduces the absolute errors, m, axis by axis."""
    return lambda prediction: np.asarray(reduced(absolute_errors(prediction), axis=0))


def _of_norm(reduced: Callable[..., Any]) -> Callable[[Prediction], FloatArray]:
    """Return a function that reduces the lengths of the errors, m."""
    return lambda prediction: np.asarray(reduced(norm_errors(prediction)))


_P95 = partial(np.percentile, q=95.0)


def _rmse(prediction: Prediction) -> FloatArray:
    return np.asarray(np.sqrt((absolute_errors(prediction) ** 2).mean(axis=0)))


def _r2(prediction: Prediction) -> FloatArray:
    """Return 1 - SSE/SST; NaN on an axis along which the test rows do not differ."""
    measured = prediction.measured
    total = ((measured - measured.mean(axis=0)) ** 2).sum(axis=0)
    squared_errors = ((measured - prediction.predicted) ** 2).sum(axis=0)
    return np.asarray(
        1.0
        - np.divide(
            squared_errors, total, out=np.full_like(squared_errors, np.nan), where=total > 0.0
        )
    )


def _relative(prediction: Prediction) -> FloatArray | None:
    """Return a ratio of means; the smallest deflections would dominate a mean of ratios."""
    size = float(_lengths(prediction.measured).mean())
    return np.asarray(norm_errors(prediction).mean() / size) if size > 0.0 else None


def _removed(prediction: Prediction) -> FloatArray | None:
    relative_error = _relative(prediction)
    return None if relative_error is None else np.asarray(1.0 - relative_error)


def _skill(prediction: Prediction) -> FloatArray | None:
    if prediction.reference is None:
        return None
    reference = float(_lengths(prediction.errors(prediction.reference)).mean())
    return np.asarray(1.0 - norm_errors(prediction).mean() / reference) if reference > 0.0 else None


def true_errors(prediction: Prediction, *truths: str) -> FloatArray | None:
    """Return the (n,) lengths of the errors, m, against the first known truth; None: not known.

    `truths` are keys of `TRUTHS`; by default `TRUTH`.
    """
    every = map(prediction.bound_deflections.get, truths or (TRUTH,))
    truth = next((array for array in every if array is not None), None)
    return None if truth is None else _lengths(prediction.predicted - truth)


def _true_lengths(
    reduced: Callable[..., Any], *truths: str
) -> Callable[[Prediction], FloatArray | None]:
    """Return a function that reduces the `true_errors`."""

    def of_prediction(prediction: Prediction) -> FloatArray | None:
        errors = true_errors(prediction, *truths)
        return None if errors is None else np.asarray(reduced(errors))

    return of_prediction


def _inside(prediction: Prediction) -> BoolArray:
    """Return (n, 3) true for deflections, or readings, in their intervals, bounds included.

    The interval of a reading along a direction holds all deflections in the intervals of the axes.
    """
    interval, measured, directions = (
        prediction.interval,
        prediction.measured,
        prediction.directions,
    )
    assert interval is not None  # else the metric has no value
    if directions.size:
        middle, half = (interval.lower + interval.upper) / 2, (interval.upper - interval.lower) / 2
        distance = np.abs(read_along(directions, measured - middle))
        return np.asarray(distance <= read_along(np.abs(directions), half))
    return (interval.lower <= measured) & (measured <= interval.upper)


def _coverage(prediction: Prediction) -> FloatArray:
    return np.asarray(_inside(prediction).mean(axis=0))


def _coverage_3d(prediction: Prediction) -> FloatArray:
    return np.asarray(_inside(prediction).all(axis=1).mean())


def _width(prediction: Prediction) -> FloatArray:
    interval = prediction.interval
    assert interval is not None  # else the metric has no value
    return np.asarray((interval.upper - interval.lower).mean(axis=0))


_single_value = partial(Metric, axes=WHOLE_VECTOR)
_of_interval = partial(Metric, needs_interval=True)

METRICS = {
    metric.key: metric
    for metric in (
        Metric("mae", "MAE", "m", "mean absolute error of an axis", _of_axes(np.mean)),
        Metric("stde", "STDE", "m", "standard deviation of the absolute error", _of_axes(np.std)),
        Metric("me", "ME", "m", "largest absolute error", _of_axes(np.max)),
        Metric("rmse", "RMSE", "m", "root mean square error", _rmse),
        Metric("median", "median", "m", "median absolute error", _of_axes(np.median)),
        Metric("p95", "P95", "m", "95th percentile of the absolute error", _of_axes(_P95)),
        Metric("r2", "R2", "1", "1 - squared errors / squared deviations", _r2, direction="larger"),
        _single_value(
            "norm",
            "3-D error",
            "m",
            "mean 3-D error, the length of the error vector",
            _of_norm(np.mean),
        ),
        _single_value(
            "reading",
            "error of a reading",
            "m",
            "mean absolute error of a number that was read: along x, y, z or a gauge's direction",
            lambda prediction: np.asarray(reading_errors(prediction).mean()),
        ),
        _single_value(
            "norm-p95", "3-D error P95", "m", "95th percentile of the 3-D error", _of_norm(_P95)
        ),
        _single_value("norm-max", "3-D error max", "m", "largest 3-D error", _of_norm(np.max)),
        _single_value(
            "true-norm",
            "true error",
            "m",
            "mean 3-D error against the true robot's deflection (simulated robots)",
            _true_lengths(np.mean),
        ),
        _single_value(
            "true-p95",
            "true error P95",
            "m",
            "95th percentile of the 3-D error against the true robot's deflection",
            _true_lengths(_P95),
        ),
        _single_value(
            "drawn-norm",
            "drawn error",
            "m",
            "mean 3-D error against the true robot's deflection in its drawn state of friction",
            _true_lengths(np.mean, DRAWN, TRUTH),
        ),
        _single_value(
            "relative",
            "relative",
            "share",
            "mean 3-D error / mean length of the deflection",
            _relative,
        ),
        _single_value(
            "removed",
            "removed",
            "share",
            "1 - relative: share of the mean deflection, or path error, that the model removes",
            _removed,
            direction="larger",
        ),
        _single_value(
            "skill",
            "skill",
            "share",
            "1 - 3-D error / 3-D error of a VJM identified on the same rows with the same wrenches",
            _skill,
            direction="larger",
        ),
        _of_interval(
            "coverage",
            "coverage",
            "share",
            "share of the samples inside their interval",
            _coverage,
            direction="nominal",
        ),
        _of_interval(
            "coverage-3d",
            "3-D coverage",
            "share",
            "share of the samples inside their intervals of X, Y and Z at once",
            _coverage_3d,
            direction="nominal",
            axes=WHOLE_VECTOR,
        ),
        _of_interval("width", "width", "m", "mean width of the intervals", _width),
        _single_value(
            "fit-time",
            "fit time",
            "s",
            "wall time of a fit; a run's first one loads libraries, cached pre-training is free",
            of_cost=lambda cost: cost.fit_s,
        ),
        _single_value(
            "latency",
            "latency",
            "s",
            "wall time of predicting one sample",
            of_cost=lambda cost: cost.latency_s,
        ),
        _single_value(
            "throughput",
            "throughput",
            "1/s",
            "samples predicted per second in one large call",
            of_cost=lambda cost: cost.throughput_per_s,
            direction="larger",
        ),
        _single_value(
            "memory",
            "memory",
            "B",
            "memory that fit and prediction added to the process",
            of_cost=lambda cost: cost.memory_bytes,
        ),
    )
}


def metric(key: str) -> Metric:
    """Return the metric of a key; ConfigError if it is unknown."""
    if key not in METRICS:
        raise unknown_name("metric", key, METRICS)
    return METRICS[key]
