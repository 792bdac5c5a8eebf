"""Learning curves: the fitted power law, and the usual exponent if the errors show none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import curve_fit

from stiff_bench.analysis.learning_curve import (
    EXPONENT_BOUNDS,
    USUAL_EXPONENT,
    CurveErrors,
    PowerLaw,
    learning_curve,
    power_law,
)

SIZES = np.array([6, 9, 14, 21, 32, 48])
N_DRAWS, N_POSES = 10, 60


def errors_of(law, rng, *, scatter=0.0, poses=0.5):
    """Return errors [m] that follow a law, times a factor per pose, times scatter."""
    counts = np.zeros((N_DRAWS, N_POSES), dtype=np.int64)
    for draw in counts:
        draw[rng.permutation(N_POSES)[: N_POSES // 5]] = 1
    factor = np.exp(poses * rng.normal(size=N_POSES))
    factor /= (counts @ factor).sum() / counts.sum()
    scatter_factors = np.exp(scatter * rng.normal(size=(N_DRAWS, len(SIZES), N_POSES)))
    means = np.array([law(n) for n in SIZES])
    return CurveErrors(SIZES, counts[:, None] * means[:, None] * factor * scatter_factors, counts)


@pytest.mark.parametrize("c", [0.3, 0.5, 1.2])
def test_the_law_of_errors_without_scatter_has_its_exponent(rng, c):
    law = PowerLaw(0.05e-3, 0.4e-3, c)
    errors = errors_of(law, rng)
    curve = learning_curve(errors, resamples=30)
    assert curve.exponent_is_fitted
    assert curve.law.c == pytest.approx(c, rel=1e-3)
    np.testing.assert_allclose(errors.mean, [law(n) for n in SIZES], rtol=1e-12)
    assert curve.law(120) == pytest.approx(law(120), rel=1e-4)
    low, high = curve.interval(120, 60)
    assert low == pytest.approx(high, rel=1e-3)  # factors of poses cancel


def test_the_fit_equals_scipys_general_fit(rng):
    errors = (0.05 + 0.4 * SIZES**-0.7) * (1.0 + 0.02 * rng.normal(size=6))
    general, _ = curve_fit(
        lambda n, a, b, c: a + b * n**-c,
        SIZES.astype(float),
        errors,
        (0.05, 0.4, 0.7),
        sigma=errors,
        bounds=([0.0, 0.0, EXPONENT_BOUNDS[0]], [np.inf, np.inf, EXPONENT_BOUNDS[1]]),
    )
    law = power_law(SIZES.astype(float), errors)
    assert law(200) == pytest.approx(PowerLaw(*general)(200), rel=1e-3)


def test_intervals_of_the_gain_of_more_poses_contain_it(rng):
    law, n_held = PowerLaw(0.05e-3, 0.4e-3, 0.5), 0
    for seed in range(10):
        curve = learning_curve(errors_of(law, rng, scatter=0.3), resamples=40, seed=seed)
        low, high = np.array(curve.interval(120, 60)) / curve.law(60)
        n_held += low <= law(120) / law(60) <= high
        assert 0.0 < low < high < 1.0
    assert n_held >= 8


def test_errors_that_do_not_show_the_exponent_get_the_usual_one(rng):
    curve = learning_curve(errors_of(PowerLaw(0.1e-3, 0.1e-3, 0.5), rng, scatter=0.5), resamples=30)
    assert not curve.exponent_is_fitted and curve.law.c == USUAL_EXPONENT
    assert (
        len({law.c for law in curve.resampled_laws}) == 30
    )  # the interval holds other exponents, too


def test_the_curve_goes_through_the_error_with_the_most_poses(rng):
    errors = errors_of(PowerLaw(0.1e-3, 2e-3, 2.0), rng, scatter=0.5)
    curve = learning_curve(errors, resamples=30)
    assert curve.law(errors.sizes[-1]) == pytest.approx(errors.mean[-1])


@pytest.mark.parametrize("errors", [[1.0] * 6, [1.0, 1.1, 1.2, 1.3, 1.4, 1.5], [0.0] * 6])
def test_more_poses_never_look_worse(errors):
    law = power_law(SIZES.astype(float), np.array(errors))
    assert law(96) == pytest.approx(law(48), rel=1e-6)
    assert law(48) == pytest.approx(np.exp(np.log(errors).mean()) if errors[0] else 0.0, rel=0.05)
