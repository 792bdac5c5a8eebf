"""Ranks with ties. scipy.stats has them too, but takes longer to import than a leaderboard does."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stiff_protocols.types import FloatArray


def ranked(values: ArrayLike) -> FloatArray:
    """Return the ranks within each row: 1 is the smallest value, ties share their mean rank.

    Args:
        values: (..., m); a row that holds NaN has NaN ranks.
    """
    each = np.asarray(values, dtype=np.float64)
    order = np.argsort(each, axis=-1)
    ordered = np.take_along_axis(each, order, axis=-1)
    begins = np.ones(each.shape, dtype=np.bool_)  # a run of ties, which may be of one alone
    begins[..., 1:] = ordered[..., 1:] != ordered[..., :-1]
    starts = np.flatnonzero(begins)
    lengths = np.diff(starts, append=each.size)
    of_runs = starts % each.shape[-1] + 0.5 * (lengths + 1)
    ranks = np.empty_like(each)
    np.put_along_axis(ranks, order, np.repeat(of_runs, lengths).reshape(each.shape), axis=-1)
    ranks[np.isnan(each).any(axis=-1)] = np.nan
    return ranks
