"""Check co-kriging, the method of `mf-gp`, against joint processes."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest

from stiff_models.regressors.gaussian_process import (
    Covariance,
    GaussianProcess,
    Search,
)
from stiff_models.regressors.mf_gp import fit_co_kriging

LINE = np.linspace(0.0, 1.0, 51)[:, None]
CHEAP = np.linspace(0.0, 1.0, 11)[:, None]
NUGGET = 1e-8
DEAR = CHEAP[[0, 4, 6, 10]]  # 0, 0.4, 0.6, 1: nested


def high(x):
    """Return Forrester's function (2007, Proc. R. Soc. A 463: 3251-3269, section 4)."""
    return ((6 * x - 2) ** 2 * np.sin(12 * x - 4))[:, 0]


def low(x):
    """Return its low fidelity: 0.5 high + 10 (x - 0.5) - 5."""
    return 0.5 * high(x) + (10 * (x - 0.5) - 5)[:, 0]


def process(length, nugget=NUGGET):
    """Return the squared exponential from which a search starts."""
    return Covariance("rbf", 100.0, np.array([length]), noise=0.0, jitter=nugget)


def co_kriging(low_start, delta_start, measured, nugget=NUGGET):
    search = Search(restarts=0, rows=100, seed=3)
    levels = process(low_start, nugget), process(delta_start, nugget)
    return fit_co_kriging(*levels, (CHEAP, low(CHEAP)), (DEAR, measured), search)


@pytest.mark.filterwarnings("ignore:.*the likelihood search stopped early")
def test_forresters_function_is_found_from_four_points_and_its_low_fidelity():
    nugget = 1e-6  # with less, rounding ends a search earlier; some processors end it even here
    fitted = co_kriging(0.2, 1.0, high(DEAR), nugget)
    likeliest = Search(0, 100, 0).likeliest(process(0.2, nugget), DEAR, high(DEAR))
    single_level = GaussianProcess.of(likeliest, DEAR, high(DEAR)).mean(LINE)
    error = np.abs(fitted.mean(LINE) - high(LINE)).max()
    assert fitted.rho == pytest.approx(2.0, abs=0.05)  # high = 2 low - 20 (x - 0.5) + 10
    assert error < 0.5  # the function spans -6 to 16
    assert error < 0.1 * np.abs(single_level - high(LINE)).max()
    np.testing.assert_allclose(fitted.mean(DEAR), high(DEAR), atol=1e-2)


def squared_exponential(first, second, length, variance):
    return variance * np.exp(-0.5 * ((first - second.T) / length) ** 2)


def joint_co_kriging(low_kernel, delta_kernel, rho, measured, *, nugget, constant_means=False):
    """Return mean and variance of the high fidelity on LINE from the joint covariance.

    M. C. Kennedy and A. O'Hagan, Biometrika 87 (2000) 1-13, section 2: no recursion, one system of
    the outputs of both levels. Kernels are (length scale, variance).

    Args:
        measured: the high fidelity at DEAR.
        constant_means: each level has an unknown constant mean, by generalised least squares;
            otherwise the means are zero, as in `mf-gp`.
    """
    inputs, outputs = np.vstack([CHEAP, DEAR]), np.concatenate([low(CHEAP), measured])
    dear = np.repeat([0.0, 1.0], [len(CHEAP), len(DEAR)])
    scale = np.where(dear, rho, 1.0)
    below, delta = (
        (squared_exponential(inputs, inputs, *k), squared_exponential(LINE, inputs, *k))
        for k in (low_kernel, delta_kernel)
    )
    covariance = np.outer(scale, scale) * below[0] + np.outer(dear, dear) * delta[0]
    weights = np.linalg.inv(covariance + nugget * np.eye(len(inputs)))
    cross = rho * scale * below[1] + dear * delta[1]
    means = np.zeros(2)
    basis = np.stack([scale, dear], axis=1)
    if constant_means:
        means = np.linalg.solve(basis.T @ weights @ basis, basis.T @ weights @ outputs)
    mean = means @ [rho, 1.0] + cross @ weights @ (outputs - basis @ means)
    prior = rho**2 * low_kernel[1] + delta_kernel[1]
    return mean, prior - ((cross @ weights) * cross).sum(axis=1)


def test_the_recursion_is_the_joint_process_of_both_levels():
    waves = high(DEAR) + 3.0 * np.sin(20.0 * DEAR[:, 0])  # a delta that moves
    fitted = co_kriging(0.2, 0.2, waves)
    below, delta = (
        (p.covariance.lengths[0], p.covariance.variance) for p in (fitted.trend, fitted)
    )
    mean, variance = joint_co_kriging(below, delta, fitted.rho, waves, nugget=NUGGET)
    np.testing.assert_allclose(fitted.mean(LINE), mean, atol=1e-6)
    np.testing.assert_allclose(fitted.deviation(LINE) ** 2, variance, atol=1e-6)
    weights = np.linalg.inv(squared_exponential(DEAR, DEAR, *delta))
    likeliest = (low(DEAR) @ weights @ waves) / (low(DEAR) @ weights @ low(DEAR))
    assert fitted.rho == pytest.approx(likeliest, rel=1e-6)


def test_smts_co_kriging_is_the_same_joint_process_with_constant_means():
    """The definitions differ only in the means: constant in smt, zero in `mf-gp`."""
    applications = pytest.importorskip("smt.applications")
    theta = np.array([[10.0], [2.0]])  # exp(-theta x^2) of inputs divided by X_scale
    smt = applications.MFK(print_global=False, hyper_opt="NoOp", theta0=theta, corr="squar_exp")
    smt.set_training_values(CHEAP, low(CHEAP)[:, None], name=0)
    smt.set_training_values(DEAR, high(DEAR)[:, None])
    with contextlib.redirect_stdout(io.StringIO()):
        smt.train()
    np.testing.assert_array_equal(smt.optimal_theta, theta)
    kernels = [(smt.X_scale[0] / np.sqrt(2.0 * rate), 1.0) for (rate,) in theta]
    rho = smt.optimal_par[1]["beta"][0, 0]
    mean, _ = joint_co_kriging(*kernels, rho, high(DEAR), nugget=0.0, constant_means=True)
    np.testing.assert_allclose(smt.predict_values(LINE)[:, 0], mean, atol=1e-9)
