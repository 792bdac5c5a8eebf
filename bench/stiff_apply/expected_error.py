"""Estimate the tool's error after a correction, at least the error of the model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stiff_bench.api.model import MEAN_ERROR, Model, half_width_name, wrap_model_errors
from stiff_bench.plan.fits import DEFAULT_COVERAGE
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.stiffness_model import interval_at_tcp
from stiff_protocols.contract.types import AXES, FloatArray, Interval
from stiff_protocols.scoring.cross_validated import ErrorLengths

UNKNOWN = "not known: the model file has no cross-validated error; fit again"
SAME_WIDTH = 1.005
"""Largest ratio of largest and usual error with which only one error is printed."""


@dataclass(frozen=True, eq=False)
class ExpectedError:
    """Expected errors of predicted deflections: their mean, and half widths of intervals.

    Attributes:
        mean: expected error, from poses that the fits left out. Compare models by it.
        half_width: lengths of the interval's half widths on the three axes; larger than the mean,
            because most errors are smaller.
        interval: interval of the deflections of the TCP; None: unknown.
    """

    mean: ErrorLengths
    half_width: ErrorLengths
    interval: Interval | None = None


def expected_error(
    model: Model, q: FloatArray, wrench: FloatArray, coverage: float | None
) -> ExpectedError:
    """Return the expected error of predictions, from left-out poses, and their intervals.

    The mean error grows away from the training samples like an interval
    (`TrainingRange.widened`).

    Args:
        model: fitted model.
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        coverage: coverage of intervals per axis (0..1); None: 0.9, if the poses suffice.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: the coverage is not valid, or needs more training poses.
        DataError: the model from a file cannot predict.
    """
    model.check_fitted()
    model.check_coverage(coverage)
    name = half_width_name(coverage or DEFAULT_COVERAGE)
    mean = _mean_error(model, q, wrench)
    try:
        model.check_coverage(coverage or DEFAULT_COVERAGE)
    except StiffBenchError as reason:  # too few poses, or a model from a file
        return ExpectedError(mean, ErrorLengths(name, None, f"not known: {reason}"))
    with wrap_model_errors(model.file):
        interval = model.predict_interval(q, wrench, coverage or DEFAULT_COVERAGE)
        interval = interval_at_tcp(model.fitted, interval, q, wrench)
    lengths = ErrorLengths(name, interval.half_width, "length over x, y and z")
    return ExpectedError(mean, lengths, interval)


def _mean_error(model: Model, q: FloatArray, wrench: FloatArray) -> ErrorLengths:
    """Return the cross-validated mean error at (n, n_joints) q and (n, 6) wrenches."""
    try:
        error = model.cross_validated_error
    except StiffBenchError as reason:  # too few poses, or a model from a file
        return ErrorLengths(MEAN_ERROR, None, f"not known: {reason}")
    if error is None:
        return ErrorLengths(MEAN_ERROR, None, UNKNOWN)
    half = error.mean / math.sqrt(len(AXES))

    def within(q: FloatArray, wrench: FloatArray) -> Interval:
        predicted = np.asarray(model.fitted.predict(q, wrench))
        return Interval(predicted - half, predicted + half, math.nan)

    with wrap_model_errors(model.file):
        values = model.training_range.widened(within, q, wrench).half_width
    source = f"{MM * error.mean:.3g} mm over all training poses, {error.n_folds} folds"
    times = values.max(initial=0.0) / error.mean if error.mean else 1.0
    if times > SAME_WIDTH:
        source += f", up to {times:.3g} times that away from the training samples"
    return ErrorLengths(MEAN_ERROR, values, source)
