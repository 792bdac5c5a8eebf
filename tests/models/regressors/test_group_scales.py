"""Check scales of groups against Gaussian processes written out, and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from stiff_models.regressors.group_scales import GroupedModel, joined

N = 12


@pytest.fixture
def made(rng):
    """Return a model of two groups and two kinds of errors, and readings."""
    columns, group_of = joined([rng.normal(size=(N, 3, 4)), rng.normal(size=(N, 3, 7))])
    roots = rng.normal(size=(N, 3, 3))
    blocks = np.stack([roots @ roots.swapaxes(1, 2), np.tile(np.eye(3), (N, 1, 1))])
    typical = np.array([1.0, 0.3, 0.5, np.inf])
    bounds = np.array([[1e-3, 20.0]] * 4)
    is_read = np.ones((N, 3), dtype=bool)
    model = GroupedModel(columns, group_of, blocks, typical, bounds, is_read)
    return model, rng.normal(size=(N, 3))


def covariance(model, scales):
    """Return the (3 N, 3 N) covariance of the readings."""
    rows = model.columns.reshape(3 * N, -1)
    total = (rows * scales[model.group_of] ** 2) @ rows.T
    for number in range(N):
        of_sample = slice(3 * number, 3 * number + 3)
        total[of_sample, of_sample] += np.tensordot(scales[2:] ** 2, model.blocks[:, number], 1)
    return total


SCALES = np.array([0.8, 0.2, 0.3, 0.5])


def test_the_loss_is_the_normal_densitys_and_its_slopes_are_finite_differences(made):
    model, readings = made
    value, slopes = model._loss(readings, SCALES)
    density = stats.multivariate_normal(np.zeros(3 * N), covariance(model, SCALES))
    constant = 1.5 * N * np.log(2.0 * np.pi)
    prior = (SCALES / model.typical).sum()
    assert value == pytest.approx(-density.logpdf(readings.ravel()) - constant + prior)
    for number in range(len(SCALES)):
        step = np.exp(1e-5 * (np.arange(4) == number))
        change = model._loss(readings, SCALES * step)[0] - model._loss(readings, SCALES / step)[0]
        assert slopes[number] == pytest.approx(change / 2e-5, rel=1e-5, abs=1e-6)


def test_the_posterior_is_that_of_conditioned_normals(made):
    model, readings = made
    posterior = model.posterior(readings, SCALES)
    rows, inverse = model.columns.reshape(3 * N, -1), np.linalg.inv(covariance(model, SCALES))
    prior = np.diag(SCALES[model.group_of] ** 2)
    np.testing.assert_allclose(posterior.mean, prior @ rows.T @ inverse @ readings.ravel())
    spread = prior - prior @ rows.T @ inverse @ rows @ prior
    np.testing.assert_allclose(posterior.root @ posterior.root.T, spread, atol=1e-12)
    np.testing.assert_allclose(posterior.weighted.ravel(), inverse @ readings.ravel())
    np.testing.assert_allclose(posterior.precision.ravel(), np.diag(inverse))
    blocks = np.tensordot(SCALES[2:] ** 2, model.blocks, 1)
    variance = np.diagonal(blocks, axis1=1, axis2=2)
    np.testing.assert_allclose(model.error_variance(SCALES), variance)


def test_the_scales_of_drawn_coefficients_and_errors_are_found_and_an_idle_group_vanishes(rng):
    n = 400
    columns, group_of = joined([rng.normal(size=(n, 3, size)) for size in (40, 40, 40)])
    true = np.array([2.0, 0.0, 0.5])
    coefficients = true[group_of] * rng.normal(size=120)
    readings = columns @ coefficients + 0.3 * rng.normal(size=(n, 3))
    blocks = np.tile(np.eye(3), (1, n, 1, 1))
    bounds = np.array([[1e-4, 20.0]] * 4)
    typical, is_read = np.array([1.0, 1.0, 1.0, np.inf]), np.ones((n, 3), dtype=bool)
    model = GroupedModel(columns, group_of, blocks, typical, bounds, is_read)
    scales = model.searched(readings, np.full(4, 0.5), 100)
    assert scales[1] < 0.02
    assert scales[[0, 2]] == pytest.approx([2.0, 0.5], rel=0.3)
    assert scales[3] == pytest.approx(0.3, rel=0.1)


def test_some_samples_of_a_model_are_the_model_of_these_samples(made, rng):
    model, readings = made
    rows = np.array([7, 2, 5])
    part = model.take(rows)
    expected = GroupedModel(
        model.columns[rows],
        model.group_of,
        model.blocks[:, rows],
        model.typical,
        model.bounds,
        model.is_read[rows],
    )
    assert part._loss(readings[rows], SCALES)[0] == expected._loss(readings[rows], SCALES)[0]
