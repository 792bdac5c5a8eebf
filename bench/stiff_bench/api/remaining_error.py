"""The error that remains after a correction: what the model itself does not know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.api.model import Model, blamed_on
from stiff_bench.plan.request import DEFAULT_COVERAGE
from stiff_bench.tables.units import counted
from stiff_datasets.measured.rows_beyond_training import extrapolation_warning
from stiff_datasets.measured.sample_columns import MM_PER_M
from stiff_protocols.contract.stiffness_model import interval_at_tcp, offers
from stiff_protocols.contract.types import FloatArray, Interval


@dataclass(frozen=True, eq=False)
class ExpectedError:
    """The 3-D error that remains at corrected points.

    Attributes:
        values: (n,) m; None if nothing is known about the model's error.
        source: where the values come from.
        interval: of the deflections at the commands, if the values come from it.
    """

    values: FloatArray | None
    source: str
    interval: Interval | None = None

    def __str__(self) -> str:
        """Return the mean and the largest one in mm, and where they come from."""
        if self.values is None:
            return self.source
        if not len(self.values):
            return "none, no point is corrected"
        mean, largest = MM_PER_M * self.values.mean(), MM_PER_M * self.values.max()
        return f"{mean:.3g} mm mean, {largest:.3g} mm largest ({self.source})"


def expected_error(
    model: Model, q: FloatArray, wrench: FloatArray, coverage: float | None = None
) -> ExpectedError:
    """Return the error that remains where a predicted deflection is corrected.

    Intervals decide where the model has its own or `coverage` is given: the value is the length of
    their half-widths. Otherwise it is the mean cross-validated 3-D error that `save` keeps, widened
    away from the training samples as `TrainingRange.widened` says.

    Args:
        model: fitted.
        q: (n, n_joints) commanded joint positions, rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        coverage: of the intervals (0..1); None: 0.9 for a model with intervals of its own.
    """
    fitted = model.fitted
    if coverage is None and offers(fitted, "predict_interval"):
        coverage = DEFAULT_COVERAGE
    if coverage is not None:
        with blamed_on(model.file):
            interval = model.predict_interval(q, wrench, coverage)
            interval = interval_at_tcp(fitted, interval, q, wrench)
        half = 0.5 * np.linalg.norm(interval.upper - interval.lower, axis=1)
        return ExpectedError(half, f"half-widths of the {coverage:.0%} intervals", interval)
    errors = model.cross_validated_errors
    if errors is None:
        return ExpectedError(
            None, "not known: the model has no cross-validated error; fit and save it again"
        )
    mean = float(errors.mean())

    def around_zero(q: FloatArray, wrench: FloatArray) -> Interval:
        half = np.full((len(q), 3), mean)
        return Interval(-half, half, DEFAULT_COVERAGE)

    values = model.training_range.widened(around_zero, q, wrench).upper[:, 0]
    source = f"cross-validated 3-D error of the fit {MM_PER_M * mean:.3g} mm"
    return ExpectedError(values, source + (", more beyond training" * bool(values.max() > mean)))


def correction_lines(
    n_points: int,
    noun: str,
    removed: FloatArray,
    expected: ExpectedError,
    extrapolates: Sequence[str],
) -> list[str]:
    """Return the text about a correction, the most important first.

    Args:
        n_points: points or targets that were given.
        noun: "point" or "target".
        removed: (n,) predicted deflections that are taken out at corrected ones, m.
        expected: error that remains at these.
        extrapolates: (n,) what of these is beyond the training range.
    """
    first = f"{len(removed)} of {counted(n_points, noun)} corrected"
    beyond = sum(map(bool, extrapolates))
    if beyond:
        first += f"; {beyond} of {len(removed)} beyond the training range of the model"
    lines = [first]
    if len(removed):
        lengths = MM_PER_M * removed
        lines.append(
            f"removed deflection: {lengths.mean():.3g} mm mean, {lengths.max():.3g} mm largest"
        )
        lines.append(f"expected remaining error: {expected}")
        if expected.values is not None and expected.values.mean() >= removed.mean() > 0.0:
            lines.append("the model's own error is as large as what the correction removes")
    return lines


def beyond_training(model: Model, q: FloatArray, wrench: FloatArray) -> tuple[list[str], str]:
    """Return what of each row is beyond the training range, and a line about all of them."""
    words = model.training_range.extrapolates(q, wrench)
    robot = model.fitted.robot_
    return words, extrapolation_warning(model.training_range, robot, q, wrench, words)
