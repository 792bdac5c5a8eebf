"""Tests over robots with equal weights, for conclusions about the next robot.

A robot's number is the logarithm of an error ratio, such as ln(error of A / error of B), averaged
over all data of the robot. Specimens of the same type, plans, splits and seeds do not count as
robots.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, frozen_array
from stiff_protocols.scoring.paired import LEVEL, holm

MARGIN = math.log(1.05)
"""Error ratios from 1/1.05 to 1.05 make no difference in practice: about 5 %."""
ROUNDING = 1e-12
"""Largest difference of logarithms that rounding makes."""
MOST_SIGNS = 2**16
"""Largest number of sign choices that are all counted; of more, this number is drawn."""


@dataclass(frozen=True)
class MeanRatio:
    """Geometric mean of an error ratio over robots, with Student's t interval.

    Attributes:
        ratio: exp of the mean logarithm.
        low, high: bounds of the interval.
        n_robots: number of robots.
    """

    ratio: float
    low: float
    high: float
    n_robots: int


def mean_ratio(logs: ArrayLike, confidence: float = 1.0 - LEVEL) -> MeanRatio:
    """Return the geometric mean of the ratios whose (n,) logarithms are given.

    Raises:
        DataError: there are fewer than two robots, or a logarithm is not finite.
    """
    from scipy import stats  # slow, and few commands test

    values = _checked(logs)
    mean, error = float(values.mean()), float(stats.sem(values))
    half = error * float(stats.t.ppf(0.5 + 0.5 * confidence, len(values) - 1))
    bounds = math.exp(mean - half), math.exp(mean + half)
    return MeanRatio(math.exp(mean), *bounds, len(values))


def sign_flip_p_value(differences: ArrayLike) -> float:
    """Return the two-sided p-value that (n,) differences of robots are symmetric about zero.

    The mean is compared with the means of all 2^n choices of signs (Fisher 1935); 12 robots have
    4,096. The smallest possible p-value is 2 / 2^n.

    Raises:
        DataError: there are fewer than two robots, or a difference is not finite.
    """
    from scipy import stats  # slow, and few commands test

    values = _checked(differences)
    if not values.any():
        return 1.0
    test = stats.permutation_test(
        (values,),
        np.mean,
        permutation_type="samples",
        vectorized=True,
        n_resamples=MOST_SIGNS,
        rng=np.random.default_rng(0),
    )
    return float(test.pvalue)


def corrected_p_values(differences: Mapping[str, ArrayLike]) -> dict[str, float]:
    """Return sign-flip p-values by name, corrected (Holm) for the number of names.

    Args:
        differences: name -> (n,) differences of robots.

    Raises:
        DataError: as `sign_flip_p_value`.
    """
    p_values = holm([sign_flip_p_value(values) for values in differences.values()])
    return dict(zip(differences, p_values.tolist(), strict=True))


def equivalence_p_value(differences: ArrayLike, margin: float = MARGIN) -> float:
    """Return the p-value that the mean of (n,) differences lies outside +-`margin`.

    Two one-sided t tests (Schuirmann 1987): the larger of their p-values.

    Raises:
        DataError: there are fewer than two robots, or a difference is not finite.
    """
    from scipy import stats  # slow, and few commands test

    values = _checked(differences)
    if np.ptp(values) < ROUNDING:
        return 0.0 if abs(values[0]) < margin else 1.0
    above = stats.ttest_1samp(values, -margin, alternative="greater").pvalue
    below = stats.ttest_1samp(values, margin, alternative="less").pvalue
    return float(max(above, below))


def without_one(logs: ArrayLike) -> FloatArray:
    """Return the (n,) geometric mean ratios that n robots give when each is left out once.

    Raises:
        DataError: there are fewer than two robots, or a logarithm is not finite.
    """
    values = _checked(logs)
    return np.asarray(np.exp((values.sum() - values) / (len(values) - 1)))


def _checked(numbers: ArrayLike) -> FloatArray:
    values = frozen_array(numbers, "robots", (None,))
    if len(values) < 2:
        raise DataError(f"a mean over robots needs at least 2, there are {len(values)}")
    return values
