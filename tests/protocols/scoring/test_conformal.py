"""Check the coverage of split-conformal intervals, and their errors."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.base import BaseEstimator

from helpers.made_robots import planar_arm
from helpers.made_samples import samples_with
from stiff_protocols.contract.errors import ModelError, NotFittedError
from stiff_protocols.scoring.conformal import SplitConformal, calibration_samples_needed

ONE_ROW, TWO_ROWS = [(np.full((n, 6), 5.0), np.zeros((n, 6))) for n in (1, 2)]  # rows to predict
ROBOT = planar_arm(6, (0.0, 0.0, 1.0))


class RecordingZero(BaseEstimator):
    """Predict no deflection, and record the arguments of `fit`."""

    def fit(self, train, *, robot, validation=None, seed=0):
        self.given_ = train, validation, seed
        return self

    def predict(self, q, wrench):
        return np.zeros((len(q), 3))


def samples(deflection, poses=None):
    poses = np.arange(len(deflection)) if poses is None else poses
    q = np.repeat(poses[:, None].astype(float), 6, axis=1)
    return samples_with(q, np.zeros(q.shape), deflection, pose_id=poses.astype(str))


def fit_conformal(train, **options):
    return SplitConformal(RecordingZero(), **options).fit(train, robot=ROBOT, seed=3)


@pytest.mark.parametrize(("coverage", "n_poses"), [(0.9, 44), (0.75, 20)])
def test_a_new_sample_lies_inside_as_often_as_exchangeability_promises(rng, coverage, n_poses):
    """The k-th smallest of n errors has k/(n+1) of a uniform distribution below it."""
    inside = []
    for _ in range(100):
        model = fit_conformal(samples(rng.uniform(-1, 1, (n_poses, 3))), coverage=coverage)
        interval = model.predict_interval(*ONE_ROW, coverage)
        inside.append(interval.upper[0])  # of |error| uniform on 0..1: the probability itself
    n = len(model.residuals_)
    noise = 3 * np.std(inside) / np.sqrt(len(inside) * 3)
    assert coverage - noise <= np.mean(inside) <= coverage + 1 / (n + 1) + noise
    assert np.mean(inside) == pytest.approx(np.ceil(coverage * (n + 1)) / (n + 1), abs=noise)


def test_a_sample_of_a_new_pose_lies_inside_although_errors_of_one_pose_are_alike(rng):
    """All rows of a pose have the same error, so 8 rows per pose add nothing to one."""
    inside = []
    for _ in range(100):
        error = np.repeat(rng.uniform(-1, 1, (12, 3)), 8, axis=0)
        model = fit_conformal(samples(error, np.repeat(np.arange(12), 8)), coverage=0.8)
        assert len(model.residuals_) == 4
        inside.append(model.predict_interval(*ONE_ROW, 0.8).upper[0])
    assert np.mean(inside) == pytest.approx(0.8, abs=3 * np.std(inside) / np.sqrt(300))


def test_the_interval_is_the_kth_smallest_error_about_the_copys_prediction(rng):
    model = fit_conformal(samples(rng.normal(size=(42, 3))))
    assert len(model.residuals_) == 11  # a quarter of 42, rounded up; 0.9 needs 9
    interval = model.predict_interval(*TWO_ROWS, 0.9)
    largest = np.sort(model.residuals_, axis=0)[10]  # ceil(0.9 * 12) = 11
    np.testing.assert_allclose(interval.upper, [largest, largest], rtol=1e-15)
    np.testing.assert_array_equal(interval.lower, -interval.upper)
    narrow_interval = model.predict_interval(*ONE_ROW, 0.5)
    np.testing.assert_array_equal(narrow_interval.upper[0], np.sort(model.residuals_, axis=0)[5])


def test_no_pose_both_teaches_and_calibrates_and_validation_rows_only_validate(rng):
    deflection = rng.normal(size=(60, 3))
    train = samples(deflection, np.repeat(np.arange(20), 3))
    validation = samples(rng.normal(size=(4, 3)) + 100.0)
    template = RecordingZero()
    model = SplitConformal(template).fit(train, robot=ROBOT, validation=validation, seed=3)
    train_rows, validation_rows, seed = model.model_.given_
    assert validation_rows is validation and seed == 3
    errors = {tuple(row) for row in np.abs(train_rows.deflection).tolist()}
    calibration_errors = {tuple(row) for row in model.residuals_.tolist()}
    assert (
        len(train_rows) == 3 * 11 and len(calibration_errors) == 9
    )  # one row of each of the 9 other poses
    assert not errors & calibration_errors
    assert calibration_errors <= {tuple(row) for row in np.abs(deflection).tolist()}
    assert not hasattr(template, "given_")  # a copy was fitted


@pytest.mark.parametrize(
    ("coverage", "needed"), [(0.5, 1), (0.8, 4), (0.9, 9), (0.95, 19), (0.99, 99), (0.91, 11)]
)
def test_a_finite_interval_needs_c_over_1_minus_c_samples(rng, coverage, needed):
    assert calibration_samples_needed(coverage) == needed
    model = fit_conformal(samples(rng.normal(size=(2 * needed, 3))), coverage=coverage)
    assert len(model.residuals_) == needed  # half of the poses, where a quarter is too few
    model.predict_interval(*ONE_ROW, coverage)  # is finite
    with pytest.raises(ModelError, match=f"needs at least {needed} calibration samples"):
        fit_conformal(samples(rng.normal(size=(2 * needed - 1, 3))), coverage=coverage)


def test_intervals_of_no_fit_of_more_coverage_and_of_nan_are_refused(rng):
    class Nowhere(RecordingZero):
        def predict(self, q, wrench):
            return np.full((len(q), 3), np.nan)

    train = samples(rng.normal(size=(42, 3)))
    with pytest.raises(NotFittedError, match="call fit"):
        SplitConformal(RecordingZero()).predict_interval(*ONE_ROW, 0.9)
    with pytest.raises(ModelError, match="not finite"):
        SplitConformal(Nowhere()).fit(train, robot=ROBOT)
    with pytest.raises(ModelError, match=r"0\.95 needs at least 19 calibration samples, there are"):
        fit_conformal(train).predict_interval(*ONE_ROW, 0.95)
