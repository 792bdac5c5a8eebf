"""Is A better than B on one data set? Tests on paired differences, error(A) - error(B).

A negative difference means that A is better. The test sets of repeated splits overlap, and so do
their training sets: J splits are not J independent measurements. The corrected t test takes that
into account; the plain t test does not, and finds differences between equal models
(tests/protocols/scoring/test_false_positives.py counts how often each does).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.types import FloatArray, frozen_array

ROPE_M = 1e-5
"""Region of practical equivalence, m: 0.01 mm, the repeatability of an optical tracker."""
LEVEL = 0.05
"""Probability of a false positive that a test allows."""
MOST_EXACT = 50
"""Most differences for which the signed-rank test's p-value is exact: 2^50 signs."""


def check_share(name: str, value: float) -> None:
    """Raise ConfigError where a confidence, a level or a part does not lie between 0 and 1."""
    if not 0.0 < value < 1.0:
        raise ConfigError(f"{name} is {value:g}, expected a number between 0 and 1")


@dataclass(frozen=True)
class Posterior:
    """Probabilities that A, neither or B is better by more than a region of equivalence; sum 1."""

    a_better: float
    equivalent: float
    b_better: float


@dataclass(frozen=True)
class CorrectedT:
    """Student t distribution of the mean difference of two models over repeated splits.

    It is read in two ways: as the test of Nadeau and Bengio (2003, Inference for the generalization
    error), and as the posterior of the Bayesian correlated t test (Corani and Benavoli 2015;
    Benavoli et al. 2017, Time for a change), which has the same mean, scale and degrees of freedom.

    Attributes:
        mean: mean difference, error(A) - error(B), m.
        scale: of the Student t, m; 0 where all differences are equal.
        df: its degrees of freedom, the number of splits less one.
        test_share: part of the samples (0..1) that each split tests on; it is the correlation that
            the test assumes between the differences of two splits.
    """

    mean: float
    scale: float
    df: int
    test_share: float

    def interval(self, confidence: float = 1.0 - LEVEL) -> tuple[float, float]:
        """Return the bounds of the mean difference, m."""
        from scipy import special  # slow, and help pages do without

        check_share("confidence", confidence)
        half = self.scale * float(special.stdtrit(self.df, 0.5 + 0.5 * confidence))
        return self.mean - half, self.mean + half

    @property
    def p_value(self) -> float:
        """Two-sided p-value of "the mean difference is zero".

        It is 0 if all differences are equal and not zero, because equal splits have no spread. An
        example is models that ignore their training set, on splits with the same test rows. A
        verdict also needs the interval over poses.
        """
        from scipy import special  # slow, and help pages do without

        if self.scale == 0.0:
            return 1.0 if self.mean == 0.0 else 0.0
        return 2.0 * float(special.stdtr(self.df, -abs(self.mean) / self.scale))

    def probability_below(self, value: float) -> float:
        """Return the probability that the mean difference is smaller than `value` [m]."""
        from scipy import special  # slow, and help pages do without

        if self.scale == 0.0:
            return float(self.mean < value)
        return float(special.stdtr(self.df, (value - self.mean) / self.scale))

    def posterior(self, rope: float = ROPE_M) -> Posterior:
        """Return the probabilities that A is better, that both are equal, that B is better.

        `rope` is the largest difference that is negligible in practice, m; ConfigError if it is
        negative or not a number.
        """
        if not rope >= 0.0:
            raise ConfigError(f"equivalence region is {rope:g} m, expected 0 or more")
        a_better = self.probability_below(-rope)
        mirrored = CorrectedT(-self.mean, self.scale, self.df, self.test_share)
        b_better = mirrored.probability_below(-rope)  # not 1 - ...: a small one keeps its digits
        return Posterior(a_better, max(0.0, 1.0 - a_better - b_better), b_better)


def corrected_t(differences: ArrayLike, test_share: float) -> CorrectedT:
    """Return the corrected t of (J,) differences [m] of repeated splits of a data set.

    The variance of their mean is (1/J + n_test/n_train) s^2 for J splits (Nadeau and Bengio 2003,
    equation 19 and below), with n_test/n_train = test_share / (1 - test_share).

    Raises:
        DataError: there are fewer than two differences, or one is not a finite number.
        ConfigError: `test_share` does not lie between 0 and 1.
    """
    values = frozen_array(differences, "differences", (None,))  # (J,) m
    check_share("test_share", test_share)
    n_splits = len(values)
    if n_splits < 2:
        there = "there is 1" if n_splits else "there are none"
        raise DataError(f"the corrected t test needs at least 2 splits, {there}")
    mean, scale = _mean_and_scale(values, test_share)
    return CorrectedT(float(mean), float(scale), n_splits - 1, test_share)


def _mean_and_scale(differences: FloatArray, test_share: float) -> tuple[FloatArray, FloatArray]:
    """Return mean and scale of the corrected t of (J, ...) differences, both (...), m."""
    factor = 1.0 / len(differences) + test_share / (1.0 - test_share)
    scale = np.sqrt(factor) * differences.std(axis=0, ddof=1)
    # the mean of equal numbers may be off by its rounding
    are_equal = np.ptp(differences, axis=0) == 0.0
    mean = np.where(are_equal, differences[0], differences.mean(axis=0))
    return mean, np.where(are_equal, 0.0, scale)


def corrected_t_p_values(differences: FloatArray, test_share: float) -> FloatArray:
    """Return the (k,) p-values of the corrected t tests of k columns of (J, k) differences [m].

    Same values as `corrected_t`, thousands at once; there are at least two splits.
    """
    from scipy import special  # slow, and help pages do without

    mean, scale = _mean_and_scale(differences, test_share)
    without_spread = np.where(mean == 0.0, 0.0, -np.inf)
    t_values = np.divide(-np.abs(mean), scale, out=without_spread, where=scale > 0.0)
    return np.asarray(2.0 * special.stdtr(len(differences) - 1, t_values))


def wilcoxon_signed_rank(differences: ArrayLike) -> float:
    """Return the two-sided p-value that (p,) differences [m] are symmetric about zero.

    They must be independent: one per pose (`bootstrap.pose_differences`), never one per row or per
    split. The fitted models are fixed, so the result does not cover other training sets. Zeros are
    omitted (Wilcoxon 1945), and equal sizes share their mean rank. Up to `MOST_EXACT` nonzero
    differences the p-value is exact, over all possible signs; else it is the normal approximation.

    Raises:
        DataError: `differences` is empty, or contains a number that is not finite.
    """
    from scipy import stats  # slow, and few commands test

    values = frozen_array(differences, "differences", (None,))
    if not len(values):
        raise DataError("the signed-rank test needs at least 1 difference, there are none")
    values = values[values != 0.0]
    if not len(values):
        return 1.0
    if len(values) > MOST_EXACT:
        return float(stats.wilcoxon(values, method="approx").pvalue)
    doubled_ranks = np.rint(2.0 * stats.rankdata(np.abs(values))).astype(int)  # halves become whole
    ways = _ways_to_sum(tuple(np.sort(doubled_ranks).tolist()))
    positive = int(doubled_ranks[values > 0.0].sum())
    tail = ways[: min(positive, len(ways) - 1 - positive) + 1].sum()
    return min(1.0, float(2.0 * tail / 2.0 ** len(values)))


@lru_cache
def _ways_to_sum(ranks: tuple[int, ...]) -> FloatArray:
    """Return the number of the 2^n choices of signs for each sum of positive ranks, from 0 on.

    scipy counts only without ties. Many pairs of models have the same ranks.
    """
    ways = np.zeros(sum(ranks) + 1)
    ways[0] = 1.0
    for rank in ranks:
        ways[rank:] += ways[:-rank]
    ways.setflags(write=False)
    return ways


def holm(p_values: ArrayLike) -> FloatArray:
    """Return the (m,) p-values (0..1) after Holm's (1979) step-down correction.

    statsmodels' function collects garbage in each call, which takes longer than all the rest of a
    leaderboard; the tests compare with it.
    """
    values = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(values)
    steps = np.arange(len(values), 0, -1) * values[order]
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted
