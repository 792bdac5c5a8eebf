"""Linear models whose groups of coefficients have scales: most probable scales, and posterior.

Readings y of n samples, up to m numbers each, are y = F b + e. The coefficients are
b_k ~ N(0, s_g^2) for the group g of column k. The errors of different samples are independent,
e_i ~ N(0, sum_m s_m^2 B_mi) with m x m blocks B. The scales s maximise

    ln p(y | s) - sum s / typical,

the marginal likelihood with an exponential prior on each scale. Its mode is 0, so a group that is
not needed vanishes (MacKay 1992). Everything is computed in the space of the p columns: with the
errors' Cholesky factor L, F' = L^-1 F and D = diag(s),
ln|F D^2 F^T + L L^T| = 2 ln|L| + ln|1 + D F'^T F' D|.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray

LEAST, MOST = float(np.exp(-7.0)), float(np.exp(3.0))
"""Bounds of a scale over its typical value; at the lower one a group has vanished."""
VANISHED = 1.6 * LEAST
FREEDOM, MOST_WEIGHT = 4.0, 1.3
"""Of Student's t distribution, and of the weight of a sample."""
TOLERANCE = 1e-6
"""Least relative gain of a step of the search."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Coefficients given the readings.

    Attributes:
        mean: (p,) coefficients.
        root: (p, p) matrix whose product with its transpose is their covariance.
        weighted: (n, m) inverse covariance of the readings, times the readings.
        precision: (n, m) diagonal of that inverse covariance.
        is_read: (n, m) as `GroupedModel.is_read`.
    """

    mean: FloatArray
    root: FloatArray
    weighted: FloatArray
    precision: FloatArray
    is_read: BoolArray

    def student_weights(self, noise: float, weights: FloatArray) -> FloatArray:
        """Return the next (n,) weights of samples, as Student's t distribution gives them.

        `noise` is the standard deviation of an independent error [m], `weights` are the current
        ones.
        """
        variance = (noise**2 / weights)[:, None]
        error = variance * self.weighted
        squares = (error**2 + variance - variance**2 * self.precision) * self.is_read
        total, counts = squares.sum(axis=1) / noise**2, self.is_read.sum(axis=1)
        return np.asarray(np.minimum((FREEDOM + counts) / (FREEDOM + total), MOST_WEIGHT))


@dataclass(frozen=True, eq=False)
class GroupedModel:
    """A linear model with groups of columns.

    Attributes:
        columns: (n, m, p) F, m; 0 where nothing is read.
        group_of: (p,) group of each column.
        blocks: (n_blocks, n, m, m) B, m^2; the last ones are of independent errors.
        typical: (n_groups + n_blocks,) typical scales; infinite: only the bounds count.
        bounds: (n_groups + n_blocks, 2) bounds of the scales.
        is_read: (n, m) true for numbers that were read.
    """

    columns: FloatArray
    group_of: IntArray
    blocks: FloatArray
    typical: FloatArray
    bounds: FloatArray
    is_read: BoolArray

    @property
    def n_groups(self) -> int:
        """Number of groups; the scales of errors follow."""
        return len(self.typical) - len(self.blocks)

    def take(self, rows: IntArray) -> GroupedModel:
        """Return the model of some samples."""
        return replace(
            self,
            columns=self.columns[rows],
            blocks=self.blocks[:, rows],
            is_read=self.is_read[rows],
        )

    def weighted(self, weights: FloatArray) -> GroupedModel:
        """Return the model with (n,) weights of the samples' independent errors, the last kind."""
        independent = diagonals(self.is_read) / weights[:, None, None]
        return replace(self, blocks=np.concatenate([self.blocks[:-1], independent[None]]))

    def searched(self, readings: FloatArray, start: FloatArray, most_steps: int) -> FloatArray:
        """Return the most probable scales for (n, m) readings [m]; a vanished group has 0."""

        def loss(logs: Any) -> tuple[float, Any]:  # scipy's types know no such arrays
            return self._loss(readings, np.exp(logs))

        limits: Any = np.log(self.bounds)
        options: Any = {"maxiter": most_steps, "ftol": TOLERANCE, "maxcor": 20}
        optimum = minimize(
            loss,
            np.log(np.clip(start, *self.bounds.T)),
            jac=True,
            method="L-BFGS-B",
            bounds=limits.tolist(),
            options=options,
        )
        scales = np.exp(optimum.x)
        has_vanished = np.isfinite(self.typical) & (scales < VANISHED * self.typical)
        return np.where(has_vanished, 0.0, scales)

    def posterior(self, readings: FloatArray, scales: FloatArray) -> Posterior:
        """Return the coefficients given (n, m) readings [m]."""
        white = self._whitened(readings, scales)
        root = solve_triangular(white.factor, np.diag(white.deviations), lower=True).T
        fitted = white.spread @ white.readings
        back = white.inverse.swapaxes(1, 2)
        residual = (white.readings - white.spread.T @ fitted).reshape(*self.is_read.shape, 1)
        precision = np.diagonal(back @ white.outside @ white.inverse, axis1=1, axis2=2)
        return Posterior(root @ fitted, root, (back @ residual)[..., 0], precision, self.is_read)

    def error_variance(self, scales: FloatArray) -> FloatArray:
        """Return the (n, m) variances [m^2] of the readings' errors."""
        total = np.tensordot(scales[self.n_groups :] ** 2, self.blocks, axes=1)
        return np.asarray(np.diagonal(total, axis1=1, axis2=2))

    def _whitened(self, readings: FloatArray, scales: FloatArray) -> _Whitened:
        groups, errors = np.split(scales, [self.n_groups])
        covariance = np.tensordot(errors**2, self.blocks, axes=1) + diagonals(~self.is_read)
        error_root = np.linalg.cholesky(covariance)
        inverse = np.linalg.inv(error_root)
        return _Whitened(
            (inverse @ self.columns).reshape(readings.size, -1),
            (inverse @ readings[..., None]).reshape(-1),
            groups[self.group_of],
            inverse,
        )

    def _loss(self, readings: FloatArray, scales: FloatArray) -> tuple[float, FloatArray]:
        """Return the negative log-probability, and its derivatives by the scales' logarithms."""
        white, shares = self._whitened(readings, scales), scales / self.typical
        fitted = white.spread @ white.readings
        value = 0.5 * float(white.readings @ white.readings - fitted @ fitted) + float(
            np.log(np.diag(white.factor)).sum()
            - np.log(np.diagonal(white.inverse, axis1=1, axis2=2)).sum()
            + shares.sum()
        )
        explained = white.spread @ white.columns
        pull = white.columns.T @ white.readings - explained.T @ fitted
        by_variance = np.diag(white.gram) - (explained**2).sum(axis=0) - pull**2
        by_group = np.bincount(self.group_of, by_variance, minlength=self.n_groups)
        residual = (white.readings - white.spread.T @ fitted).reshape(self.is_read.shape)
        curvature = white.outside - residual[:, :, None] * residual[:, None]
        curvature = white.inverse.swapaxes(1, 2) @ curvature @ white.inverse
        by_error = np.einsum("mnij,nij->m", self.blocks, curvature)
        return value, scales**2 * np.concatenate([by_group, by_error]) + shares


@dataclass(frozen=True, eq=False)
class _Whitened:
    """Columns and readings in units of the errors.

    Attributes:
        columns: (m n, p) F'.
        readings: (m n,) L^-1 y.
        deviations: (p,) scale of each column.
        inverse: (n, m, m) L^-1.
    """

    columns: FloatArray
    readings: FloatArray
    deviations: FloatArray
    inverse: FloatArray

    @cached_property
    def gram(self) -> FloatArray:
        """(p, p) F'^T F'."""
        return np.asarray(self.columns.T @ self.columns)

    @cached_property
    def factor(self) -> FloatArray:
        """(p, p) Cholesky factor of 1 + D F'^T F' D."""
        scaled = self.deviations[:, None] * self.gram * self.deviations
        return np.asarray(cholesky(np.eye(len(scaled)) + scaled, lower=True))

    @cached_property
    def spread(self) -> FloatArray:
        """(p, m n) the factor's inverse times D F'^T."""
        scaled = self.deviations[:, None] * self.columns.T
        return np.asarray(solve_triangular(self.factor, scaled, lower=True))

    @cached_property
    def outside(self) -> FloatArray:
        """(n, m, m) blocks of the whitened readings' inverse covariance."""
        shape = len(self.spread), *self.inverse.shape[:2]
        of_sample = np.ascontiguousarray(self.spread.reshape(shape).transpose(1, 2, 0))
        return np.asarray(np.eye(shape[2]) - of_sample @ of_sample.swapaxes(1, 2))


def diagonals(is_on: BoolArray) -> FloatArray:
    """Return (n, m, m) diagonal matrices with 1 where (n, m) `is_on` is true."""
    return np.asarray(np.eye(is_on.shape[1]) * is_on[:, :, None])


def joined(parts: Sequence[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Return the (n, m, p) columns of all groups, and the (p,) group of each column."""
    counts = [part.shape[2] for part in parts]
    return np.concatenate(parts, axis=2), np.repeat(np.arange(len(parts)), counts)
