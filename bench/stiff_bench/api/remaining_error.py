"""Expected error of the tool after a correction: no less than the error of the model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stiff_bench.api.model import Model, blamed_on
from stiff_bench.plan.request import DEFAULT_COVERAGE
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.stiffness_model import interval_at_tcp, offers
from stiff_protocols.contract.types import AXES, FloatArray, Interval

NOT_KNOWN = "not known: the model file has no cross-validated error; fit again"
SAME_WIDTH = 1.005
"""Ratio of the largest to the usual error up to which both are printed as one."""


@dataclass(frozen=True, eq=False)
class ExpectedError:
    """Expected length of the error of predicted deflections.

    Attributes:
        values: (n,) m; None: not known.
        source: where they come from, for people; or why they are not known.
        interval: of the deflections of the TCP; None where no coverage was asked for.
    """

    values: FloatArray | None
    source: str
    interval: Interval | None = None


def expected_error(
    model: Model, q: FloatArray, wrench: FloatArray, coverage: float | None
) -> ExpectedError:
    """Return how far predictions are expected to be off, from intervals or from left-out poses.

    With a coverage, or for a model with intervals of its own, it is the length of the half-widths
    of the interval on the three axes. Otherwise it is the model's cross-validated mean error; away
    from the training samples it grows as an interval does (`TrainingRange.widened`).

    Args:
        model: fitted.
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        coverage: of intervals, per axis (0..1); None: 0.9 for a model with intervals of its own.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: the coverage is not valid, or needs more training poses.
        DataError: the model that was read from a file cannot predict.
    """
    model.check_fitted()
    model.check_coverage(coverage)
    if coverage is None and offers(model.fitted, "predict_interval"):
        coverage = DEFAULT_COVERAGE
    if coverage is not None:
        with blamed_on(model.file):
            interval = model.predict_interval(q, wrench, coverage)
            interval = interval_at_tcp(model.fitted, interval, q, wrench)
        values, source = _half_length(interval), f"{100.0 * coverage:.4g}% interval"
        return ExpectedError(values, source, interval)
    try:
        error = model.cross_validated_error
    except StiffBenchError as reason:  # too few poses; a model of a file computes nothing
        return ExpectedError(None, f"not known: {reason}")
    if error is None:
        return ExpectedError(None, NOT_KNOWN)
    half = error.mean / math.sqrt(len(AXES))

    def within(q: FloatArray, wrench: FloatArray) -> Interval:
        predicted = np.asarray(model.fitted.predict(q, wrench))
        return Interval(predicted - half, predicted + half, math.nan)

    with blamed_on(model.file):
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
    """Return (n,) the length of the half-widths on the three axes, m."""
    return np.asarray(0.5 * np.linalg.norm(interval.upper - interval.lower, axis=1))
