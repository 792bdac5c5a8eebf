"""Measures of a cell: errors of its predictions, its intervals, and what it cost.

With e_i the ABSOLUTE error of sample i in one direction, the source paper defines
MAE = mean(e), STDE = sqrt(mean((e - mean(e))^2)), the population standard deviation of the
absolute error, and ME = max(e).

Intervals are judged by two numbers together: the share of the samples inside, which should be the
nominal one, and the mean width.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_protocols.contract.errors import unknown_name
from stiff_protocols.contract.record import Cost
from stiff_protocols.contract.types import AXES, FloatArray, Prediction

WHOLE = ("",)
"""The axes of a metric that has one value in all."""
Unit = Literal["m", "1", "share", "s", "B", "1/s"]


@dataclass(frozen=True)
class Metric:
    """A column of a table.

    Attributes:
        key: the word used on the command line and in records.
        label: column heading.
        unit: of the value; "share" is printed in per cent, "1" as it is.
        direction: whether a smaller, a larger, or the nominal value is best.
        meaning: one line for `bench list metrics`.
        of_prediction: predictions -> one value an axis, or None where they do not tell.
        of_cost: cost -> one value, or None where it is not known.
        axes: of the values: x, y, z, or one value in all.
        needs_interval: it is computed from the predictions' intervals.
    """

    key: str
    label: str
    unit: Unit
    direction: Literal["smaller", "larger", "nominal"]
    meaning: str
    of_prediction: Callable[[Prediction], FloatArray | None] | None = None
    of_cost: Callable[[Cost], float | None] | None = None
    axes: tuple[str, ...] = AXES
    needs_interval: bool = False

    def values(self, prediction: Prediction, cost: Cost | None = None) -> dict[str, float]:
        """Return axis -> value; an axis without a finite value is left out.

        `cost` is None where it is not known, as for the predictions of several splits together.
        """
        found: FloatArray | float | None = None
        if self.of_prediction is not None:
            found = self.of_prediction(prediction)
        elif self.of_cost is not None and cost is not None:
            found = self.of_cost(cost)
        if found is None:
            return {}
        values = zip(self.axes, np.atleast_1d(found).tolist(), strict=True)
        return {axis: value for axis, value in values if np.isfinite(value)}


def absolute_errors(prediction: Prediction) -> FloatArray:
    """Return the (n, 3) absolute errors, m."""
    return np.abs(prediction.predicted - prediction.measured)


def norm_errors(prediction: Prediction) -> FloatArray:
    """Return the (n,) Euclidean lengths of the error, m."""
    x, y, z = (prediction.predicted - prediction.measured).T
    return np.asarray(np.sqrt(x * x + y * y + z * z))  # a quarter of np.linalg.norm's time


def _mae(prediction: Prediction) -> FloatArray:
    return np.asarray(absolute_errors(prediction).mean(axis=0))


def _stde(prediction: Prediction) -> FloatArray:
    return np.asarray(absolute_errors(prediction).std(axis=0))


def _me(prediction: Prediction) -> FloatArray:
    return np.asarray(absolute_errors(prediction).max(axis=0))


def _rmse(prediction: Prediction) -> FloatArray:
    return np.asarray(np.sqrt((absolute_errors(prediction) ** 2).mean(axis=0)))


def _median(prediction: Prediction) -> FloatArray:
    return np.asarray(np.median(absolute_errors(prediction), axis=0))


def _p95(prediction: Prediction) -> FloatArray:
    return np.asarray(np.percentile(absolute_errors(prediction), 95.0, axis=0))


def _r2(prediction: Prediction) -> FloatArray:
    """Return 1 - SSE/SST; NaN on an axis along which the test rows do not differ."""
    measured = prediction.measured
    total = ((measured - measured.mean(axis=0)) ** 2).sum(axis=0)
    left = ((measured - prediction.predicted) ** 2).sum(axis=0)
    return np.asarray(
        1.0 - np.divide(left, total, out=np.full_like(left, np.nan), where=total > 0.0)
    )


def _norm(prediction: Prediction) -> FloatArray:
    return np.asarray(norm_errors(prediction).mean())


def _norm_p95(prediction: Prediction) -> FloatArray:
    return np.asarray(np.percentile(norm_errors(prediction), 95.0))


def _norm_max(prediction: Prediction) -> FloatArray:
    return np.asarray(norm_errors(prediction).max())


def _relative(prediction: Prediction) -> FloatArray | None:
    """Return a ratio of means: ratios of single samples are ruled by the smallest deflections."""
    size = float(np.linalg.norm(prediction.measured, axis=1).mean())
    return np.asarray(norm_errors(prediction).mean() / size) if size > 0.0 else None


def _removed(prediction: Prediction) -> FloatArray | None:
    left = _relative(prediction)
    return None if left is None else np.asarray(1.0 - left)


def _skill(prediction: Prediction) -> FloatArray | None:
    if prediction.reference is None:
        return None
    of_reference = Prediction(prediction.rows, prediction.reference, prediction.measured)
    reference = float(norm_errors(of_reference).mean())
    return np.asarray(1.0 - norm_errors(prediction).mean() / reference) if reference > 0.0 else None


def _coverage(prediction: Prediction) -> FloatArray | None:
    interval, measured = prediction.interval, prediction.measured
    if interval is None:
        return None
    inside = (interval.lower <= measured) & (measured <= interval.upper)
    return np.asarray(inside.mean(axis=0))


def _coverage_3d(prediction: Prediction) -> FloatArray | None:
    interval, measured = prediction.interval, prediction.measured
    if interval is None:
        return None
    inside = (interval.lower <= measured) & (measured <= interval.upper)
    return np.asarray(inside.all(axis=1).mean())


def _width(prediction: Prediction) -> FloatArray | None:
    interval = prediction.interval
    return None if interval is None else np.asarray((interval.upper - interval.lower).mean(axis=0))


METRICS = {
    metric.key: metric
    for metric in (
        Metric("mae", "MAE", "m", "smaller", "mean absolute error of an axis", _mae),
        Metric("stde", "STDE", "m", "smaller", "standard deviation of the absolute error", _stde),
        Metric("me", "ME", "m", "smaller", "largest absolute error", _me),
        Metric("rmse", "RMSE", "m", "smaller", "root mean square error", _rmse),
        Metric("median", "median", "m", "smaller", "median absolute error", _median),
        Metric("p95", "P95", "m", "smaller", "95th percentile of the absolute error", _p95),
        Metric("r2", "R2", "1", "larger", "1 - squared errors / squared deviations", _r2),
        Metric(
            "norm",
            "3-D error",
            "m",
            "smaller",
            "mean 3-D error, the length of the error vector",
            _norm,
            axes=WHOLE,
        ),
        Metric(
            "norm-p95",
            "3-D error P95",
            "m",
            "smaller",
            "95th percentile of the 3-D error",
            _norm_p95,
            axes=WHOLE,
        ),
        Metric(
            "norm-max",
            "3-D error max",
            "m",
            "smaller",
            "largest 3-D error",
            _norm_max,
            axes=WHOLE,
        ),
        Metric(
            "relative",
            "relative",
            "share",
            "smaller",
            "mean 3-D error / mean length of the deflection",
            _relative,
            axes=WHOLE,
        ),
        Metric(
            "removed",
            "removed",
            "share",
            "larger",
            "1 - relative: share of the mean deflection, or path error, that the model removes",
            _removed,
            axes=WHOLE,
        ),
        Metric(
            "skill",
            "skill",
            "share",
            "larger",
            "1 - 3-D error / that of a VJM identified on the same rows with the same wrenches",
            _skill,
            axes=WHOLE,
        ),
        Metric(
            "coverage",
            "coverage",
            "share",
            "nominal",
            "share of the samples inside their interval",
            _coverage,
            needs_interval=True,
        ),
        Metric(
            "coverage-3d",
            "3-D coverage",
            "share",
            "nominal",
            "share of the samples inside their intervals of X, Y and Z at once",
            _coverage_3d,
            axes=WHOLE,
            needs_interval=True,
        ),
        Metric(
            "width",
            "width",
            "m",
            "smaller",
            "mean width of the intervals",
            _width,
            needs_interval=True,
        ),
        Metric(
            "fit-time",
            "fit time",
            "s",
            "smaller",
            "wall time of a fit; a run's first one loads libraries, cached pre-training is free",
            of_cost=lambda cost: cost.fit_s,
            axes=WHOLE,
        ),
        Metric(
            "latency",
            "latency",
            "s",
            "smaller",
            "wall time of predicting one sample",
            of_cost=lambda cost: cost.latency_s,
            axes=WHOLE,
        ),
        Metric(
            "throughput",
            "throughput",
            "1/s",
            "larger",
            "samples predicted per second in one large call",
            of_cost=lambda cost: cost.throughput_per_s,
            axes=WHOLE,
        ),
        Metric(
            "memory",
            "memory",
            "B",
            "smaller",
            "memory that fit and prediction added to the process",
            of_cost=lambda cost: cost.memory_bytes,
            axes=WHOLE,
        ),
    )
}


def metric(key: str) -> Metric:
    """Return the metric of that key; ConfigError where there is none."""
    if key not in METRICS:
        raise unknown_name("metric", key, METRICS)
    return METRICS[key]
