"""One-output Gaussian processes of zero mean: covariance, likelihood, posterior.

The covariance is ``s^2 k(r) + noise``, r the distance of two rows in units of the length scales,
and k a Matern 5/2, ``(1 + x + x^2/3) exp(-x)`` with ``x = sqrt(5) r``, or a squared exponential,
``exp(-r^2/2)``: C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning,
2006, ch. 2 and 4. The tests compare it with scikit-learn's, whose likelihood takes several times
as long, and whose fit needs a second factorisation.

Shapes: inputs (n, n_features), outputs (n,).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from stiff_protocols.contract.errors import ModelError, warn
from stiff_protocols.contract.types import FloatArray

# Standardised features and deflections. Wide: a length scale at its upper bound switches an
# irrelevant feature off; a noise at its lower bound means samples without noise.
VARIANCE_BOUNDS = (1e-3, 1e5)
LENGTH_BOUNDS = (1e-2, 1e4)
NOISE_BOUNDS = (1e-8, 10.0)


@dataclass(frozen=True)
class Search:
    """Settings of the search for hyperparameters.

    The time of a step grows with the cube of the rows. A thousand rows determine about a dozen
    hyperparameters nearly as well as more rows, so the search uses at most `rows` of them, drawn at
    random. `restarts` searches from random starts follow the first; both draws use `seed`. All
    compute on one thread, so that the result does not depend on the number of threads.
    """

    restarts: int
    rows: int
    seed: int

    def likeliest(
        self,
        start: Covariance,
        inputs: FloatArray,
        outputs: FloatArray,
        *,
        least: float = 0.0,
    ) -> Covariance:
        """Return the most probable covariance of the kind of `start`, with at least this noise."""
        if len(inputs) > self.rows:
            chosen = np.random.default_rng(self.seed).permutation(len(inputs))[: self.rows]
            inputs, outputs = inputs[chosen], outputs[chosen]

        def loss(theta: FloatArray) -> tuple[float, FloatArray]:
            value, gradient = log_likelihood(start.with_theta(theta), inputs, outputs)
            return -value, -gradient

        low, high = NOISE_BOUNDS
        noise = (min(max(low, least), high), high)
        bounds = np.log([VARIANCE_BOUNDS, *[LENGTH_BOUNDS] * len(start.lengths), noise])
        # legacy numbers: the same as in scikit-learn's restarts
        drawn = np.random.RandomState(self.seed).uniform(
            bounds[:, 0], bounds[:, 1], (self.restarts, len(bounds))
        )
        with threadpool_limits(1):  # a search amplifies the rounding of divided products
            return start.with_theta(minimum(loss, [start.theta, *drawn], bounds.tolist()))


Loss = Callable[[FloatArray], tuple[float, FloatArray]]
"""Returns a number and its gradient."""


def minimum(
    loss: Loss,
    starts: Sequence[FloatArray],
    bounds: Sequence[tuple[float, float]],
) -> FloatArray:
    """Return the hyperparameters with the least loss, by L-BFGS-B from each start."""
    optima = [minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds) for start in starts]
    best = min(optima, key=lambda optimum: optimum.fun)
    if not best.success:
        warn(
            "hyperparameters of a Gaussian process: the likelihood search stopped early "
            f"({best.message.strip(' :')}); the best values so far are used"
        )
    return np.asarray(best.x)


def log_likelihood(
    covariance: Covariance, inputs: FloatArray, outputs: FloatArray
) -> tuple[float, FloatArray]:
    """Return the log marginal likelihood and its gradient by `Covariance.theta`.

    It is minus infinity, with zeros, if rounding leaves the covariance without a Cholesky factor.
    """
    scaled, n = covariance.scaled(inputs), len(inputs)
    row_covariance, slope = covariance.with_slope(scaled)
    try:
        factor = covariance.factor(row_covariance)
    except np.linalg.LinAlgError:
        return -math.inf, np.zeros_like(covariance.theta)
    weights = cho_solve((factor, True), outputs, check_finite=False)
    energy = float(outputs @ weights)
    value = -0.5 * energy - np.log(np.diag(factor)).sum() - 0.5 * n * math.log(2.0 * math.pi)

    # with A = weights weights^T - covariance^-1 a derivative is half the trace of A dC
    inverse, _ = dpotri(factor, lower=1, overwrite_c=1)  # its lower triangle, zeros above
    trace = float(weights @ weights - np.trace(inverse))
    by_noise_terms = (covariance.noise + covariance.jitter) * trace
    by_variance = 0.5 * (energy - n - by_noise_terms)  # the trace of A C is energy - n

    # sum_ij A_ij slope_ij (z_i - z_j)^2 / 2; the diagonal adds nothing, so the inverse's lower
    # triangle is used twice instead of filling the upper triangle
    inverse *= -2.0
    inverse += np.outer(weights, weights)
    inverse *= slope
    column_and_row_sums = inverse.sum(axis=0) + inverse.sum(axis=1)
    by_lengths = 0.5 * column_and_row_sums @ scaled**2 - (scaled * (inverse @ scaled)).sum(axis=0)
    if len(covariance.lengths) == 1:
        by_lengths = by_lengths.sum(keepdims=True)
    by_noise = 0.5 * covariance.noise * trace
    return float(value), np.array([by_variance, *by_lengths, by_noise])


Kernel = Literal["matern", "rbf"]
"""Names of `CORRELATIONS`: add a new kernel's name here and its function there."""


def _matern(squares: FloatArray) -> tuple[FloatArray, FloatArray]:
    x = np.sqrt(5.0 * squares)
    decay = np.exp(-x)
    slope = (1.0 + x) * decay
    return slope + 5.0 / 3.0 * squares * decay, 5.0 / 3.0 * slope


def _rbf(squares: FloatArray) -> tuple[FloatArray, FloatArray]:
    correlation = np.exp(-0.5 * squares)
    return correlation, correlation


CORRELATIONS: dict[Kernel, Callable[[FloatArray], tuple[FloatArray, FloatArray]]] = {
    "matern": _matern,
    "rbf": _rbf,
}
"""Kernel -> function of squared distances r^2 that returns k(r) and its slope, -2 dk/dr^2."""

BLOCK = 2**18
"""Numbers of a covariance with other rows that are computed at once."""


def row_blocks(n_rows: int, n_columns: int) -> Iterator[slice]:
    """Yield slices of rows whose part of a matrix has at most about `BLOCK` numbers."""
    size = max(1, BLOCK // n_columns)
    return (slice(start, min(start + size, n_rows)) for start in range(0, n_rows, size))


@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of a process' outputs.

    Attributes:
        kernel: "matern" (Matern 5/2) or "rbf" (squared exponential).
        variance: s^2.
        lengths: (n_features,) length scales, or (1,) that all features share.
        noise: variance of each measured output's own error.
        jitter: addition to the variances of the training rows, required by the Cholesky factor.
    """

    kernel: Kernel
    variance: float
    lengths: FloatArray
    noise: float
    jitter: float

    @property
    def theta(self) -> FloatArray:
        """Logarithms of variance, length scales and noise."""
        return np.asarray(np.log([self.variance, *self.lengths, self.noise]))

    def with_theta(self, theta: FloatArray) -> Covariance:
        """Return the same covariance with other hyperparameters."""
        variance, *lengths, noise = np.exp(theta)
        return replace(
            self, variance=float(variance), lengths=np.array(lengths), noise=float(noise)
        )

    def scaled(self, inputs: FloatArray) -> FloatArray:
        """Return (n, n_features) inputs in units of the length scales."""
        return inputs / self.lengths

    def between(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the (m, n) covariance without noise of `scaled` rows."""
        return self.variance * CORRELATIONS[self.kernel](_squares(first, second))[0]

    def with_slope(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the (n, n) covariance without noise of `scaled` rows and its slope.

        The slope times a feature's own squared distance, in `scaled` units, is the covariance's
        derivative by the logarithm of that feature's length scale.
        """
        correlation, slope = CORRELATIONS[self.kernel](_squares(rows, rows))
        return self.variance * correlation, self.variance * slope

    def factor(self, row_covariance: FloatArray) -> FloatArray:
        """Return the (n, n) lower Cholesky factor of training outputs' covariance.

        `row_covariance` is the (n, n) covariance of the rows without noise; it is overwritten.
        LinAlgError: rounding leaves no factor.
        """
        row_covariance[np.diag_indices(len(row_covariance))] += self.noise + self.jitter
        return np.asarray(
            cholesky(row_covariance.T, lower=True, overwrite_a=True, check_finite=False)
        )


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A process of zero mean, given its rows.

    Attributes:
        covariance: hyperparameters.
        rows: (n, n_features) training inputs, as `Covariance.scaled` returns them.
        factor: (n, n) lower Cholesky factor of the training outputs' covariance.
        weights: (n,) inverse of that covariance times the outputs.
    """

    covariance: Covariance
    rows: FloatArray
    factor: FloatArray
    weights: FloatArray

    @classmethod
    def of(cls, covariance: Covariance, inputs: FloatArray, outputs: FloatArray) -> GaussianProcess:
        """Return the process given these rows; ModelError if they cannot be solved."""
        rows = covariance.scaled(inputs)
        try:
            factor = covariance.factor(covariance.between(rows, rows))
        except np.linalg.LinAlgError as error:
            raise ModelError(
                f"a Gaussian process of {len(rows)} rows cannot be solved: {error}; remove "
                "duplicated rows"
            ) from error
        weights = cho_solve((factor, True), outputs, check_finite=False)
        return cls(covariance, rows, factor, weights)

    def mean(self, inputs: FloatArray) -> FloatArray:
        """Return the (n,) predicted outputs."""
        scaled, mean = self.covariance.scaled(inputs), np.empty(len(inputs))
        for part in row_blocks(len(scaled), len(self.rows)):
            mean[part] = self.covariance.between(scaled[part], self.rows) @ self.weights
        return mean

    def deviation(self, inputs: FloatArray) -> FloatArray:
        """Return the (n,) standard deviation of outputs there, noise included."""
        scaled, explained = self.covariance.scaled(inputs), np.empty(len(inputs))
        for part in row_blocks(len(scaled), len(self.rows)):
            between = self.covariance.between(scaled[part], self.rows)
            solved = solve_triangular(self.factor, between.T, lower=True, check_finite=False)
            explained[part] = np.einsum("ij,ij->j", solved, solved)
        variance = self.covariance.variance + self.covariance.noise - explained
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def between(self, inputs: FloatArray, other_inputs: FloatArray) -> FloatArray:
        """Return the (n, m) covariance of the process at two sets of inputs, noise excluded."""
        covariance = self.covariance
        first, second = covariance.scaled(inputs), covariance.scaled(other_inputs)
        solved = cho_solve((self.factor, True), covariance.between(self.rows, second))
        explained = covariance.between(first, self.rows) @ solved
        return np.asarray(covariance.between(first, second) - explained)


def _squares(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the (m, n) squared distances of rows.

    Rounding leaves errors of the order of 1e-16 of the rows' squared lengths. Correlations are
    smooth at 0, so their errors are not larger.
    """
    sizes = np.einsum("ij,ij->i", first, first)[:, None] + np.einsum("ij,ij->i", second, second)
    return np.asarray(np.maximum(sizes - 2.0 * first @ second.T, 0.0))
