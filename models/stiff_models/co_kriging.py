"""Two-fidelity co-kriging of one output, autoregressive of order one.

``f_high(x) = rho f_low(x) + delta(x)``, with Gaussian processes for f_low and delta: M. C. Kennedy
and A. O'Hagan, Biometrika 87 (2000) 1-13, in the recursive form of L. Le Gratiet and J. Garnier,
Int. J. Uncertainty Quantification 4 (2014) 365-386: f_low is trained first, and its posterior mean
stands in f_high as a trend. delta's hyperparameters maximise the likelihood of the high fidelity,
in which rho is at each step the likeliest one, found by generalised least squares.

`smt.applications.MFK` is the same model but for a constant mean of each level (zero here), and the
tests hold both against the joint process of the two levels. It is not used here
because with a noise term it searches without gradient and stops after 12 evaluations a
hyperparameter, and because its fitted objects can only be pickled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_models.gaussian_process import Covariance, GaussianProcess
from stiff_models.likelihood import Search
from stiff_protocols.types import FloatArray


@dataclass(frozen=True, eq=False)
class CoKriging:
    """A fitted two-fidelity process.

    Attributes:
        low: process of the low fidelity.
        delta: process of what `rho` times the low fidelity leaves.
    """

    low: GaussianProcess
    delta: GaussianProcess

    @property
    def rho(self) -> float:
        """Scale between the fidelities."""
        return self.delta.rho

    def mean(self, inputs: FloatArray) -> FloatArray:
        """Return the (n,) predicted high fidelity at (n, n_features) inputs."""
        return self.rho * self.low.mean(inputs) + self.delta.mean(inputs)

    def deviation(self, inputs: FloatArray) -> FloatArray:
        """Return the (n,) predictive standard deviation, delta's noise included.

        rho counts as known.
        """
        low = self.rho * self.low.deviation(inputs)
        return np.asarray(np.hypot(low, self.delta.deviation(inputs)))


def fit_co_kriging(
    low: Covariance,
    delta: Covariance,
    cheap: tuple[FloatArray, FloatArray],
    dear: tuple[FloatArray, FloatArray],
    search: Search,
) -> CoKriging:
    """Fit both levels.

    Args:
        low: covariance of the low fidelity that the search starts from.
        delta: the same of the difference.
        cheap: inputs (m, n_features) and low-fidelity outputs (m,).
        dear: inputs (n, n_features) and high-fidelity outputs (n,).
        search: for the hyperparameters of each level.

    Raises:
        ModelError: a level's covariance cannot be solved.
    """
    below = GaussianProcess.of(search.likeliest(low, *cheap), *cheap)
    trend = below.mean(dear[0])
    return CoKriging(below, GaussianProcess.of(search.likeliest(delta, *dear, trend), *dear, trend))
