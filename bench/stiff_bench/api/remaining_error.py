"""Estimate the tool's error after a correction, at least the error of the model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stiff_bench.api.model import Model, wrap_model_errors
from stiff_bench.plan.cells import DEFAULT_COVERAGE
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.stiffness_model import interval_at_tcp, offers
from stiff_protocols.contract.types import AXES, FloatArray, Interval

NOT_KNOWN = "not known: the model file has no cross-validated error; fit again"
SAME_WIDTH = 1.005
"""Largest ratio of largest and usual error with which only one error is printed."""


@dataclass(frozen=True, eq=False)
class ExpectedError:
    """Expected length of the error of predicted deflections.

    Attributes:
        values: (n,) m; None: unknown.
        source: text on the source of the values, or the reason why they are unknown.
        interval: interval of the deflections of the TCP; None without a coverage.
    """

    values: FloatArray | None
    source: str
    interval: Interval | None = None


def expected_error(
    model: Model, q: FloatArray, wrench: FloatArray, coverage: float | None
) -> ExpectedError:
    """Return the expected error of predictions, from intervals or from left-out poses.

    With a coverage, or for a model with its own intervals, it is the length of the interval's
    half-widths on the three axes. Otherwise it is the model's cross-validated mean error. Away from
    the training samples this error grows like an interval (`TrainingRange.widened`).

    Args:
        model: fitted model.
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        coverage: coverage of intervals per axis (0..1); None: 0.9 for models with own intervals.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: the coverage is not valid, or needs more training poses.
        DataError: the model from a file cannot predict.
    """
    model.check_fitted()
    model.check_coverage(coverage)
    if coverage is None and offers(model.fitted, "predict_interval"):
        coverage = DEFAULT_COVERAGE
    if coverage is not None:
        with wrap_model_errors(model.file):
            interval = model.predict_interval(q, wrench, coverage)
            interval = interval_at_tcp(model.fitted, interval, q, wrench)
        values, source = _half_length(interval), f"{100.0 * coverage:.4g}% interval"
        return ExpectedError(values, source, interval)
    try:
        error = model.cross_validated_error
    except StiffBenchError as reason:  # too few poses, or a model from a file
        return ExpectedError(None, f"not known: {reason}")
    if error is None:
        return ExpectedError(None, NOT_KNOWN)
    half = error.mean / math.sqrt(len(AXES))

    def within(q: FloatArray, wrench: FloatArray) -> Interval:
        predicted = np.asarray(model.fitted.predict(q, wrench))
        return Interval(predicted - half, predicted + half, math.nan)

    with wrap_model_errors(model.file):
        values = _half_length(model.training_range.widened(within, q, wrench))
    source = (
        f"cross-validated 3-D error {MM * error.mean:.3g} mm of the fit, {error.n_folds} folds "
        "over poses"
    )
    times = values.max(initial=0.0) / error.mean if error.mean else 1.0
    if times > SAME_WIDTH:
        source += f", up to {times:.3g} times that away from the training samples"
    return ExpectedError(values, source)


def _half_length(interval: Interval) -> FloatArray:
    """Return (n,) lengths of the half-widths on the three axes, m."""
    return np.asarray(0.5 * np.linalg.norm(interval.upper - interval.lower, axis=1))
