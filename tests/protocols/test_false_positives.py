"""How often is a difference found between two models that are equal? Counted, not derived.

In each of many simulated data sets of 151 poses the truth is linear in ten features, which all
count alike. Model A sees the first five alone, model B the others; both are least squares. What one
of them leaves out is noise to it, and the two exchange places when the features do: their expected
errors are equal over data sets of this kind, by construction. The data are divided by the product's
own repeated 80/20 holdout, by pose, and the p-values are the product's own.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from stiff_protocols.paired import LEVEL, corrected_t
from stiff_protocols.protocol import Holdout
from stiff_protocols.types import Samples

N_POSES = 151
FEATURES = 5  # of each model
NOISE = 0.3  # of the truth's standard deviation
ALLOWED = 0.06
N_DRAWS = 40  # sets of splits; the data sets of one of them share it
N_DATASETS = 500  # of each draw: 20 000 in all


def drawn_test_rows(n_splits, seed):
    """Return (J, t): the test rows of the product's splits of 151 poses, one row each."""
    zeros, names = np.zeros((N_POSES, 6)), np.arange(N_POSES).astype(str)
    samples = Samples(zeros, zeros, zeros[:, :3], names, names, names)
    splits = Holdout().splits(samples, n_splits=n_splits, seed=seed)
    assert all(len(s.train) + len(s.validation) + len(s.test) == N_POSES for s in splits)
    return np.array([split.test for split in splits])


def simulated(rng, n_datasets, n_poses=N_POSES):
    """Return features (2, n, poses, 5) of A and of B, and targets (n, poses)."""
    features = rng.normal(size=(2, n_datasets, n_poses, FEATURES))
    truth = features.sum(axis=(0, 3)) / np.sqrt(2 * FEATURES)
    return features, truth + NOISE * rng.normal(size=truth.shape)


def errors_on(features, target, rows):
    """Return (n, J, t) absolute errors on the test rows (J, t) of least squares on the others."""
    tested, aim = features[:, rows], target[:, rows]
    across = np.swapaxes(features, -1, -2)
    tested_across = np.swapaxes(tested, -1, -2)
    gram = (across @ features)[:, None] - tested_across @ tested
    moment = (across @ target[..., None])[:, None] - tested_across @ aim[..., None]
    return np.abs(aim - (tested @ np.linalg.solve(gram, moment))[..., 0])


@pytest.fixture(scope="module")
def differences():
    """(draws, data sets, 15): MAE of A less MAE of B on each split's test part."""
    rng = np.random.default_rng(20261121)
    result = []
    for seed in range(N_DRAWS):
        rows = drawn_test_rows(15, seed)
        features, target = simulated(rng, N_DATASETS)
        a, b = (errors_on(one, target, rows).mean(axis=-1) for one in features)
        result.append(a - b)
    return np.array(result)


def rate_and_error(p_values):
    """Return the share of p-values below the level, and its Monte-Carlo standard error.

    Args:
        p_values: (draws, data sets); the draws are independent.
    """
    rates = (p_values < LEVEL).mean(axis=1)
    return rates.mean(), rates.std(ddof=1) / np.sqrt(len(rates))


def test_the_two_models_are_equal(differences):
    means = differences.mean(axis=2).ravel()
    assert abs(means.mean()) < 3 * means.std() / np.sqrt(means.size)
    assert means.std() > 0.01  # equal on average, not on every data set


@pytest.mark.parametrize("n_splits", [5, 15])
def test_the_corrected_t_finds_a_difference_between_equal_models_in_at_most_6_of_100(
    differences, n_splits
):
    p_values = [
        [corrected_t(splits, 31 / N_POSES).p_value for splits in draw]
        for draw in differences[:, :, :n_splits]
    ]
    rate, error = rate_and_error(np.array(p_values))
    print(f"corrected t, {n_splits} splits: {rate:.4f} +- {error:.4f}")
    assert rate + 2 * error < ALLOWED
    assert rate > 0.03  # a test that finds nothing would pass the line above


@pytest.mark.parametrize(("n_splits", "at_least"), [(5, 0.12), (15, 0.30)])
def test_the_naive_t_finds_one_far_more_often_and_ever_more_with_more_splits(
    differences, n_splits, at_least
):
    p_values = stats.ttest_1samp(differences[:, :, :n_splits], 0.0, axis=2).pvalue
    rate, error = rate_and_error(p_values)
    print(f"naive t, {n_splits} splits: {rate:.4f} +- {error:.4f}")
    assert rate - 2 * error > at_least
