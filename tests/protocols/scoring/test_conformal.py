"""Split-conformal intervals: how often they hold a new sample, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.base import BaseEstimator

from helpers.made_samples import samples_with
from stiff_protocols.contract.errors import ModelError, NotFittedError
from stiff_protocols.scoring.conformal import SplitConformal, calibration_samples_needed

ONE, TWO = [(np.full((n, 6), 5.0), np.zeros((n, 6))) for n in (1, 2)]  # rows to predict


class Rest(BaseEstimator):
    """Predicts no deflection, and remembers what it was given."""

    def fit(self, train, *, robot, validation=None, seed=0):
        self.given_ = train, validation, seed
        return self

    def predict(self, q, wrench):
        return np.zeros((len(q), 3))


def samples(deflection, poses=None):
    poses = np.arange(len(deflection)) if poses is None else poses
    q = np.repeat(poses[:, None].astype(float), 6, axis=1)
    return samples_with(q, np.zeros(q.shape), deflection, pose_id=poses.astype(str))


def fitted(train, **options):
    return SplitConformal(Rest(), **options).fit(train, robot=None, seed=3)


@pytest.mark.parametrize(("coverage", "n_poses"), [(0.9, 44), (0.75, 20)])
def test_a_new_sample_lies_inside_as_often_as_exchangeability_promises(rng, coverage, n_poses):
    """The k-th smallest of n errors has k/(n+1) of a uniform distribution below it."""
    inside = []
    for _ in range(100):
        model = fitted(samples(rng.uniform(-1, 1, (n_poses, 3))), coverage=coverage)
        interval = model.predict_interval(*ONE, coverage)
        inside.append(interval.upper[0])  # of |error| uniform on 0..1: the probability itself
    n = len(model.residuals_)
    noise = 3 * np.std(inside) / np.sqrt(len(inside) * 3)
    assert coverage - noise <= np.mean(inside) <= coverage + 1 / (n + 1) + noise
    assert np.mean(inside) == pytest.approx(np.ceil(coverage * (n + 1)) / (n + 1), abs=noise)


def test_a_sample_of_a_new_pose_lies_inside_although_errors_of_one_pose_are_alike(rng):
    """All rows of a pose are equally wrong: 8 rows a pose tell no more than one."""
    inside = []
    for _ in range(100):
        error = np.repeat(rng.uniform(-1, 1, (12, 3)), 8, axis=0)
        model = fitted(samples(error, np.repeat(np.arange(12), 8)), coverage=0.8)
        assert len(model.residuals_) == 4
        inside.append(model.predict_interval(*ONE, 0.8).upper[0])
    assert np.mean(inside) == pytest.approx(0.8, abs=3 * np.std(inside) / np.sqrt(300))


def test_the_interval_is_the_kth_smallest_error_about_the_copys_prediction(rng):
    model = fitted(samples(rng.normal(size=(42, 3))))
    assert len(model.residuals_) == 11  # a quarter of 42, rounded up; 0.9 needs 9
    interval = model.predict_interval(*TWO, 0.9)
    largest = np.sort(model.residuals_, axis=0)[10]  # ceil(0.9 * 12) = 11
    np.testing.assert_allclose(interval.upper, [largest, largest], rtol=1e-15)
    np.testing.assert_array_equal(interval.lower, -interval.upper)
    half = model.predict_interval(*ONE, 0.5)
    np.testing.assert_array_equal(half.upper[0], np.sort(model.residuals_, axis=0)[5])


def test_no_pose_both_teaches_and_calibrates_and_validation_rows_only_validate(rng):
    deflection = rng.normal(size=(60, 3))
    train = samples(deflection, np.repeat(np.arange(20), 3))
    validation = samples(rng.normal(size=(4, 3)) + 100.0)
    given = Rest()
    model = SplitConformal(given).fit(train, robot=None, validation=validation, seed=3)
    learned, validated, seed = model.model_.given_
    assert validated is validation and seed == 3
    errors = {tuple(row) for row in np.abs(learned.deflection).tolist()}
    calibrated = {tuple(row) for row in model.residuals_.tolist()}
    assert len(learned) == 3 * 11 and len(calibrated) == 9  # one row of each of the 9 other poses
    assert not errors & calibrated
    assert calibrated <= {tuple(row) for row in np.abs(deflection).tolist()}
    assert not hasattr(given, "given_")  # a copy was fitted


@pytest.mark.parametrize(
    ("coverage", "needed"), [(0.5, 1), (0.8, 4), (0.9, 9), (0.95, 19), (0.99, 99), (0.91, 11)]
)
def test_a_finite_interval_needs_c_over_1_minus_c_samples(rng, coverage, needed):
    assert calibration_samples_needed(coverage) == needed
    model = fitted(samples(rng.normal(size=(2 * needed, 3))), coverage=coverage)
    assert len(model.residuals_) == needed  # half of the poses, where a quarter is too few
    model.predict_interval(*ONE, coverage)  # is finite
    with pytest.raises(ModelError, match=f"needs at least {needed} calibration samples"):
        fitted(samples(rng.normal(size=(2 * needed - 1, 3))), coverage=coverage)


def test_intervals_of_no_fit_of_more_coverage_and_of_nan_are_refused(rng):
    class Nowhere(Rest):
        def predict(self, q, wrench):
            return np.full((len(q), 3), np.nan)

    train = samples(rng.normal(size=(42, 3)))
    with pytest.raises(NotFittedError, match="call fit"):
        SplitConformal(Rest()).predict_interval(*ONE, 0.9)
    with pytest.raises(ModelError, match="not finite"):
        SplitConformal(Nowhere()).fit(train, robot=None)
    with pytest.raises(ModelError, match=r"0\.95 needs at least 19 calibration samples, there are"):
        fitted(train).predict_interval(*ONE, 0.95)
