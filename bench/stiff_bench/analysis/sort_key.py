"""What a leaderboard sorts by: one number a split, from a metric and an axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.tables.metric_table import values_of_splits
from stiff_bench.tables.units import PRINTED
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import AXES, FloatArray, Prediction
from stiff_protocols.scoring.metrics import METRICS, Metric, absolute_errors, metric, norm_errors

_ROW_ERRORS: dict[str, Callable[[Prediction], FloatArray]] = {
    "mae": absolute_errors,
    "norm": norm_errors,
}
"""The metrics that are means over rows, so that poses can be resampled: key -> the rows' errors."""


@dataclass(frozen=True)
class SortKey:
    """A metric on one axis, or its mean over all of its axes.

    Attributes:
        metric: whose smaller or larger values are better.
        axis: "x", "y" or "z"; "": the mean of the metric's axes, which may be one in all.
    """

    metric: Metric
    axis: str = ""

    @property
    def text(self) -> str:
        """Metric, axis and unit for people."""
        unit, _ = PRINTED[self.metric.unit]
        of_axis = f" of {self.axis}" if self.axis else ""
        shown_unit = f" [{unit}]" if unit else ""
        over = f", mean over {', '.join(self._axes)}" if len(self._axes) > 1 else ""
        return f"{self.metric.label}{of_axis}{shown_unit}{over}"

    @property
    def sign(self) -> float:
        """1 where smaller values are better, -1 where larger ones are."""
        return -1.0 if self.metric.direction == "larger" else 1.0

    @property
    def resamples(self) -> bool:
        """Whether the metric is a mean over rows, so that poses can be resampled."""
        return self.metric.key in _ROW_ERRORS

    @property
    def is_cost(self) -> bool:
        """Whether it is measured on the machine: time or memory, which no test here applies to."""
        return self.metric.of_cost is not None

    @property
    def _axes(self) -> tuple[str, ...]:
        return (self.axis,) if self.axis else self.metric.axes

    def of_splits(self, results: Sequence[CellResult]) -> FloatArray | None:
        """Return the (J,) values of a model's results on J splits, in the metric's unit.

        One value where the protocol scores the predictions of all splits together; None where a
        value is missing.
        """
        found = values_of_splits(self.metric, results)
        try:
            of_axes = [[values[axis] for values in found] for axis in self._axes]
        except KeyError:
            return None
        return np.asarray(np.mean(of_axes, axis=0))

    def of_rows(self, prediction: Prediction) -> FloatArray:
        """Return the (n,) errors, m, whose mean is the value; of metrics that `resamples` alone."""
        errors = _ROW_ERRORS[self.metric.key](prediction)
        if errors.ndim == 1:
            return errors
        columns = [self.metric.axes.index(axis) for axis in self._axes]
        return np.asarray(errors[:, columns].mean(axis=1))


def sort_key(key: str, axis: str | None) -> SortKey:
    """Return what a metric's key and an axis name.

    Raises:
        ConfigError: there is no such metric or axis, or it does not say which model is better.
    """
    found = metric(key)
    if found.needs_interval:
        why = "narrower intervals are better only at equal coverage"
        if found.direction == "nominal":
            why = "its best value is the nominal one"
        valid = ", ".join(m.key for m in METRICS.values() if not m.needs_interval)
        raise ConfigError(f"{key}: {why}, so it does not rank models (valid: {valid})", "metric")
    if axis is not None and axis not in AXES:
        raise ConfigError(f"{axis!r} (valid: {', '.join(AXES)})", "axis")
    if axis is not None and axis not in found.axes:
        with_axes = ", ".join(m.key for m in METRICS.values() if m.axes == AXES)
        raise ConfigError(
            f"{axis}: {key} is one value in all; metrics with axes are {with_axes}", "axis"
        )
    return SortKey(found, axis or "")
