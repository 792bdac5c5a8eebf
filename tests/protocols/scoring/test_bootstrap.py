"""Check the bootstrap over poses: its draws, rows that stay together, refused input."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_protocols.contract.errors import DataError
from stiff_protocols.scoring.bootstrap import pose_errors, resampled_means


def standard_error(differences, counts):
    """Return the linearised standard error of sum(c d) / sum(c) over independent poses."""
    mean = np.average(differences, weights=counts)
    return np.sqrt((counts**2 * (differences - mean) ** 2).sum()) / counts.sum()


def test_rows_of_a_pose_are_summed_wherever_they_stand():
    sums = pose_errors(["b", "a", "b", "b"], [[1, -10], [2, 20], [-3, 30], [5, 0]])
    assert sums.poses.tolist() == ["a", "b"]
    assert sums.counts.tolist() == [1, 3]
    np.testing.assert_array_equal(sums.totals, [[2, 20], [9, 40]])
    np.testing.assert_array_equal(sums.mean, [11 / 4, 60 / 4])  # of the rows, not of the poses


def test_a_pose_that_no_row_was_tested_at_counts_none_and_has_no_difference():
    sums = pose_errors(["a", "b", "c"], [[4.0, 1.0], [2.0, 2.0], [6.0, 1.0]], rows=[2, 0, 2])
    assert sums.counts.tolist() == [1, 0, 2]
    np.testing.assert_array_equal(sums.totals, [[2, 2], [0, 0], [10, 2]])
    np.testing.assert_array_equal(sums.differences(0, 1), [0, 4])


def test_the_number_of_rows_of_a_pose_is_drawn_with_it(rng):
    """Poses with many rows weigh more, so a missing one changes the mean more."""
    counts = rng.integers(1, 9, 300)
    poses = np.repeat(np.arange(300), counts)
    level = np.abs(rng.normal(size=300))
    errors = pose_errors(poses, np.column_stack([level[poses], np.ones(len(poses))]))
    pose_differences, means = errors.differences(0, 1), resampled_means(errors)
    expected = standard_error(pose_differences, errors.counts)
    assert (means[:, 0] - means[:, 1]).std() == pytest.approx(expected, rel=0.05)
    unweighted = standard_error(pose_differences, np.ones(300))
    assert abs(expected / unweighted - 1) > 0.1  # the check above tells the two apart


def test_what_cannot_be_summed_is_refused():
    with pytest.raises(DataError, match="at least 1 row"):
        pose_errors([], np.empty((0, 3)))
    with pytest.raises(DataError, match="one pose for each of the 2 rows"):
        pose_errors(["p0"], [[1.0], [2.0]])
    with pytest.raises(DataError, match="is nan"):
        pose_errors(["p0"], [[np.nan]])


def test_resampled_means_spread_as_means_of_poses_do_and_are_of_the_same_draws(rng):
    poses = np.repeat(np.arange(200), rng.integers(1, 5, 200))
    errors = pose_errors(poses, rng.random((len(poses), 1)))
    means = resampled_means(errors)
    assert means.shape == (2000, 1)
    expected = standard_error(errors.totals[:, 0] / errors.counts, errors.counts)
    assert means.mean() == pytest.approx(errors.mean[0], abs=4 * expected / np.sqrt(2000))
    assert means.std() == pytest.approx(expected, rel=0.05)
    base = rng.random(30)
    means = resampled_means(pose_errors(np.arange(30), np.column_stack([base, base + 0.5])))
    np.testing.assert_allclose(means[:, 1] - means[:, 0], 0.5)
    assert np.ptp(means[:, 0]) > 0.1


def test_a_draw_without_a_tested_pose_has_no_mean():
    means = resampled_means(pose_errors(np.arange(3), [[1.0]], rows=[0]))
    assert set(means[~np.isnan(means)]) == {1.0} and np.isnan(means).any()


@pytest.mark.parametrize("n_others", [0, 1, 7, 8, 9, 10])
def test_equal_competitors_have_equal_means_in_every_draw(rng, n_others):
    """With 7 to 10 other columns a matrix product rounds the first and last differently."""
    twin = rng.random(37)
    other_errors = 10 + rng.random((37, n_others))
    means = resampled_means(pose_errors(np.arange(37), np.column_stack([twin, other_errors, twin])))
    np.testing.assert_array_equal(means[:, 0], means[:, -1])
