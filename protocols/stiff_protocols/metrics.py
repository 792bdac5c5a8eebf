"""Error measures of a set of predictions, one value an axis.

With e_i the ABSOLUTE error of sample i in one direction, the source paper defines
MAE = mean(e), STDE = sqrt(mean((e - mean(e))^2)), the population standard deviation of the
absolute error, and ME = max(e).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_protocols.errors import unknown_name
from stiff_protocols.types import FloatArray, Prediction


@dataclass(frozen=True)
class Metric:
    """A column of a table.

    Attributes:
        key: the word used on the command line and in records.
        label: column heading.
        unit: unit of the value `compute` returns.
        direction: whether a smaller or a larger value is better.
        compute: absolute errors (n, 3) in m -> one value an axis (3,).
    """

    key: str
    label: str
    unit: str
    direction: Literal["smaller", "larger"]
    compute: Callable[[FloatArray], FloatArray]

    def __call__(self, prediction: Prediction) -> FloatArray:
        """Return the value for x, y and z."""
        return self.compute(np.abs(prediction.predicted - prediction.measured))


def _mean(errors: FloatArray) -> FloatArray:
    return np.asarray(errors.mean(axis=0))


def _population_std(errors: FloatArray) -> FloatArray:
    return np.asarray(errors.std(axis=0))


def _maximum(errors: FloatArray) -> FloatArray:
    return np.asarray(errors.max(axis=0))


METRICS = {
    metric.key: metric
    for metric in (
        Metric("mae", "MAE", "m", "smaller", _mean),
        Metric("stde", "STDE", "m", "smaller", _population_std),
        Metric("me", "ME", "m", "smaller", _maximum),
    )
}


def metric(key: str) -> Metric:
    """Return the metric of that key.

    Raises:
        ConfigError: there is none.
    """
    if key not in METRICS:
        raise unknown_name("metric", key, METRICS)
    return METRICS[key]
