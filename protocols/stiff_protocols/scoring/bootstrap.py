"""How far would the mean absolute error move with other poses? The cluster bootstrap over poses.

Rows of one pose are alike, so whole poses are drawn, each with all of its rows (several loads,
several splits). The mean error is then a ratio, sum of errors / number of rows, and both parts are
drawn together.

The fitted models are held fixed. The intervals cover other poses of the same kind; that another
training set would have given other models is not in them (`paired.corrected_t` is for that).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, IntArray, TextArray, frozen_array
from stiff_protocols.scoring.paired import LEVEL, check_share

DIFFERENCE_RESAMPLES = 9999
RANK_RESAMPLES = 2000
BATCH = 500
"""Resamples that are held in memory at once."""


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """The absolute errors of one model, summed pose by pose.

    Attributes:
        poses: (p,) name of each pose, sorted.
        totals: (p, k) sum of the absolute errors of its rows, m, one column a direction.
        counts: (p,) number of rows that were summed.
    """

    poses: TextArray
    totals: FloatArray
    counts: IntArray

    @property
    def mean(self) -> FloatArray:
        """The (k,) mean absolute error over all rows, m."""
        return np.asarray(self.totals.sum(axis=0) / self.counts.sum())


@dataclass(frozen=True, eq=False)
class Difference:
    """MAE of A less MAE of B and the bounds of its interval, (k,) m; below 0 A is better."""

    mean: FloatArray
    low: FloatArray
    high: FloatArray


def pose_errors(pose_id: ArrayLike, errors: ArrayLike) -> PoseErrors:
    """Sum (n, k) errors [m], signed or absolute, pose by pose; `pose_id` is (n,), in any order.

    Raises:
        DataError: there are no rows, the lengths differ, or an error is no finite number.
    """
    absolute = np.abs(frozen_array(errors, "errors", (None, None)))  # (n, k) m
    names = np.asarray(pose_id, dtype=np.str_)
    if names.shape != (len(absolute),) or not len(absolute):
        raise DataError(
            f"pose_id has shape {names.shape}, expected one pose for each of the "
            f"{len(absolute)} rows of errors, and at least 1 row"
        )
    poses, row_pose, counts = np.unique(names, return_inverse=True, return_counts=True)
    totals = np.zeros((len(poses), absolute.shape[1]))
    np.add.at(totals, row_pose, absolute)
    return PoseErrors(poses, totals, counts)


def pose_differences(a: PoseErrors, b: PoseErrors) -> FloatArray:
    """Return the (p, k) mean difference of each pose, |error of A| - |error of B|, m.

    DataError: A and B were not tested on the same poses, each equally often.
    """
    _check_paired(a, b)
    return np.asarray((a.totals - b.totals) / a.counts[:, None])


def bootstrap_difference(
    a: PoseErrors, b: PoseErrors, *, confidence: float = 1.0 - LEVEL, seed: int = 0
) -> Difference:
    """Return MAE of A less MAE of B with its BCa interval over poses (Efron 1987).

    The intervals of different columns are each of its own, not joint. `confidence` is the
    probability (0..1) that an interval is to have.

    Raises:
        DataError: A and B were not tested on the same poses, each equally often, or on one alone.
        ConfigError: `confidence` does not lie between 0 and 1.
    """
    check_share("confidence", confidence)
    differences = pose_differences(a, b)  # (p, k) m
    if len(differences) < 2:
        raise DataError("a bootstrap over poses needs at least 2 poses, there is 1")
    bounds = [_bca(column, a.counts, confidence, seed) for column in differences.T]
    low, high = np.array(bounds).reshape(-1, 2).T
    mean = _weighted_mean(differences, a.counts[:, None], axis=0)
    return Difference(mean, low, high)


def resampled_means(errors: Sequence[PoseErrors], *, seed: int = 0) -> FloatArray:
    """Return the (B, m) mean errors, m, of m competitors on B draws of the poses, the same for all.

    Each competitor has one column of errors; those with equal errors have exactly equal means.

    Raises:
        DataError: there is no competitor, one has several columns, or they were not tested on the
            same poses, each equally often.
    """
    if not errors:
        raise DataError("resampled means need at least 1 competitor, there are none")
    for one in errors:
        _check_paired(errors[0], one)
        if one.totals.shape[1] != 1:
            raise DataError(
                f"resampled means need one column of errors, there are {one.totals.shape[1]}"
            )
    totals, counts = np.concatenate([one.totals for one in errors], axis=1), errors[0].counts
    draws = _pose_draws(len(counts), seed)  # (B, p)
    means = (draws @ totals) / (draws @ counts.astype(np.float64))[:, None]
    # a matrix product may round equal columns differently, which would break their tie
    contents = [column.tobytes() for column in totals.T]
    return np.asarray(means[:, [contents.index(content) for content in contents]])


@lru_cache(maxsize=8)
def _pose_draws(n_poses: int, seed: int) -> FloatArray:
    """Return (B, p) how often each pose was drawn; read-only, as many calls share it."""
    shares = np.full(n_poses, 1.0 / n_poses)
    draws = np.random.default_rng(seed).multinomial(n_poses, shares, size=RANK_RESAMPLES)
    exact = draws.astype(np.float64)  # products of integers are not BLAS's
    exact.setflags(write=False)
    return exact


def _check_paired(a: PoseErrors, b: PoseErrors) -> None:
    if not (np.array_equal(a.poses, b.poses) and np.array_equal(a.counts, b.counts)):
        raise DataError(
            "only models that were tested on the same poses, each equally often, can be compared"
        )
    if a.totals.shape != b.totals.shape:
        raise DataError(
            f"one model has {a.totals.shape[1]} columns of errors, the other {b.totals.shape[1]}"
        )


def _bca(
    differences: FloatArray, counts: IntArray, confidence: float, seed: int
) -> tuple[float, float]:
    """Return the BCa bounds of the (p,) differences' mean, each weighted by its count.

    Where BCa gives no numbers, they are the percentile interval's.
    """
    from scipy import stats  # it takes longer to import than a leaderboard, which needs none of it

    if np.ptp(differences) == 0.0:  # nothing to resample, and BCa would divide by zero
        return float(differences[0]), float(differences[0])
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        result = stats.bootstrap(
            (differences, counts),
            _weighted_mean,
            n_resamples=DIFFERENCE_RESAMPLES,
            batch=BATCH,
            vectorized=True,
            paired=True,
            confidence_level=confidence,
            method="BCa",
            rng=np.random.default_rng(seed),
        )
    bounds = np.array(result.confidence_interval)
    if not np.isfinite(bounds).all():
        # BCa divides by the cubed spread, which is 0 where poses differ by rounding alone
        tail = 0.5 * (1.0 - confidence)
        bounds = np.quantile(result.bootstrap_distribution, [tail, 1.0 - tail])
    return float(bounds[0]), float(bounds[1])


def _weighted_mean(values: FloatArray, weights: ArrayLike, axis: int) -> FloatArray:
    weights = np.asarray(weights)
    return np.asarray((values * weights).sum(axis=axis) / weights.sum(axis=axis))
