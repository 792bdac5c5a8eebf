"""The bootstrap over poses: what is drawn, what is held together, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

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


def test_the_difference_of_a_pose_is_that_of_its_mean_errors():
    a = errors_of([1.0, 2.0, 6.0], [0, 1, 1])
    b = errors_of([0.5, -2.0, 3.0], [0, 1, 1])
    np.testing.assert_allclose(pose_differences(a, b), [[0.5], [1.5]])


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


def test_repeating_the_rows_of_every_pose_tells_nothing_new(rng):
    a, b = np.abs(rng.normal(size=(2, 30)))
    once = bootstrap_difference(errors_of(a), errors_of(b))
    poses = np.repeat(np.arange(30), 8)
    eight = bootstrap_difference(errors_of(a[poses], poses), errors_of(b[poses], poses))
    np.testing.assert_allclose([eight.low, eight.high], [once.low, once.high])


def test_what_poses_have_in_common_for_both_models_is_not_in_the_interval(rng):
    hard = 100 * rng.random(50)  # some poses are hard for everybody
    result = bootstrap_difference(errors_of(hard + 1), errors_of(hard + rng.random(50)))
    assert 0.3 < result.low[0] < result.mean[0] < result.high[0] < 0.7


def test_exchanging_the_models_mirrors_the_interval(rng):
    a, b = (errors_of(np.exp(rng.normal(size=40))) for _ in range(2))
    one, other = bootstrap_difference(a, b), bootstrap_difference(b, a)
    np.testing.assert_allclose(one.low, -other.high, rtol=1e-9)
    np.testing.assert_allclose(one.high, -other.low, rtol=1e-9)


def test_the_interval_reaches_farther_where_the_errors_do(rng):
    """BCa shifts it by (2 z^2 + 1)/6 skewness/sqrt(n) standard errors; percentiles by a third."""
    n = 60
    errors = rng.exponential(size=n)
    result = bootstrap_difference(errors_of(errors), errors_of(np.zeros(n)))
    shift = (result.low + result.high)[0] / 2 - result.mean[0]
    wanted = (2 * 1.96**2 + 1) / 6 * stats.skew(errors) / np.sqrt(n)
    assert shift / standard_error(errors, np.ones(n)) == pytest.approx(wanted, rel=0.25)


def test_more_confidence_gives_a_wider_interval(rng):
    a, b = (errors_of(rng.random(40)) for _ in range(2))
    narrow, wide = (bootstrap_difference(a, b, confidence=c) for c in (0.5, 0.99))
    assert wide.low[0] < narrow.low[0] < narrow.high[0] < wide.high[0]


def test_the_same_seed_gives_the_same_interval_and_another_seed_another(rng):
    a, b = (errors_of(rng.random(20)) for _ in range(2))
    first, again, other = (bootstrap_difference(a, b, seed=seed) for seed in (1, 1, 2))
    assert first.low == again.low and first.high == again.high
    assert first.low != other.low


@pytest.mark.parametrize("shift", [0.0, 0.25])
def test_models_that_differ_alike_at_every_pose_have_no_width(shift):
    base = np.arange(1, 21) / 4
    result = bootstrap_difference(errors_of(base + shift), errors_of(base))
    assert (result.low[0], result.mean[0], result.high[0]) == (shift, shift, shift)


@pytest.mark.parametrize(
    "differences",
    [
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


@pytest.mark.parametrize("n_poses", [2, 3, 31])
@pytest.mark.parametrize("shape", ["rounding", "one pose", "heavy tail"])
def test_poor_differences_give_a_finite_interval_without_a_warning(rng, n_poses, shape):
    base = 1 + rng.random(n_poses)
    added = {
        "rounding": np.full(n_poses, 1e-5),  # constant but for the last digit
        "one pose": np.eye(n_poses)[0],
        "heavy tail": np.abs(rng.standard_t(1, size=n_poses)) ** 3,
    }[shape]
    result = bootstrap_difference(errors_of(base + added), errors_of(base))
    assert np.isfinite([result.low[0], result.high[0]]).all()
    assert result.low[0] <= result.high[0]


def test_models_of_different_poses_or_rows_are_refused():
    a = errors_of([1.0, 2.0])
    with pytest.raises(DataError, match="first is 'p2'"):
        bootstrap_difference(a, errors_of([1.0, 2.0, 3.0]))
    with pytest.raises(DataError, match="pose 'p1' has 1 rows of one model and 2 of the other"):
        bootstrap_difference(a, errors_of([1.0, 2.0, 3.0], [0, 1, 1]))
    with pytest.raises(DataError, match="columns"):
        bootstrap_difference(a, pose_errors(["p0", "p1"], np.ones((2, 3))))


def test_a_single_pose_and_no_row_are_refused():
    with pytest.raises(DataError, match="at least 2 poses"):
        bootstrap_difference(errors_of([1.0]), errors_of([2.0]))
    with pytest.raises(DataError, match="at least 1 row"):
        pose_errors([], np.empty((0, 3)))
    with pytest.raises(DataError, match="one pose for each of the 2 rows"):
        pose_errors(["p0"], [[1.0], [2.0]])
    with pytest.raises(DataError, match="is nan"):
        pose_errors(["p0"], [[np.nan]])


def test_a_confidence_outside_0_and_1_is_refused():
    a, b = errors_of([1.0, 2.0]), errors_of([2.0, 4.0])
    with pytest.raises(ConfigError, match=r"confidence is 95"):
        bootstrap_difference(a, b, confidence=95)


def test_resampled_means_spread_as_means_of_poses_do(rng):
    poses = np.repeat(np.arange(200), rng.integers(1, 5, 200))
    one = errors_of(rng.random(len(poses)), poses)
    means = resampled_means([one], resamples=4000)
    assert means.shape == (4000, 1)
    wanted = standard_error(one.totals[:, 0] / one.counts, one.counts)
    assert means.mean() == pytest.approx(one.mean[0], abs=4 * wanted / np.sqrt(4000))
    assert means.std() == pytest.approx(wanted, rel=0.05)


def test_all_competitors_get_the_same_draws(rng):
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


def test_means_are_of_one_direction_of_at_least_one_competitor(rng):
    with pytest.raises(DataError, match="one column of errors, there are 3"):
        resampled_means([pose_errors(["p0", "p1"], rng.random((2, 3)))])
    with pytest.raises(DataError, match="at least 1 competitor"):
        resampled_means([])
    with pytest.raises(DataError, match="only poses that both"):
        resampled_means([errors_of([1.0, 2.0]), errors_of([1.0, 2.0, 3.0])])
