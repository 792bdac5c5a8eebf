"""How many epochs a network is trained: chosen by cross-validation inside the training samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stiff_protocols.contract.types import FloatArray, IntArray, Samples

LENGTHS = (0, 10, 30, 100, 400)
"""Numbers of epochs to choose from."""
FOLDS = 5

HeldOutErrors = Callable[[IntArray, IntArray], FloatArray]
"""Trains on these rows and returns the (n_lengths, n) errors of those rows, after each length."""


def lengths_up_to(longest: int) -> tuple[int, ...]:
    """Return the numbers of epochs to choose from where the longest training is given."""
    return (*(length for length in LENGTHS if length < longest), longest)


def chosen_epochs(
    samples: Samples, lengths: tuple[int, ...], errors_of: HeldOutErrors, seed: int
) -> int:
    """Return the fewest epochs whose error is no more than a standard error above the least.

    The error is the mean over the poses, in `FOLDS`-fold cross-validation by pose; the standard
    error is that of the difference from the best length, pose by pose (the one-standard-error rule
    of Breiman et al. 1984, on paired differences). A single pose cannot be divided: the longest.
    """
    poses, pose_of_row = np.unique(samples.pose_id, return_inverse=True)
    if len(poses) < 2:
        return lengths[-1]
    fold_of_pose = np.random.default_rng(seed).permutation(len(poses)) % FOLDS
    fold_of_row = fold_of_pose[pose_of_row]
    errors = np.empty((len(lengths), len(samples)))
    for fold in np.unique(fold_of_pose):
        held_out = fold_of_row == fold
        errors[:, held_out] = errors_of(np.flatnonzero(~held_out), np.flatnonzero(held_out))
    rows_a_pose = np.bincount(pose_of_row)
    of_poses = np.stack([np.bincount(pose_of_row, row) / rows_a_pose for row in errors])
    best = of_poses[of_poses.mean(axis=1).argmin()]
    for length, error in zip(lengths, of_poses, strict=True):
        more = error - best
        if more.mean() <= more.std(ddof=1) / np.sqrt(len(poses)):
            return length
    return lengths[-1]  # not reached: the best is within
