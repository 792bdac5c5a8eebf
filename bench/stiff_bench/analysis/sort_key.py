"""The sort key of a leaderboard: one number per split, from a metric and an axis."""

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
"""Row errors by metric, for metrics that are means over rows: their poses can be resampled."""


@dataclass(frozen=True)
class SortKey:
    """A metric on one axis, or its mean over all of its axes.

    Attributes:
        metric: metric with a better direction (smaller or larger).
        axis: "x", "y" or "z"; "": the mean of the metric's axes.
    """

    metric: Metric
    axis: str = ""

    @property
    def text(self) -> str:
        """Return metric, axis and unit as one line."""
        unit, _ = PRINTED[self.metric.unit]
        of_axis = f" of {self.axis}" if self.axis else ""
        shown_unit = f" [{unit}]" if unit else ""
        over = f", mean over {', '.join(self._axes)}" if len(self._axes) > 1 else ""
        return f"{self.metric.label}{of_axis}{shown_unit}{over}"

    @property
    def sign(self) -> float:
        """Return 1 if smaller values are better, -1 if larger values are."""
        return -1.0 if self.metric.direction == "larger" else 1.0

    @property
    def resamples(self) -> bool:
        """Return True if the metric is a mean over rows, so that poses can be resampled."""
        return self.metric.key in _ROW_ERRORS

    @property
    def is_cost(self) -> bool:
        """Return True for time or memory; no statistical test applies to these."""
        return self.metric.of_cost is not None

    @property
    def _axes(self) -> tuple[str, ...]:
        return (self.axis,) if self.axis else self.metric.axes

    def of_splits(self, results: Sequence[CellResult]) -> FloatArray | None:
        """Return the (J,) values of a model's results on J splits, in the metric's unit.

        It is one value if the protocol scores the predictions of all splits together. None: a
        value is missing.
        """
        split_values = values_of_splits(self.metric, results)
        try:
            of_axes = [[values[axis] for values in split_values] for axis in self._axes]
        except KeyError:
            return None
        return np.asarray(np.mean(of_axes, axis=0))

    def of_rows(self, prediction: Prediction) -> FloatArray:
        """Return the (n,) errors, m, whose mean is the value; only if `resamples`."""
        errors = _ROW_ERRORS[self.metric.key](prediction)
        if errors.ndim == 1:
            return errors
        columns = [self.metric.axes.index(axis) for axis in self._axes]
        return np.asarray(errors[:, columns].mean(axis=1))


def sort_key(key: str, axis: str | None) -> SortKey:
    """Return the sort key of a metric and an axis.

    Raises:
        ConfigError: the metric or axis is unknown, or the metric cannot rank models.
    """
    chosen_metric = metric(key)
    if chosen_metric.needs_interval:
        reason = "narrower intervals are better only at equal coverage"
        if chosen_metric.direction == "nominal":
            reason = "its best value is the nominal one"
        valid = ", ".join(m.key for m in METRICS.values() if not m.needs_interval)
        raise ConfigError(f"{key}: {reason}, so it does not rank models (valid: {valid})", "metric")
    if axis is not None and axis not in AXES:
        raise ConfigError(f"{axis!r} (valid: {', '.join(AXES)})", "axis")
    if axis is not None and axis not in chosen_metric.axes:
        with_axes = ", ".join(m.key for m in METRICS.values() if m.axes == AXES)
        raise ConfigError(
            f"{axis}: {key} has no axes; use a metric with axes ({with_axes})", "axis"
        )
    return SortKey(chosen_metric, axis or "")
