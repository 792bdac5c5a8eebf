"""Check Gaussian processes and their likelihood against scikit-learn's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from stiff_models.regressors.gaussian_process import (
    Covariance,
    GaussianProcess,
    log_likelihood,
)
from stiff_models.regressors.gp_model import GaussianProcessModel, VjmGp
from stiff_models.regressors.regressor_model import NearestNeighbours
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.scoring.conformal import SplitConformal

N_ROWS, N_FEATURES = 40, 5


def rows_of(rng, n=N_ROWS):
    inputs = rng.normal(size=(n, N_FEATURES))
    return inputs, np.sin(inputs[:, 0]) + 0.5 * inputs[:, 1] + 0.1 * rng.normal(size=n)


def covariance_of(kernel, rng, *, shared, noise):
    lengths = 2.0 * np.exp(0.3 * rng.normal(size=1 if shared else N_FEATURES))
    return Covariance(kernel, 1.3, lengths, noise, jitter=1e-10)


def scikit_learn_process(covariance, inputs, outputs):
    """Return scikit-learn's process with the same fixed hyperparameters."""
    lengths = covariance.lengths if len(covariance.lengths) > 1 else covariance.lengths[0]
    shape = RBF(lengths) if covariance.kernel == "rbf" else Matern(lengths, nu=2.5)
    kernel = ConstantKernel(covariance.variance) * shape + WhiteKernel(covariance.noise)
    process = GaussianProcessRegressor(kernel, alpha=covariance.jitter, optimizer=None)
    return process.fit(inputs, outputs)


@pytest.mark.parametrize("kernel", ["matern", "rbf"])
@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("noise", [1e-6, 0.02])
def test_likelihood_gradient_and_predictions_are_scikit_learns(kernel, shared, noise, rng):
    covariance = covariance_of(kernel, rng, shared=shared, noise=noise)
    inputs, outputs = rows_of(rng)
    truth = scikit_learn_process(covariance, inputs, outputs)
    value, gradient = log_likelihood(covariance, inputs, outputs)
    expected = truth.log_marginal_likelihood(covariance.theta, eval_gradient=True)
    assert value == pytest.approx(expected[0], rel=1e-9)
    np.testing.assert_allclose(gradient, expected[1], rtol=1e-6, atol=1e-6)
    process = GaussianProcess.of(covariance, inputs, outputs)
    new_inputs = rows_of(rng, 2000)[0]  # more than a block of the covariance
    mean, deviation = truth.predict(new_inputs, return_std=True)
    np.testing.assert_allclose(process.mean(new_inputs), mean, atol=1e-8)
    np.testing.assert_allclose(process.deviation(new_inputs), deviation, atol=1e-7)
    _, joint_covariance = truth.predict(new_inputs[:9], return_cov=True)
    cross_covariance = process.between(new_inputs[:9], new_inputs[4:9]) + noise * np.eye(9)[:, 4:]
    np.testing.assert_allclose(cross_covariance, joint_covariance[:, 4:], atol=1e-8)


def is_in_range(training_range, samples):
    values = training_range.quantities(samples.q, samples.wrench)
    lower, upper = training_range.ends
    return ((lower <= values) & (values <= upper)).all(axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("model", [GaussianProcessModel, VjmGp])
def test_covariances_of_a_model_are_those_of_its_intervals(model, parts):
    robot, train, _, test = parts
    fitted = model(restarts=0).fit(train.take(np.arange(40)), robot=robot)
    assert offers(fitted, "covariance")
    inside_samples = test.take(np.flatnonzero(is_in_range(fitted.training_range_, test)))
    q, wrench = inside_samples.q[:6], inside_samples.wrench[:6]
    covariance = fitted.covariance(q, wrench, q, wrench)
    np.testing.assert_allclose(covariance, covariance.transpose(0, 2, 1), atol=1e-18)
    variance = np.diagonal(covariance, axis1=1, axis2=2).T + fitted.noise_variance()
    interval = fitted.predict_interval(q, wrench, 0.9)
    half = (interval.upper - interval.lower) / 2.0
    half /= fitted.training_range_.stretch(q, wrench)[:, None]
    np.testing.assert_allclose(ndtri(0.95) * np.sqrt(variance), half, rtol=1e-4)
    part_covariance = fitted.covariance(q, wrench, q[2:5], wrench[2:5])
    np.testing.assert_allclose(part_covariance, covariance[:, :, 2:5], atol=1e-18)


@pytest.mark.slow
@pytest.mark.parametrize("family", [GaussianProcessModel, VjmGp])
def test_the_noise_that_the_data_card_states_is_the_instruments(family, parts):
    robot, train, _, _ = parts
    some_samples = train.take(np.arange(12))
    noisy_samples = replace(some_samples, instrument_noise=4e-5)

    def noise(samples, **options):
        model = family(restarts=0, ard=False, **options).fit(samples, robot=robot)
        return model.instrument_noise_, np.sqrt(model.noise_variance())

    assert noise(some_samples)[0] == 1e-5
    instrument_noise, deviation = noise(noisy_samples)
    assert instrument_noise == 4e-5 and (deviation >= 0.999 * instrument_noise).all()
    assert (
        noise(noisy_samples, instrument_noise_mm=0.02)[0] == 2e-5
    )  # the option replaces the card's


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:joint stiffness not identifiable.* J6")  # of FANUC samples
def test_too_narrow_intervals_of_few_poses_are_widened_by_the_errors_on_left_out_poses(fanuc):
    samples, robot = fanuc.samples, fanuc.robot
    inside, uncalibrated_inside = [], []
    for part in range(4):
        tested = np.arange(len(samples)) % 4 == part
        train, test = (samples.take(np.flatnonzero(rows)) for rows in (~tested, tested))
        model = VjmGp(restarts=0).fit(train, robot=robot)
        error = np.abs(model.predict(test.q, test.wrench) - test.deflection)
        interval = model.predict_interval(test.q, test.wrench, 0.9)
        half = (interval.upper - interval.lower) / 2.0
        inside.append(error <= half)
        uncalibrated_inside.append(error <= half / model.calibration_)
    assert 0.85 <= np.vstack(inside).mean() <= 0.97
    assert np.vstack(uncalibrated_inside).mean() < 0.75


def five_times(train, test):
    return test.q, 5.0 * test.wrench


def sixty_degrees_off(train, test):
    """Move one joint per row beyond its smallest or largest training position, in turn."""
    q = test.q.copy()
    for row, joint in enumerate(np.arange(len(q)) % 6):
        positions, distance = train.q[:, joint], np.deg2rad(60.0)
        q[row, joint] = positions.max() + distance if row // 6 % 2 else positions.min() - distance
    return q, test.wrench


@pytest.mark.slow
@pytest.mark.parametrize("beyond", [five_times, sixty_degrees_off])
@pytest.mark.parametrize(
    "model",
    [
        GaussianProcessModel(restarts=0, ard=False),
        SplitConformal(NearestNeighbours()),
    ],
    ids=["gp", "knn"],
)
def test_intervals_hold_beyond_the_training_range(model, beyond, parts, twin):
    robot, train, _, test = parts
    fitted = clone(model).fit(train, robot=robot)
    near_interval = fitted.predict_interval(test.q, test.wrench, 0.9)
    q, wrench = beyond(train, test)
    far_interval, truth = fitted.predict_interval(q, wrench, 0.9), twin.under_load(q, wrench)
    assert ((far_interval.lower <= truth) & (truth <= far_interval.upper)).mean() >= 0.8
    assert (
        np.median(
            (far_interval.upper - far_interval.lower) / (near_interval.upper - near_interval.lower)
        )
        >= 1.8
    )
