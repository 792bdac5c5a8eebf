"""Cluster bootstrap over poses: the variation of the mean absolute error with other poses.

Rows of a pose are similar, so whole poses are drawn, each with all of its rows (several loads,
several splits). The mean error is then a ratio, sum of errors / number of rows, and both parts are
drawn together.

The fitted models are fixed. The intervals cover other poses of the same kind. They do not cover
other training sets, which would give other models (see `paired.corrected_t`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, IntArray, TextArray, frozen_array

RESAMPLES = 2000


@dataclass(frozen=True, eq=False, repr=False)
class PoseErrors(BriefFields):
    """Absolute errors on the same rows, summed pose by pose; each column a model or a direction.

    Attributes:
        poses: (p,) name of each pose, sorted.
        totals: (p, k) sum of the absolute errors of its rows, m.
        counts: (p,) number of rows that were summed; 0: the pose was not tested.
    """

    poses: TextArray
    totals: FloatArray
    counts: IntArray

    @property
    def mean(self) -> FloatArray:
        """The (k,) mean absolute error over all rows, m."""
        return np.asarray(self.totals.sum(axis=0) / self.counts.sum())

    def differences(self, a: int, b: int) -> FloatArray:
        """Return the (t,) mean differences of two columns on the tested poses, A less B, m."""
        tested = self.counts > 0
        return np.asarray((self.totals[:, a] - self.totals[:, b])[tested] / self.counts[tested])


def pose_errors(pose_id: ArrayLike, errors: ArrayLike, rows: ArrayLike | None = None) -> PoseErrors:
    """Sum errors [m], signed or absolute, pose by pose.

    Args:
        pose_id: (N,) pose of each row of the data set, in any order.
        errors: (n, k) errors of the tested rows.
        rows: (n,) their numbers, with repetitions for rows tested twice; None: all rows.

    Raises:
        DataError: `errors` is empty, the lengths differ, or an error is not a finite number.
    """
    absolute = np.abs(frozen_array(errors, "errors", (None, None)))  # (n, k) m
    poses, pose_of_row = np.unique(np.asarray(pose_id, dtype=np.str_), return_inverse=True)
    tested = pose_of_row if rows is None else pose_of_row[np.asarray(rows)]
    if tested.shape != (len(absolute),) or not len(absolute):
        raise DataError(
            f"pose_id has shape {tested.shape}, expected one pose for each of the "
            f"{len(absolute)} rows of errors, and at least 1 row"
        )
    totals = [np.bincount(tested, weights=column, minlength=len(poses)) for column in absolute.T]
    counts = np.bincount(tested, minlength=len(poses))
    return PoseErrors(poses, np.column_stack(totals), counts)


def resampled_means(errors: PoseErrors, *, seed: int = 0) -> FloatArray:
    """Return the (B, k) mean errors, m, on B draws of the poses, the same for all k columns.

    Equal columns have exactly equal means. A draw that holds no tested pose has NaN.
    """
    draws = _pose_draws(len(errors.counts), seed)  # (B, p)
    with np.errstate(invalid="ignore"):
        means = (draws @ errors.totals) / (draws @ errors.counts.astype(np.float64))[:, None]
    # a matrix product may round equal columns differently, which would break their tie
    contents = [column.tobytes() for column in errors.totals.T]
    return np.asarray(means[:, [contents.index(content) for content in contents]])


@lru_cache(maxsize=8)
def _pose_draws(n_poses: int, seed: int) -> FloatArray:
    """Return the (B, p) counts of drawn poses; read-only, because many calls share them."""
    shares = np.full(n_poses, 1.0 / n_poses)
    draws = np.random.default_rng(seed).multinomial(n_poses, shares, size=RESAMPLES)
    exact = draws.astype(np.float64)  # products of integers are not BLAS's
    exact.setflags(write=False)
    return exact
