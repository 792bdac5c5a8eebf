"""A Gaussian process of a robot's deflection, made of one process per virtual spring.

A virtual spring s turns (or slides) by phi_s(tau) under the torque (or force) tau, and the
deflection is measured loaded minus unloaded:

    d(q, w) = sum_s a_s(q) [phi_s(tau_g,s + tau_s) - phi_s(tau_g,s)] + r(q, w) + noise,

a_s the spring's translational column of the Jacobian at the TCP, tau_s the torque of the load,
tau_g,s the torque of the weights. With the spring's torque scale T_s, every curve has the
covariance

    c_s^2 [t t' + n_s^2 T_s^2 k(|t - t'| / (l T_s))],  k(x) = (1 + sqrt(3) x) exp(-sqrt(3) x),

a straight line of unknown slope plus a Matern 3/2 (Rasmussen and Williams 2006, ch. 4). A joint's
own spring also has lost motion of unknown size, within a width h T_s that all gears share. It has
two parts: c_s m T_s atan(t / (h T_s)) of the curve, and 2 c_s m' T_s atan(tau_s / (2 h T_s)). The
second occurs again under every load, from any position of the gear (hysteresis, Masing's rule). The
small remainder r is zero without a load: its covariance is the scalar product of two scaled loads
times a Matern 5/2 of pose and load. The remainder is independent between the axes; the axes share
the curves.

Shapes: a "row" is one axis of one sample; matrices over rows have the order axis, then sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotri

from stiff_models.regressors.gaussian_process import Covariance, row_blocks
from stiff_protocols.contract.arrays import BoolArray, FloatArray, IntArray
from stiff_protocols.contract.errors import ModelError

ROOT3 = math.sqrt(3.0)
NEAR_ZERO = 0.05
"""Largest share of a spring's largest torque that takes up half of a lost motion. On simulated
robots the fits give 0.01 to 0.04 if all gears are RV gears, which have lost motion, and 0.15 to
0.5 if all are strain-wave gears, which have a soft first slope instead."""


@dataclass(frozen=True, eq=False)
class SpringLoads:
    """Torques of virtual springs at n samples, and the remainder's features.

    Attributes:
        move: (n_springs, 3, n) a_s, m/rad or m/m.
        unloaded: (n_springs, n) torque of the weights, N m or N.
        loaded: (n_springs, n) torque of the weights and the load.
        pose: (n, n_features) pose features of the remainder.
        load: (n, 6) wrenches, each component divided by its largest value in the training samples.
    """

    move: FloatArray
    unloaded: FloatArray
    loaded: FloatArray
    pose: FloatArray
    load: FloatArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.load)

    @property
    def features(self) -> FloatArray:
        """(n, n_features + 6) features of pose and load."""
        return np.hstack([self.pose, self.load])

    @property
    def torque_range(self) -> tuple[FloatArray, FloatArray]:
        """(n_springs,) lowest and highest torque, with the load and without it."""
        torques = np.concatenate([self.loaded, self.unloaded], axis=1)
        return torques.min(axis=1), torques.max(axis=1)

    def effects(self, turn: FloatArray) -> FloatArray:
        """Return the (n_springs, 3 n) deflection [m] by each spring, for (n_springs, n) turns."""
        return np.asarray((self.move * turn[:, None]).reshape(len(turn), -1))

    def take(self, rows: slice | IntArray) -> SpringLoads:
        """Return the samples of a slice or of row numbers."""
        return SpringLoads(
            self.move[:, :, rows],
            self.unloaded[:, rows],
            self.loaded[:, rows],
            self.pose[rows],
            self.load[rows],
        )


@dataclass(frozen=True, eq=False)
class SpringCovariance:
    """Covariance of deflections by virtual springs.

    Attributes:
        slope: (n_springs,) variance of each curve's slope, c_s^2, (rad/(N m))^2.
        bend: (n_springs,) variance of each curve's Matern part, (c_s n_s T_s)^2, rad^2.
        lost: (2, n_springs) variances of lost motion, (c_s m T_s)^2 and (c_s m' T_s)^2, rad^2; 0:
            no lost motion.
        width: h, in units of T_s.
        length: l, length of the Matern part in units of T_s.
        scale: (n_springs,) T_s, N m.
        noise: variance of a measured deflection's error, m^2.
        remainder: covariance of r [m^2] by `SpringLoads.features`; None: no remainder.
    """

    slope: FloatArray
    bend: FloatArray
    lost: FloatArray
    width: float
    length: float
    scale: FloatArray
    noise: float
    remainder: Covariance | None

    def between(self, first: SpringLoads, second: SpringLoads) -> FloatArray:
        """Return the (3 n, 3 m) covariance of deflections without noise, m^2."""
        left_over = None if self.remainder is None else self.remainder_between(first, second)

        def turned(rows: slice) -> FloatArray:
            return np.asarray(self.turns(first.take(rows), second, _matern32)[0])

        return self.assembled(first, second, turned, left_over)

    def assembled(
        self,
        first: SpringLoads,
        second: SpringLoads,
        turned: Callable[[slice], FloatArray],
        left_over: FloatArray | None,
    ) -> FloatArray:
        """Return `between` from its parts: `turns` of rows of `first`, and `remainder_between`."""
        matrix = (self.regressor(first).T * self.term_variance) @ self.regressor(second)
        blocks = matrix.reshape(3, len(first), 3, len(second))
        weighed = (first.move * self.bend[:, None, None]).transpose(2, 1, 0)
        for rows in row_blocks(len(first), len(self.scale) * max(1, len(second))):
            turns = turned(rows)
            for axis in range(3):
                part = weighed[rows] @ (turns * second.move[:, axis])
                blocks[:, rows, axis] += part.transpose(1, 0, 2)
        if left_over is not None:
            for axis in range(3):
                blocks[axis, :, axis] += left_over
        return matrix

    def turns(
        self,
        first: SpringLoads,
        second: SpringLoads,
        *parts: Callable[[FloatArray], FloatArray],
    ) -> FloatArray:
        """Return the (n_parts, n, n_springs, m) correlations of turns, loaded minus unloaded.

        `parts` are functions of distances. `_matern32` must be the last: it overwrites them.
        """
        n, m, unit = len(first), len(second), ROOT3 / self.unit_length[:, None]
        rows, columns = (
            unit * np.hstack([loads.loaded, loads.unloaded]) for loads in (first, second)
        )
        turned = np.empty((len(parts), n, len(unit), m))
        for s in range(len(unit)):
            apart = np.abs(np.subtract.outer(rows[s], columns[s]))
            for out, part in zip(turned[:, :, s], parts, strict=True):
                k = part(apart)
                out[:] = k[:n, :m] + k[n:, m:] - k[:n, m:] - k[n:, :m]
        return turned

    def remainder_between(self, first: SpringLoads, second: SpringLoads) -> FloatArray:
        """Return the (n, m) covariance of one axis of the remainder, m^2; it must exist."""
        assert self.remainder is not None
        scaled = map(self.remainder.scaled, (first.features, second.features))
        return self.remainder.between(*scaled) * (first.load @ second.load.T)

    @property
    def unit_length(self) -> FloatArray:
        """(n_springs,) length of each curve's Matern part, N m or N."""
        return self.scale * self.length

    def regressor(self, loads: SpringLoads) -> FloatArray:
        """Return the (n_terms, 3 n) deflection [m] by straight lines, then lost motions of 1."""
        straight = loads.effects(loads.loaded - loads.unloaded)
        return np.concatenate([straight, self.lost_effects(loads, self.lost_motion(loads))])

    @property
    def term_variance(self) -> FloatArray:
        """(n_terms,) variance of each term of the regressor."""
        return np.concatenate([self.slope, self.lost[self.lost > 0.0]])

    def lost_motion(self, loads: SpringLoads) -> FloatArray:
        """Return the (2, n_springs, n) turns by lost motions of size 1, loaded minus unloaded."""
        loaded, unloaded, load = self._in_widths(loads)
        return np.stack([np.arctan(loaded) - np.arctan(unloaded), 2.0 * np.arctan(load)])

    def lost_motion_slope(self, loads: SpringLoads) -> FloatArray:
        """Return the derivative of `lost_motion` by ln h."""
        loaded, unloaded, load = (x / (1.0 + x**2) for x in self._in_widths(loads))
        return np.stack([unloaded - loaded, -2.0 * load])

    def _in_widths(self, loads: SpringLoads) -> tuple[FloatArray, FloatArray, FloatArray]:
        unit = 1.0 / (self.width * self.scale)[:, None]
        loaded, unloaded = unit * loads.loaded, unit * loads.unloaded
        return loaded, unloaded, 0.5 * (loaded - unloaded)

    def lost_effects(self, loads: SpringLoads, turns: FloatArray) -> FloatArray:
        """Return the (n_lost, 3 n) deflection [m] by (2, n_springs, n) lost motions."""
        return np.concatenate(
            [loads.effects(turn)[size > 0.0] for turn, size in zip(turns, self.lost, strict=True)]
        )

    def variance(self, loads: SpringLoads) -> FloatArray:
        """Return the (3 n,) variance of deflections without noise, m^2."""
        load = loads.loaded - loads.unloaded
        apart = np.abs(load) * (ROOT3 / self.unit_length)[:, None]
        curve = (self.bend * 2.0)[:, None] * (1.0 - _matern32(apart))
        curve += self.slope[:, None] * load**2
        curve += (self.lost[..., None] * self.lost_motion(loads) ** 2).sum(axis=0)
        variance = np.einsum("sn,skn->kn", curve, loads.move**2)
        if self.remainder is not None:
            variance += self.remainder.variance * (loads.load**2).sum(axis=1)
        return np.asarray(variance.ravel())


def _matern32(distance: FloatArray) -> FloatArray:
    """Return k of distances in units of the length over the root of 3; they are overwritten."""
    decay = np.exp(-distance)
    distance += 1.0
    distance *= decay
    return distance


def _matern32_slope(distance: FloatArray) -> FloatArray:
    """Return the derivative of k by the logarithm of the length."""
    return np.asarray(distance**2 * np.exp(-distance))


def likelihood_slopes(
    covariance: SpringCovariance, loads: SpringLoads, deflection: FloatArray
) -> LikelihoodSlopes:
    """Return the log marginal likelihood of (3, n) deflections [m], and its derivatives.

    The value is minus infinity, and the slopes are zero, if rounding leaves the covariance without
    a Cholesky factor.
    """
    n, n_springs, move, outputs = len(loads), len(covariance.scale), loads.move, deflection.ravel()
    regressor, bend, remainder = covariance.regressor(loads), covariance.bend, covariance.remainder
    bent, turned = covariance.turns(loads, loads, _matern32_slope, _matern32)
    left_over = None
    if remainder is not None:
        scaled, shares = remainder.scaled(loads.features), loads.load @ loads.load.T
        left_over, stretch = (part * shares for part in remainder.with_slope(scaled))
    matrix = covariance.assembled(loads, loads, turned.__getitem__, left_over)
    matrix[np.diag_indices(3 * n)] += covariance.noise
    try:
        # the matrix is symmetric: its transpose is in the order that LAPACK writes over
        factor = cholesky(matrix.T, lower=True, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        return LikelihoodSlopes.nothing(n_springs)
    weights = cho_solve((factor, True), outputs, check_finite=False)
    value = -0.5 * float(outputs @ weights) - float(np.log(np.diag(factor)).sum())
    value -= 1.5 * n * math.log(2.0 * math.pi)

    # the gain (3 n, 3 n): a change of the value is its sum with the change of the covariance
    gain = np.multiply.outer(0.5 * weights, weights)
    inverse, _ = dpotri(factor, lower=1, overwrite_c=1)  # its lower triangle, zeros above
    inverse *= -0.5
    gain += inverse
    inverse[np.diag_indices(len(inverse))] = 0.0
    gain += inverse.T
    shifts, columns = move.transpose(2, 0, 1), gain.reshape(3, n, 3, n).transpose(2, 1, 0, 3)
    by_turn = sum((shifts @ columns[axis]) * move[:, axis] for axis in range(3))
    by_remainder, by_features = 0.0, np.zeros(0)
    if remainder is not None:
        part = np.einsum("anam->nm", gain.reshape(3, n, 3, n))
        by_remainder = 2.0 * float(np.vdot(part, left_over))
        part = part * stretch
        by_features = part.sum(axis=0) @ scaled**2 - (scaled * (part @ scaled)).sum(axis=0)
    gained, is_lost = regressor @ gain, covariance.lost > 0.0
    by_term, by_lost = np.einsum("si,si->s", gained, regressor), np.zeros(is_lost.shape)
    by_lost[is_lost] = by_term[n_springs:]
    widened = covariance.lost_effects(loads, covariance.lost_motion_slope(loads))
    by_width = covariance.lost[is_lost] @ np.einsum("si,si->s", gained[n_springs:], widened)
    return LikelihoodSlopes(
        value=value,
        by_slope=by_term[:n_springs],
        by_bend=np.einsum("isj,isj->s", by_turn, turned),
        by_lost=by_lost,
        by_width=2.0 * float(by_width),
        by_length=float(bend @ np.einsum("isj,isj->s", by_turn, bent)),
        by_noise=float(np.trace(gain)),
        by_remainder=by_remainder,
        by_features=2.0 * by_features,
    )


@dataclass(frozen=True, eq=False)
class LikelihoodSlopes:
    """A log marginal likelihood and its derivatives.

    Attributes:
        value: log marginal likelihood.
        by_slope, by_bend: (n_springs,) by the variances with these names.
        by_lost: (2, n_springs) by the variances of lost motion.
        by_width, by_length: by ln h and ln l.
        by_noise: by the noise's variance.
        by_remainder: by the logarithm of the remainder's standard deviation; 0 without it.
        by_features: (n_features,) by the logarithms of the remainder's length scales.
    """

    value: float
    by_slope: FloatArray
    by_bend: FloatArray
    by_lost: FloatArray
    by_width: float
    by_length: float
    by_noise: float
    by_remainder: float
    by_features: FloatArray

    @classmethod
    def nothing(cls, n_springs: int) -> LikelihoodSlopes:
        """Return minus infinity, without slopes."""
        zero = np.zeros(n_springs)
        return cls(-math.inf, zero, zero, np.zeros((2, n_springs)), 0.0, 0.0, 0.0, 0.0, zero)


@dataclass(frozen=True, eq=False)
class SpringProcess:
    """The process given its training samples.

    Attributes:
        covariance: hyperparameters.
        loads: torques in the training samples.
        factor: (3 n, 3 n) lower Cholesky factor of the training deflections' covariance.
        weights: (3 n,) inverse of that covariance times the deflections.
    """

    covariance: SpringCovariance
    loads: SpringLoads
    factor: FloatArray
    weights: FloatArray

    @classmethod
    def of(
        cls, covariance: SpringCovariance, loads: SpringLoads, deflection: FloatArray
    ) -> SpringProcess:
        """Return the process given (3, n) deflections, m; ModelError if it cannot be solved."""
        matrix = covariance.between(loads, loads)
        matrix[np.diag_indices(len(matrix))] += covariance.noise
        try:
            factor = cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)
        except np.linalg.LinAlgError as error:
            raise ModelError(
                f"the Gaussian process of {len(loads)} samples cannot be solved: {error}; remove "
                "duplicated samples"
            ) from error
        weights = cho_solve((factor, True), deflection.ravel(), check_finite=False)
        return cls(covariance, loads, factor, weights)

    @property
    def log_likelihood(self) -> float:
        """Log marginal likelihood of the training deflections, without its constant."""
        energy = float(((self.factor.T @ self.weights) ** 2).sum())
        return -0.5 * energy - float(np.log(np.diag(self.factor)).sum())

    def mean(self, loads: SpringLoads) -> FloatArray:
        """Return the (n, 3) predicted deflection, m: the sum of each curve's mean effect."""
        covariance, training = self.covariance, self.loads
        # straight line and lost motion: the mean of each is a number
        sizes = covariance.term_variance * (covariance.regressor(training) @ self.weights)
        mean = (sizes @ covariance.regressor(loads)).reshape(3, -1)
        shares = np.einsum("skn,kn->sn", training.move, self.weights.reshape(3, -1))
        for s in np.flatnonzero(covariance.bend):
            knots = np.concatenate([training.loaded[s], training.unloaded[s]])
            height = covariance.bend[s] * np.concatenate([shares[s], -shares[s]])
            curve = partial(_curve_mean, knots, height, ROOT3 / covariance.unit_length[s])
            mean += loads.move[s] * (curve(loads.loaded[s]) - curve(loads.unloaded[s]))
        if covariance.remainder is not None:
            for rows in row_blocks(len(loads), len(training)):
                part = covariance.remainder_between(loads.take(rows), training)
                mean[:, rows] += self.weights.reshape(3, -1) @ part.T
        return mean.T

    def mean_and_deviation(self, loads: SpringLoads) -> tuple[FloatArray, FloatArray]:
        """Return the (n, 3) predicted deflection and its standard deviation with noise, m."""
        mean = np.empty((len(loads), 3))
        variance = self.covariance.variance(loads).reshape(3, -1).T + self.covariance.noise
        for rows in row_blocks(len(loads), 9 * len(self.loads)):
            between = self.covariance.between(loads.take(rows), self.loads)
            mean[rows] = (between @ self.weights).reshape(3, -1).T
            solved = solve_triangular(self.factor, between.T, lower=True, check_finite=False)
            variance[rows] -= np.einsum("ij,ij->j", solved, solved).reshape(3, -1).T
        return mean, np.sqrt(np.maximum(variance, self.covariance.noise))

    def between(self, loads: SpringLoads, second: SpringLoads) -> FloatArray:
        """Return the (3, n, m) covariance of each axis at two sets of samples, noise excluded."""
        covariance = self.covariance
        solved = cho_solve((self.factor, True), covariance.between(self.loads, second))
        posterior = covariance.between(loads, second)
        posterior -= covariance.between(loads, self.loads) @ solved
        blocks = posterior.reshape(3, len(loads), 3, len(second))
        return np.stack([blocks[axis, :, axis] for axis in range(3)])

    def curve(self, spring: int, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the (n,) turn of a spring and its (n, n) covariance, rad and rad^2 (m and m^2).

        `torque` (n,) [N m or N] loads a previously unloaded spring.
        """
        n, (n_springs, _, _) = len(torque), self.loads.move.shape
        move, loaded = np.zeros((n_springs, 3, n)), np.zeros((n_springs, n))
        move[spring, 0], loaded[spring] = 1.0, torque
        pose, load = np.zeros((n, self.loads.pose.shape[1])), np.zeros((n, 6))
        # the other springs and the remainder, which gets no load, have no effect
        single_spring = SpringLoads(move, np.zeros_like(loaded), loaded, pose, load)
        return self.mean(single_spring)[:, 0], self.between(single_spring, single_spring)[0]

    def lost_motion(self, springs: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the (n_chosen,) widths of lost motions and their standard deviation, rad or m.

        A width is the turn by both parts inside the training samples' torques: by the first from
        the lowest torque to the highest, by the second from the lowest load to the highest.
        """
        loads, lost, (lowest, highest) = self.loads, self.covariance.lost, self.loads.torque_range
        unit = 1.0 / (self.covariance.width * self.covariance.scale)
        load = loads.loaded - loads.unloaded
        least, most = load.min(axis=1, initial=0.0), load.max(axis=1, initial=0.0)
        first = np.arctan(unit * highest) - np.arctan(unit * lowest)
        second = 2.0 * (np.arctan(0.5 * unit * most) - np.arctan(0.5 * unit * least))
        inside = np.stack([first, second])
        prior = (lost * inside**2).sum(axis=0)[springs]
        effects = [loads.effects(turn) for turn in self.covariance.lost_motion(loads)]
        between = np.einsum("ps,psr->sr", lost * inside, effects)[springs]
        solved = solve_triangular(self.factor, between.T, lower=True, check_finite=False)
        variance = prior - np.einsum("ij,ij->j", solved, solved)
        return between @ self.weights, np.sqrt(np.maximum(variance, 0.0))

    def is_lost_motion(self, springs: IntArray) -> BoolArray:
        """Return whether half of each lost motion is taken up near zero torque, (n_chosen,).

        Otherwise the term describes a soft first slope of the curve.
        """
        largest = np.abs(self.loads.torque_range).max(axis=0)
        half = self.covariance.width * self.covariance.scale
        return np.asarray((half <= NEAR_ZERO * largest)[springs])


def _curve_mean(
    knots: FloatArray, height: FloatArray, unit: float, torque: FloatArray
) -> FloatArray:
    """Return the (n,) sum of Matern functions at (m,) knots of these heights."""
    mean = np.empty(len(torque))
    for rows in row_blocks(len(torque), len(knots)):
        apart = np.abs(unit * torque[rows, None] - unit * knots)
        mean[rows] = _matern32(apart) @ height
    return mean
