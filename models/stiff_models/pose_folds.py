"""Divide samples by pose into folds, to estimate a model's error at left-out poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stiff_protocols.contract.types import IntArray, Samples

FOLDS = 5
"""Number of folds; each leaves out a part of the poses to estimate a model's error there."""


def folds_of_poses(samples: Samples, seed: int) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield the training rows and the left-out rows of each fifth of the poses.

    With fewer than `FOLDS` poses (at least two), each fold leaves out one pose.
    """
    from sklearn.model_selection import GroupKFold  # slow, and a fitted model does not need it

    n_folds = min(FOLDS, len(np.unique(samples.pose_id)))
    folds = GroupKFold(n_folds, shuffle=True, random_state=seed)
    yield from folds.split(samples.q, groups=samples.pose_id)


def left_out_fifths(samples: Samples, seed: int) -> Iterator[tuple[Samples, Samples]]:
    """Yield the samples of `folds_of_poses`."""
    for learned, left_out in folds_of_poses(samples, seed):
        yield samples.take(learned), samples.take(left_out)
