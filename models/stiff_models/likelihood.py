"""Hyperparameters of a Gaussian process at a maximum of the marginal likelihood.

C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning, 2006, equations 5.8
and 5.9. A trend of unknown scale takes part at its likeliest scale for each choice of the
hyperparameters, so that the gradient at that fixed scale is the whole gradient.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize
from sklearn.utils import check_random_state

from stiff_models.gaussian_process import Covariance, weights_and_rho
from stiff_protocols.errors import StiffBenchWarning
from stiff_protocols.types import FloatArray

# Standardised features and deflections. Wide: a length scale at its upper bound switches an
# irrelevant feature off, a noise at its lower bound says that the samples carry none.
VARIANCE_BOUNDS = (1e-3, 1e5)
LENGTH_BOUNDS = (1e-2, 1e4)
NOISE_BOUNDS = (1e-8, 10.0)


@dataclass(frozen=True)
class Search:
    """How hyperparameters are looked for.

    A step takes a time that grows as the cube of the rows, and a thousand rows say nearly what
    more would of a dozen or so hyperparameters: the search sees at most `rows` of them.

    Attributes:
        restarts: searches from random starts, after the first.
        rows: at most so many of the training rows are looked at, drawn at random.
        seed: of both.
    """

    restarts: int
    rows: int
    seed: int

    def likeliest(
        self,
        start: Covariance,
        inputs: FloatArray,
        outputs: FloatArray,
        trend: FloatArray | None = None,
    ) -> Covariance:
        """Return the likeliest covariance that was found.

        Args:
            start: where the first search starts; its kind, too.
            inputs: (n, n_features)
            outputs: (n,)
            trend: (n,) that an unknown multiple of is in the outputs.
        """
        if len(inputs) > self.rows:
            chosen = np.random.default_rng(self.seed).permutation(len(inputs))[: self.rows]
            inputs, outputs = inputs[chosen], outputs[chosen]
            trend = None if trend is None else trend[chosen]

        def loss(theta: FloatArray) -> tuple[float, FloatArray]:
            value, gradient = log_likelihood(start.with_theta(theta), inputs, outputs, trend)
            return -value, -gradient

        def searched(theta: FloatArray) -> Any:
            return minimize(loss, theta, jac=True, method="L-BFGS-B", bounds=bounds.tolist())

        bounds = _log_bounds(start)
        # legacy numbers: those that scikit-learn's restarts draw
        drawn = check_random_state(self.seed).uniform(*bounds.T, (self.restarts, len(bounds)))
        best = min((searched(theta) for theta in (start.theta, *drawn)), key=lambda one: one.fun)
        if not best.success:
            warnings.warn(
                f"hyperparameters of a Gaussian process: the search for the likeliest ones stopped "
                f"early ({best.message.strip(' :')}); the best that it met are used",
                StiffBenchWarning,
                stacklevel=3,
            )
        return start.with_theta(best.x)


def log_likelihood(
    covariance: Covariance,
    inputs: FloatArray,
    outputs: FloatArray,
    trend: FloatArray | None = None,
) -> tuple[float, FloatArray]:
    """Return the log marginal likelihood and its gradient by `Covariance.theta`.

    Minus infinity, and zeros, where rounding leaves the covariance without a Cholesky factor.

    Args:
        covariance: of the outputs.
        inputs: (n, n_features)
        outputs: (n,)
        trend: (n,), as for `Search.likeliest`.
    """
    scaled, n = covariance.scaled(inputs), len(inputs)
    of_rows, slope = covariance.with_slope(scaled)
    try:
        factor = covariance.factor(of_rows)
    except np.linalg.LinAlgError:
        return -math.inf, np.zeros_like(covariance.theta)
    weights, rho = weights_and_rho(factor, outputs, trend)
    left = outputs if trend is None else outputs - rho * trend
    energy = float(left @ weights)
    value = -0.5 * energy - np.log(np.diag(factor)).sum() - 0.5 * n * math.log(2.0 * math.pi)

    # with A = weights weights^T - covariance^-1 a derivative is half the trace of A dC
    inverse, _ = dpotri(factor, lower=1, overwrite_c=1)  # its lower triangle, zeros above
    trace = float(weights @ weights - np.trace(inverse))
    own = (covariance.noise + covariance.jitter) * trace
    by_variance = 0.5 * (energy - n - own)  # the trace of A C is energy - n

    # sum_ij A_ij slope_ij (z_i - z_j)^2 / 2; the diagonal adds nothing, so the inverse's lower
    # triangle is taken twice instead of filling the upper one
    inverse *= -2.0
    inverse += np.outer(weights, weights)
    inverse *= slope
    both = inverse.sum(axis=0) + inverse.sum(axis=1)
    by_lengths = 0.5 * both @ scaled**2 - (scaled * (inverse @ scaled)).sum(axis=0)
    if len(covariance.lengths) == 1:
        by_lengths = by_lengths.sum(keepdims=True)
    by_noise = [0.5 * covariance.noise * trace] if covariance.noise else []
    return float(value), np.array([by_variance, *by_lengths, *by_noise])


def _log_bounds(covariance: Covariance) -> FloatArray:
    """Return (n_theta, 2) bounds of `Covariance.theta`."""
    noise = [NOISE_BOUNDS] if covariance.noise else []
    return np.log([VARIANCE_BOUNDS, *[LENGTH_BOUNDS] * len(covariance.lengths), *noise])
