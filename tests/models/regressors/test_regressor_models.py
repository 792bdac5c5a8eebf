"""Reference rows and learners on encoded samples: `zero`, `mean`, `knn`, `gp`, `boosting`."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from sklearn.exceptions import ConvergenceWarning

from helpers.made_samples import samples_with
from stiff_models.regressors.gp_model import GaussianProcessModel
from stiff_models.regressors.regressor_model import MeanModel, ZeroModel, told_as_ours
from stiff_protocols.contract.errors import StiffBenchWarning


def smooth_samples(n, rng, noise=0.0):
    """Samples whose deflection is a smooth function of one joint and one force."""
    q, wrench = np.zeros((n, 6)), np.zeros((n, 6))
    q[:, 1], wrench[:, 2] = rng.uniform(-1.0, 1.0, n), rng.uniform(-100.0, 100.0, n)
    deflection = np.stack([np.sin(2 * q[:, 1]), wrench[:, 2] / 100, np.ones(n)], axis=1) * 1e-4
    return samples_with(q, wrench, deflection + noise * rng.normal(size=(n, 3)))


def test_zero_predicts_no_deflection_and_mean_the_training_mean(twin):
    train, test = twin.samples.take(np.arange(40)), twin.samples.take(np.arange(40, 60))
    zero = ZeroModel().fit(train, robot=twin.robot)
    mean = MeanModel().fit(train, robot=twin.robot)
    np.testing.assert_array_equal(zero.predict(test.q, test.wrench), np.zeros((20, 3)))
    np.testing.assert_array_equal(
        mean.predict(test.q, test.wrench), np.tile(train.deflection.mean(axis=0), (20, 1))
    )


@pytest.mark.parametrize("ard", [True, False])
def test_the_intervals_of_a_gaussian_process_cover_what_they_say(ard, kr10, rng):
    train, test = (smooth_samples(n, rng, noise=1e-5) for n in (80, 600))
    model = GaussianProcessModel(restarts=0, ard=ard).fit(train, robot=kr10)
    interval = model.predict_interval(test.q, test.wrench, 0.8)
    inside = (interval.lower <= test.deflection) & (test.deflection <= interval.upper)
    # 600 rows: binomial standard deviation 0.016; the rest is the noise estimated from 80 rows
    np.testing.assert_allclose(inside.mean(axis=0), 0.8, atol=0.12)
    assert model.diagnostics_["noise X [mm]"] == pytest.approx(0.01, rel=0.3)


@pytest.mark.parametrize(
    ("text", "category", "kept", "told"),
    [
        ("lbfgs  failed\n\nYou might scale", ConvergenceWarning, False, "^lbfgs failed$"),
        ("y residual is constant", UserWarning, False, "^y residual is constant$"),
        ("overflow", RuntimeWarning, False, "^the regressor's arithmetic: overflow$"),
        ("odd", FutureWarning, True, "^odd$"),  # said of its code
    ],
)
def test_what_a_regressor_says_of_the_samples_becomes_our_warning(text, category, kept, told):
    expected = category if kept else StiffBenchWarning
    with pytest.warns(expected, match=told) as caught, told_as_ours():
        warnings.warn(text, category, stacklevel=1)
    assert caught[0].category is expected
