"""Generators of row divisions. Nothing here looks at a deflection."""

from __future__ import annotations

import numpy as np
from sklearn.model_selection import GroupShuffleSplit, LeaveOneGroupOut, ShuffleSplit

from stiff_protocols.errors import ConfigError
from stiff_protocols.types import IntArray, Samples, Split

NO_ROWS: IntArray = np.empty(0, dtype=np.int64)


def require_poses(samples: Samples, at_least: int) -> None:
    """Raise ConfigError when there are too few poses to divide."""
    n_poses = len(np.unique(samples.pose_id))
    if n_poses < at_least:
        raise ConfigError(f"the data set has {n_poses} poses, the protocol needs {at_least}")


def inner_validation(samples: Samples, train: IntArray, fraction: float, seed: int) -> Split:
    """Divide training rows by pose into a fitting and a validation part (test stays empty)."""
    parts = GroupShuffleSplit(n_splits=1, test_size=fraction, random_state=seed)
    fit, validate = next(parts.split(train, groups=samples.pose_id[train]))
    return Split(0, np.sort(train[fit]), np.sort(train[validate]), NO_ROWS)


def holdout_by_pose(
    samples: Samples, *, n_splits: int, test_fraction: float, validation_fraction: float, seed: int
) -> list[Split]:
    """Return repeated random divisions by pose, each with an inner validation part."""
    require_poses(samples, 4)
    outer = GroupShuffleSplit(n_splits=n_splits, test_size=test_fraction, random_state=seed)
    splits = []
    for index, (train, test) in enumerate(outer.split(samples.q, groups=samples.pose_id)):
        inner = inner_validation(samples, train, validation_fraction, seed + index)
        splits.append(Split(index, inner.train, inner.validation, np.sort(test)))
    return splits


def holdout_at_random(
    samples: Samples, *, n_splits: int, test_fraction: float, seed: int
) -> list[Split]:
    """Return repeated random divisions by sample whose test rows are also the validation rows."""
    require_poses(samples, 2)
    outer = ShuffleSplit(n_splits=n_splits, test_size=test_fraction, random_state=seed)
    return [
        Split(index, np.sort(train), np.sort(test), np.sort(test))
        for index, (train, test) in enumerate(outer.split(samples.q))
    ]


def leave_one_pose_out(samples: Samples, *, validation_fraction: float, seed: int) -> list[Split]:
    """Return one division a pose, in the order of the data set's first rows of each pose."""
    require_poses(samples, 4)
    splits = [
        (train, test) for train, test in LeaveOneGroupOut().split(samples.q, groups=samples.pose_id)
    ]
    splits.sort(key=lambda rows: int(rows[1][0]))
    result = []
    for index, (train, test) in enumerate(splits):
        inner = inner_validation(samples, train, validation_fraction, seed + index)
        result.append(Split(index, inner.train, inner.validation, test))
    return result
