"""What more poses would gain: a power law through the errors of a model on few and many poses.

Whatever it says beyond the poses that were measured is an extrapolation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.types import FloatArray, IntArray

USUAL_EXPONENT = 0.5
"""c where the errors do not tell it: that of most means over samples."""
EXPONENTS = (0.25, 1.0)
"""Between which c may lie for all that is known, where the errors do not tell it."""
EXPONENT_BOUNDS = (0.05, 3.0)
TOLD = 0.15
"""Standard deviation of c over resampled poses up to which the errors tell it."""
RESAMPLES = 200
CONFIDENCE = 0.9


@dataclass(frozen=True)
class PowerLaw:
    """The law ``e(n) = a + b n^-c`` of the mean error.

    Attributes:
        a: m; 0 or more: what no number of poses removes.
        b: m; 0 or more: an error never rises with the number of poses.
        c: exponent.
    """

    a: float
    b: float
    c: float

    def __call__(self, n: float) -> float:
        """Return the error [m] with n poses."""
        return float(self.a + self.b * n**-self.c)


@dataclass(frozen=True, eq=False)
class CurveErrors:
    """Errors of a model that learned from nested subsets of the poses, on poses held out.

    Attributes:
        sizes: (s,) numbers of training poses, rising.
        totals: (d, s, p) sum of the errors of each of p poses in each of d draws, m.
        counts: (d, p) number of rows that were summed; 0: the draw learned from the pose or left
            it out.
    """

    sizes: IntArray
    totals: FloatArray
    counts: IntArray

    @property
    def mean(self) -> FloatArray:
        """The (s,) mean error over all rows, m."""
        return self._mean(np.ones(len(self.counts)), np.ones(self.counts.shape[1]))

    def resampled(self, n: int, seed: int) -> FloatArray:
        """Return (n, s) mean errors of poses, and of draws, drawn with replacement."""
        rng = np.random.default_rng(seed)
        n_draws, n_poses = self.counts.shape
        found: list[FloatArray] = []
        while len(found) < n:
            draws, poses = (
                rng.multinomial(k, np.full(k, 1.0 / k)).astype(np.float64)
                for k in (n_draws, n_poses)
            )
            if draws @ self.counts @ poses > 0.0:  # else no pose was drawn that any draw tested
                found.append(self._mean(draws, poses))
        return np.array(found)

    def _mean(self, draws: FloatArray, poses: FloatArray) -> FloatArray:
        return np.asarray(draws @ (self.totals @ poses) / (draws @ self.counts @ poses))


@dataclass(frozen=True, eq=False)
class LearningCurve:
    """A fitted law, and what it might as well be.

    Attributes:
        law: fitted to the mean errors.
        told: whether the errors tell the exponent; else it is `USUAL_EXPONENT`.
        others: laws of resampled poses; their exponents are drawn from `EXPONENTS` where the errors
            do not tell them.
    """

    law: PowerLaw
    told: bool
    others: tuple[PowerLaw, ...]

    def interval(self, n: float, now: float) -> tuple[float, float]:
        """Return where the error [m] with n poses lies in `CONFIDENCE` of the resampled laws.

        The error with `now` poses counts as known.
        """
        shares = [law(n) / law(now) if law(now) > 0.0 else 1.0 for law in self.others]
        tail = 0.5 * (1.0 - CONFIDENCE)
        low, high = self.law(now) * np.quantile(shares, [tail, 1.0 - tail])
        return float(low), float(high)


def learning_curve(
    errors: CurveErrors, *, resamples: int = RESAMPLES, seed: int = 0
) -> LearningCurve:
    """Fit the law to the mean errors, and to those of resampled poses."""
    sizes, means = errors.sizes.astype(np.float64), errors.mean
    drawn = errors.resampled(resamples, seed)
    free = [power_law(sizes, one) for one in drawn]
    told = float(np.std([law.c for law in free])) <= TOLD
    if told:
        return LearningCurve(power_law(sizes, means), told, tuple(free))
    exponents = np.random.default_rng([seed, 1]).uniform(*EXPONENTS, resamples)
    others = (power_law(sizes, one, c) for one, c in zip(drawn, exponents, strict=True))
    return LearningCurve(power_law(sizes, means, USUAL_EXPONENT), told, tuple(others))


def power_law(sizes: FloatArray, errors: FloatArray, exponent: float | None = None) -> PowerLaw:
    """Return the law of the least squares of relative errors.

    `sizes` are the (s,) numbers of poses, `errors` m; an `exponent` of None is fitted, too. With
    the exponent given the law is linear in a and b; so the exponent alone is searched for.
    """
    from scipy.optimize import minimize_scalar, nnls  # a command without a curve needs none

    least = errors.max() * 1e-9
    weights = 1.0 / np.maximum(errors, least) if least else np.ones(len(errors))

    def linear(c: float) -> tuple[FloatArray, float]:
        matrix = np.stack([np.ones(len(sizes)), (sizes / sizes[0]) ** -c], axis=1)
        found, left = nnls(matrix * weights[:, None], errors * weights)
        return np.asarray(found), float(left)

    if exponent is None:
        low, high = np.log(EXPONENT_BOUNDS)
        found = minimize_scalar(
            lambda t: linear(float(np.exp(t)))[1], bounds=(low, high), method="bounded"
        )
        exponent = float(np.exp(found.x))
    a, b = linear(exponent)[0]
    return PowerLaw(float(a), float(b * sizes[0] ** exponent), exponent)
