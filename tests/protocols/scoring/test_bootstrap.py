"""The bootstrap over poses: what is drawn, what is held together, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.scoring.bootstrap import (
    bootstrap_difference,
    pose_differences,
    pose_errors,
    resampled_means,
)


def errors_of(column, poses=None):
    """One column of errors, each row a pose of its own unless `poses` says otherwise."""
    column = np.asarray(column, dtype=float)
    poses = np.arange(len(column)) if poses is None else poses
    return pose_errors([f"p{pose}" for pose in poses], column[:, None])


def standard_error(differences, counts):
    """Of the ratio sum(c d) / sum(c) over p independent poses, linearised."""
    mean = np.average(differences, weights=counts)
    return np.sqrt((counts**2 * (differences - mean) ** 2).sum()) / counts.sum()


def test_rows_of_a_pose_are_summed_wherever_they_stand():
    summed = pose_errors(["b", "a", "b", "b"], [[1, -10], [2, 20], [-3, 30], [5, 0]])
    assert summed.poses.tolist() == ["a", "b"]
    assert summed.counts.tolist() == [1, 3]
    np.testing.assert_array_equal(summed.totals, [[2, 20], [9, 40]])
    np.testing.assert_array_equal(summed.mean, [11 / 4, 60 / 4])  # of the rows, not of the poses


def test_the_interval_is_the_normal_one_where_poses_are_many(rng):
    a, b = np.abs(rng.normal(size=(2, 400, 3)))
    names = np.arange(400).astype(str)
    result = bootstrap_difference(pose_errors(names, a), pose_errors(names, b))
    np.testing.assert_allclose(result.mean, (a - b).mean(axis=0))
    for column in range(3):
        half = 1.96 * standard_error((a - b)[:, column], np.ones(400))
        assert result.high[column] - result.low[column] == pytest.approx(2 * half, rel=0.04)
        assert (result.low + result.high)[column] / 2 == pytest.approx(
            result.mean[column], abs=0.1 * half
        )


def test_the_number_of_rows_of_a_pose_is_drawn_with_it(rng):
    """Poses with many rows weigh more, and one of them missing costs more."""
    counts = rng.integers(1, 9, 300)
    poses = np.repeat(np.arange(300), counts)
    level = np.abs(rng.normal(size=300))
    a, b = errors_of(level[poses], poses), errors_of(np.ones(len(poses)), poses)
    result = bootstrap_difference(a, b)
    differences = pose_differences(a, b)[:, 0]
    assert result.mean[0] == pytest.approx(np.average(differences, weights=a.counts))
    wanted = 2 * 1.96 * standard_error(differences, a.counts)
    assert result.high[0] - result.low[0] == pytest.approx(wanted, rel=0.04)
    equal = 2 * 1.96 * standard_error(differences, np.ones(300))
    assert abs(wanted / equal - 1) > 0.1  # the check above tells the two apart


@pytest.mark.parametrize(
    "differences",
    [
        [0.0] * 20,
        [0.25] * 20,
        [5e-324, 0.0, 0.0, 0.0],
        [1e-320, 2e-320, 3e-320],
        [1e-110, 3e-110, 2e-110],  # their cubes are 0
        [1.0, 1.0, 1.0, 1.0, 1.0 + 2e-16, 1.0],
        [1.0, 1.0, 1.0, np.nextafter(1.0, 2.0)],
    ],
)
def test_differences_too_alike_for_bca_have_the_percentile_interval(differences):
    result = bootstrap_difference(errors_of(differences), errors_of(np.zeros(len(differences))))
    low, high = result.low[0], result.high[0]
    assert min(differences) <= low <= high <= max(differences)
    assert low <= result.mean[0] <= high


def test_what_cannot_be_compared_is_refused():
    a = errors_of([1.0, 2.0])
    for poses in ([0, 1, 2], [0, 1, 1]):
        with pytest.raises(DataError, match="the same poses, each equally often"):
            bootstrap_difference(a, errors_of([1.0, 2.0, 3.0], poses))
    with pytest.raises(DataError, match="columns"):
        bootstrap_difference(a, pose_errors(["p0", "p1"], np.ones((2, 3))))
    with pytest.raises(DataError, match="at least 2 poses"):
        bootstrap_difference(errors_of([1.0]), errors_of([2.0]))
    with pytest.raises(DataError, match="at least 1 row"):
        pose_errors([], np.empty((0, 3)))
    with pytest.raises(DataError, match="one pose for each of the 2 rows"):
        pose_errors(["p0"], [[1.0], [2.0]])
    with pytest.raises(DataError, match="is nan"):
        pose_errors(["p0"], [[np.nan]])
    with pytest.raises(ConfigError, match=r"confidence is 95"):
        bootstrap_difference(a, a, confidence=95)
    with pytest.raises(DataError, match="one column of errors, there are 3"):
        resampled_means([pose_errors(["p0", "p1"], np.ones((2, 3)))])
    with pytest.raises(DataError, match="at least 1 competitor"):
        resampled_means([])
    with pytest.raises(DataError, match="the same poses"):
        resampled_means([a, errors_of([1.0, 2.0, 3.0])])


def test_resampled_means_spread_as_means_of_poses_do_and_are_of_the_same_draws(rng):
    poses = np.repeat(np.arange(200), rng.integers(1, 5, 200))
    one = errors_of(rng.random(len(poses)), poses)
    means = resampled_means([one])
    assert means.shape == (2000, 1)
    wanted = standard_error(one.totals[:, 0] / one.counts, one.counts)
    assert means.mean() == pytest.approx(one.mean[0], abs=4 * wanted / np.sqrt(2000))
    assert means.std() == pytest.approx(wanted, rel=0.05)
    base = rng.random(30)
    means = resampled_means([errors_of(base), errors_of(base + 0.5)])
    np.testing.assert_allclose(means[:, 1] - means[:, 0], 0.5)
    assert np.ptp(means[:, 0]) > 0.1


@pytest.mark.parametrize("n_others", [0, 1, 7, 8, 9, 10])
def test_equal_competitors_have_equal_means_in_every_draw(rng, n_others):
    """With 7 to 10 others a plain matrix product rounds the first and the last differently."""
    twin = rng.random(37)
    others = [errors_of(10 + rng.random(37)) for _ in range(n_others)]
    means = resampled_means([errors_of(twin), *others, errors_of(twin)])
    np.testing.assert_array_equal(means[:, 0], means[:, -1])
