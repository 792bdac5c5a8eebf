"""Check paired tests on one data set against closed forms and other libraries."""

from __future__ import annotations

import math

import baycomp
import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.multitest import multipletests

from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.scoring.paired import (
    ROPE_M,
    CorrectedT,
    Posterior,
    corrected_t,
    holm,
    wilcoxon_signed_rank,
)

MM = 1e-3


def below_with_4_degrees(t):
    """Return Student's t distribution function for 4 degrees of freedom, in closed form."""
    u = t / math.sqrt(1 + t**2 / 4)
    return 0.5 + 0.375 * u * (1 - u**2 / 12)


def test_the_corrected_t_is_the_one_computed_by_hand():
    """Five splits, variance 2.5, n_test/n_train 1/4: scale^2 = (1/5 + 1/4) 2.5 = 1.125."""
    result = corrected_t(np.array([1.0, 2.0, 3.0, 4.0, 5.0]) * MM, 0.2)
    assert result.mean == pytest.approx(3 * MM)
    assert result.scale == pytest.approx(math.sqrt(1.125) * MM)
    assert result.df == 4
    assert result.p_value == pytest.approx(2 * (1 - below_with_4_degrees(3 / math.sqrt(1.125))))
    assert result.probability_below(2 * MM) == pytest.approx(
        below_with_4_degrees(-1 / math.sqrt(1.125))
    )


@pytest.mark.parametrize(("folds", "runs"), [(5, 1), (5, 3), (10, 10)])
@pytest.mark.parametrize("shift", [-2e-5, 0.0, 1e-5])
def test_the_posterior_is_that_of_baycomp(rng, folds, runs, shift):
    error_a, error_b = rng.normal(3e-4, 2e-5, (2, folds * runs))
    error_a += shift
    expected = baycomp.CorrelatedTTest.probs(error_b, error_a, rope=ROPE_M, runs=runs)
    posterior = corrected_t(error_a - error_b, 1 / folds).posterior()
    assert (posterior.a_better, posterior.equivalent, posterior.b_better) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("difference", "p_value", "posterior"),
    [
        (0.0, 1.0, Posterior(0.0, 1.0, 0.0)),
        (ROPE_M / 3, 0.0, Posterior(0.0, 1.0, 0.0)),
        (0.1 * MM, 0.0, Posterior(0.0, 0.0, 1.0)),  # the mean of seven differs by rounding
        (-0.1 * MM, 0.0, Posterior(1.0, 0.0, 0.0)),
    ],
)
def test_equal_differences_leave_no_doubt(difference, p_value, posterior):
    result = corrected_t([difference] * 7, 0.2)
    assert result.scale == 0.0
    assert result.p_value == p_value
    assert result.posterior() == posterior
    assert result.interval() == (difference, difference)


def test_a_small_probability_keeps_its_digits():
    """1 - (1 - 1e-20) would be 0."""
    far = CorrectedT(mean=-1.0, scale=1e-6, df=14, test_share=0.2)
    assert 0.0 < far.posterior().b_better < 1e-50
    assert far.posterior().a_better == 1.0


@pytest.mark.parametrize(
    ("differences", "message"),
    [
        ([], "at least 2 splits, there are none"),
        ([1.0], "the corrected t test needs at least 2 splits, there is 1"),
        ([1.0, np.nan], r"differences\[1\] is nan"),
        ([[1.0, 2.0]], "shape"),
    ],
)
def test_differences_that_cannot_be_tested_are_refused(differences, message):
    with pytest.raises(DataError, match=message):
        corrected_t(differences, 0.2)


def test_shares_outside_0_and_1_and_a_negative_rope_are_refused_by_name():
    for share in (0.0, 1.0, -0.2, np.nan):
        with pytest.raises(ConfigError, match="test_share is"):
            corrected_t([1.0, 2.0], share)
        with pytest.raises(ConfigError, match="confidence is"):
            corrected_t([1.0, 2.0], 0.2).interval(share)
    for rope in (-1e-5, np.nan):
        with pytest.raises(ConfigError, match="equivalence region is"):
            corrected_t([1.0, 2.0], 0.2).posterior(rope)


@pytest.mark.parametrize("n", [1, 2, 5, 12, 15, 30, 50])
def test_without_ties_the_signed_rank_test_is_scipys_exact_one(rng, n):
    differences = rng.normal(0.4, 1.0, n)
    expected = stats.wilcoxon(differences, method="exact").pvalue
    assert wilcoxon_signed_rank(differences) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    "differences",
    [
        [1, 1, 1, 1, 1],
        [1, -1, 2, 2, 3],
        [2, 2, -1, 0, 3, 3, 3, 0],
        [-1, 1, -2, 2, 3, 4, 4, 5, 5, -5],
    ],
)
def test_with_ties_and_zeros_the_signed_rank_test_counts_all_signs(differences):
    method = stats.PermutationMethod(n_resamples=2**12)  # more than there are: it counts
    nonzero_differences = [value for value in differences if value]
    expected = stats.wilcoxon(nonzero_differences, method=method).pvalue
    assert wilcoxon_signed_rank(differences) == pytest.approx(expected)


def test_beyond_fifty_differences_the_signed_rank_test_is_close_to_the_count(rng):
    differences = rng.normal(0.2, 1.0, 51)
    expected = stats.wilcoxon(differences, method="exact").pvalue
    assert wilcoxon_signed_rank(differences) == pytest.approx(expected, rel=0.05)


def test_differences_of_zero_say_nothing_to_the_signed_rank_test():
    assert wilcoxon_signed_rank(np.zeros(30)) == 1.0
    p_value = wilcoxon_signed_rank(np.array([1, 2, 3, 4, 5, 6]) * MM)
    assert wilcoxon_signed_rank(np.array([1, 2, 0, 3, 4, 5, 6, 0]) * MM) == pytest.approx(p_value)
    with pytest.raises(DataError, match="at least 1 difference"):
        wilcoxon_signed_rank([])


def test_holm_agrees_with_statsmodels(rng):
    p_values = rng.uniform(size=30) ** 4
    np.testing.assert_allclose(holm(p_values), multipletests(p_values, method="holm")[1])
