"""Ranks over data sets: against Demsar's worked example, textbook formulas, and axioms."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy import stats

from stiff_protocols.contract.errors import DataError
from stiff_protocols.scoring.paired import LEVEL, ranked
from stiff_protocols.scoring.ranks import compare_over_datasets, why_not

DEMSAR_TABLE_6 = """
0.763 0.768 0.771 0.798
0.599 0.591 0.590 0.569
0.954 0.971 0.968 0.967
0.628 0.661 0.654 0.657
0.882 0.888 0.886 0.898
0.936 0.931 0.916 0.931
0.661 0.668 0.609 0.685
0.583 0.583 0.563 0.625
0.775 0.838 0.866 0.875
1.000 1.000 1.000 1.000
0.940 0.962 0.965 0.962
0.619 0.666 0.614 0.669
0.972 0.981 0.9751 0.975
0.957 0.978 0.946 0.970
"""  # area under the curve: larger is better; the 0.9751 is printed as 0.975, but ranked before it


NO_ROBOTS = "splits of one data set, and several data sets of one robot, do not count"


def scores(rng, n_datasets=9, n_models=5, apart=0.6):
    return rng.normal(size=(n_datasets, n_models)) + apart * np.arange(n_models)


def test_demsars_example_gives_his_mean_ranks_and_critical_difference():
    areas = np.array(DEMSAR_TABLE_6.split(), dtype=float).reshape(14, 4)
    result = compare_over_datasets(-areas)
    np.testing.assert_allclose(result.mean_ranks, [3.143, 2.000, 2.893, 1.964], atol=5e-4)
    assert result.critical_difference == pytest.approx(1.25, abs=0.005)
    assert result.groups == [(3, 1, 2, 0)]  # "not powerful enough" at 0.05
    assert result.friedman_p < LEVEL


@pytest.mark.parametrize("n_models", [3, 10, 40])
def test_critical_differences_and_p_values_are_those_of_scipy_and_scikit_posthocs(rng, n_models):
    scikit_posthocs = pytest.importorskip("scikit_posthocs")
    values = np.round(scores(rng, n_models=n_models, apart=0.1), 1)
    ranks = stats.rankdata(values, axis=1)
    result = compare_over_datasets(values)
    np.testing.assert_allclose(
        result.nemenyi, scikit_posthocs.posthoc_nemenyi_friedman(ranks), atol=1e-12
    )
    np.testing.assert_allclose(
        result.conover, scikit_posthocs.posthoc_conover_friedman(ranks, p_adjust="holm"), rtol=1e-9
    )
    assert result.friedman_p == pytest.approx(stats.friedmanchisquare(*ranks.T).pvalue, rel=1e-9)
    spread = np.sqrt(n_models * (n_models + 1) / (12 * len(values)))
    quantile = stats.studentized_range.ppf(1.0 - LEVEL, n_models, np.inf)
    assert result.critical_difference == pytest.approx(quantile * spread, rel=1e-9)


@pytest.mark.parametrize("shape", [(6,), (50, 7), (1, 1)])
def test_ranks_are_scipys_with_ties_and_missing_values(rng, shape):
    values = rng.integers(0, 4, shape).astype(float)
    np.testing.assert_array_equal(ranked(values), stats.rankdata(values, axis=-1))
    values[..., 0] = np.nan
    assert np.isnan(ranked(values)).all()


@pytest.mark.parametrize("apart", [0.0, 0.5, 1.0, 3.0])
def test_the_groups_hold_exactly_the_pairs_that_nemenyi_cannot_tell_apart(rng, apart):
    for _ in range(2):
        result = compare_over_datasets(scores(rng, n_models=6, apart=apart))
        alike = {
            frozenset(pair) for pair in combinations(range(6), 2) if result.nemenyi[pair] >= LEVEL
        }
        grouped = {frozenset(pair) for group in result.groups for pair in combinations(group, 2)}
        assert alike == grouped
        assert not any(set(a) <= set(b) for a in result.groups for b in result.groups if a != b)
        for group in result.groups:
            assert list(result.mean_ranks[list(group)]) == sorted(result.mean_ranks[list(group)])


def test_ranks_that_tie_or_agree_everywhere_leave_conover_no_verdict():
    result = compare_over_datasets(np.ones((6, 4)))
    np.testing.assert_array_equal(result.mean_ranks, 2.5)
    assert result.friedman_p == 1.0
    np.testing.assert_array_equal(result.nemenyi, 1.0)
    assert result.conover is None
    assert result.groups == [(0, 1, 2, 3)]
    values = np.tile([1.0, 1.0, 2.0, 3.0], (7, 1))
    result = compare_over_datasets(values)
    assert result.conover is None
    values[0, 2:] = 3.0, 2.0
    assert compare_over_datasets(values).conover is not None
    assert 0.0 < result.nemenyi[0, 3] < LEVEL


@pytest.mark.parametrize(
    ("n_datasets", "n_models", "reason"),
    [
        (5, 3, ""),
        (12, 9, ""),
        (2, 9, f"needs at least 5 data sets of different robots, here are 2: {NO_ROBOTS}"),
        (1, 2, f"needs at least 5 data sets of different robots, here is 1: {NO_ROBOTS}"),
        (5, 2, "needs at least 3 models, here are 2"),
    ],
)
def test_too_few_data_sets_or_models_are_refused_with_the_reason(n_datasets, n_models, reason, rng):
    assert why_not(n_datasets, n_models) == reason
    if reason:
        with pytest.raises(DataError, match=f"the critical-difference analysis {reason}"):
            compare_over_datasets(scores(rng, n_datasets, n_models))


def test_missing_scores_are_refused(rng):
    values = scores(rng)
    values[3, 1] = np.nan
    with pytest.raises(DataError, match=r"scores\[3, 1\] is nan"):
        compare_over_datasets(values)
