"""Fit a power law to a model's errors on few and many poses, to predict the gain of more poses.

Errors beyond the number of measured poses are extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.types import FloatArray, IntArray

USUAL_EXPONENT = 0.5
"""Exponent c if the errors do not determine it: the exponent of most means over samples."""
EXPONENTS = (0.25, 1.0)
"""Range of c if the errors do not determine it."""
EXPONENT_BOUNDS = (0.05, 3.0)
MAX_EXPONENT_SD = 0.15
"""Largest standard deviation of c over resampled poses with which c is fitted."""
RESAMPLES = 200
CONFIDENCE = 0.9


@dataclass(frozen=True)
class PowerLaw:
    """The law ``e(n) = a + b n^-c`` of the mean error.

    Attributes:
        a: error with infinitely many poses, m; 0 or more.
        b: reducible part of the error, m; 0 or more: an error never rises with more poses.
        c: exponent.
    """

    a: float
    b: float
    c: float

    def __call__(self, n: float) -> float:
        """Return the error [m] with n poses."""
        return float(self.a + self.b * n**-self.c)

    def through(self, n: float, error: float) -> PowerLaw:
        """Return the law scaled to an error [m] with n poses."""
        factor = error / self(n) if self(n) > 0.0 else 1.0
        return PowerLaw(self.a * factor, self.b * factor, self.c)


@dataclass(frozen=True, eq=False)
class CurveErrors:
    """Errors of a model trained on nested subsets of the poses, on held-out poses.

    Attributes:
        sizes: (s,) numbers of training poses, rising.
        totals: (d, s, p) sums of the errors of p poses in d draws, m.
        counts: (d, p) numbers of summed rows; 0: the pose was not tested in the draw.
    """

    sizes: IntArray
    totals: FloatArray
    counts: IntArray

    @property
    def mean(self) -> FloatArray:
        """Return the (s,) mean errors over all rows, m."""
        return self._mean(np.ones(len(self.counts)), np.ones(self.counts.shape[1]))

    def resampled(self, n: int, seed: int) -> FloatArray:
        """Return (n, s) mean errors of poses and draws resampled with replacement."""
        rng = np.random.default_rng(seed)
        n_draws, n_poses = self.counts.shape
        means: list[FloatArray] = []
        while len(means) < n:
            draws, poses = (
                rng.multinomial(k, np.full(k, 1.0 / k)).astype(np.float64)
                for k in (n_draws, n_poses)
            )
            if draws @ self.counts @ poses > 0.0:  # skip resamples without a tested pose
                means.append(self._mean(draws, poses))
        return np.array(means)

    def _mean(self, draws: FloatArray, poses: FloatArray) -> FloatArray:
        return np.asarray(draws @ (self.totals @ poses) / (draws @ self.counts @ poses))


@dataclass(frozen=True, eq=False)
class LearningCurve:
    """A fitted law with laws of resampled poses as its uncertainty.

    Attributes:
        law: law fitted to the mean errors, then scaled so that it equals the mean error with the
            most poses.
        exponent_is_fitted: True if the errors determine the exponent; else it is `USUAL_EXPONENT`.
        resampled_laws: laws of resampled poses; exponents that are not fitted are drawn from
            `EXPONENTS`.
    """

    law: PowerLaw
    exponent_is_fitted: bool
    resampled_laws: tuple[PowerLaw, ...]

    def interval(self, n: float, now: float) -> tuple[float, float]:
        """Return the interval of the error [m] with n poses over the resampled laws.

        Its confidence is `CONFIDENCE`. The error with `now` poses is assumed to be exact.
        """
        shares = [law(n) / law(now) if law(now) > 0.0 else 1.0 for law in self.resampled_laws]
        tail = 0.5 * (1.0 - CONFIDENCE)
        low, high = self.law(now) * np.quantile(shares, [tail, 1.0 - tail])
        return float(low), float(high)


def learning_curve(
    errors: CurveErrors, *, resamples: int = RESAMPLES, seed: int = 0
) -> LearningCurve:
    """Fit the law to the mean errors and to errors of resampled poses."""
    sizes, means = errors.sizes.astype(np.float64), errors.mean
    drawn = errors.resampled(resamples, seed)
    free = [power_law(sizes, errors) for errors in drawn]
    exponent_is_fitted = float(np.std([law.c for law in free])) <= MAX_EXPONENT_SD
    law = power_law(sizes, means, None if exponent_is_fitted else USUAL_EXPONENT)
    law = law.through(sizes[-1], means[-1])
    if exponent_is_fitted:
        return LearningCurve(law, exponent_is_fitted, tuple(free))
    exponents = np.random.default_rng([seed, 1]).uniform(*EXPONENTS, resamples)
    resampled_laws = (
        power_law(sizes, drawn_means, c) for drawn_means, c in zip(drawn, exponents, strict=True)
    )
    return LearningCurve(law, exponent_is_fitted, tuple(resampled_laws))


def power_law(sizes: FloatArray, errors: FloatArray, exponent: float | None = None) -> PowerLaw:
    """Fit a law by least squares of relative errors.

    `sizes` are (s,) numbers of poses, `errors` are in m. With an `exponent` of None the exponent is
    fitted, too: for a given exponent the law is linear in a and b, so the search is over c only.
    """
    from scipy.optimize import minimize_scalar, nnls  # slow import, needed only for a curve

    least = errors.max() * 1e-9
    weights = 1.0 / np.maximum(errors, least) if least else np.ones(len(errors))

    def linear(c: float) -> tuple[FloatArray, float]:
        matrix = np.stack([np.ones(len(sizes)), (sizes / sizes[0]) ** -c], axis=1)
        coefficients, residual = nnls(matrix * weights[:, None], errors * weights)
        return np.asarray(coefficients), float(residual)

    if exponent is None:
        low, high = np.log(EXPONENT_BOUNDS)
        optimum = minimize_scalar(
            lambda t: linear(float(np.exp(t)))[1], bounds=(low, high), method="bounded"
        )
        exponent = float(np.exp(optimum.x))
    a, b = linear(exponent)[0]
    return PowerLaw(float(a), float(b * sizes[0] ** exponent), exponent)
