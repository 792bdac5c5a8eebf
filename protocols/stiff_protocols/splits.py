"""Generators of row divisions. Nothing here looks at a deflection."""

from __future__ import annotations

from typing import Any

import numpy as np
from sklearn.model_selection import GroupKFold, GroupShuffleSplit, LeaveOneGroupOut

from stiff_protocols.errors import ConfigError
from stiff_protocols.types import IntArray, Samples, Split

NO_ROWS: IntArray = np.empty(0, dtype=np.int64)


def inner_validation(samples: Samples, train: IntArray, fraction: float, seed: int) -> Split:
    """Divide training rows by pose into a fitting and a validation part (test stays empty).

    A single pose cannot be divided; there is no validation part then.
    """
    if len(np.unique(samples.pose_id[train])) < 2:
        return Split(0, train, NO_ROWS, NO_ROWS)
    parts = GroupShuffleSplit(n_splits=1, test_size=fraction, random_state=seed)
    (fit, validate), *_ = _divide(parts, samples.take(train), "validation_fraction")
    return Split(0, np.sort(train[fit]), np.sort(train[validate]), NO_ROWS)


def holdout_by_pose(
    samples: Samples, *, n_splits: int, test_fraction: float, validation_fraction: float, seed: int
) -> list[Split]:
    """Return repeated random divisions by pose, each with an inner validation part.

    Raises:
        ConfigError: there are too few poses for these fractions.
    """
    outer = GroupShuffleSplit(n_splits=n_splits, test_size=test_fraction, random_state=seed)
    return [
        divided_inside(samples, index, train, test, validation_fraction, seed)
        for index, (train, test) in enumerate(_divide(outer, samples, "test_fraction"))
    ]


def folds_by_pose(
    samples: Samples, *, n_folds: int, validation_fraction: float, seed: int
) -> list[Split]:
    """Return the divisions of a k-fold cross-validation by pose.

    Raises:
        ConfigError: there are fewer poses than folds, or one fold alone.
    """
    outer = GroupKFold(n_folds, shuffle=True, random_state=seed)
    return [
        divided_inside(samples, index, train, test, validation_fraction, seed)
        for index, (train, test) in enumerate(_divide(outer, samples, "number of folds"))
    ]


def divided_inside(
    samples: Samples,
    index: int,
    train: IntArray,
    test: IntArray,
    validation_fraction: float,
    seed: int,
    condition: str = "",
) -> Split:
    """Return the split of these rows, with an inner validation part taken from `train`."""
    inner = inner_validation(samples, train, validation_fraction, seed + index)
    return Split(index, inner.train, inner.validation, np.sort(test), condition)


def holdout_that_selects(
    samples: Samples, *, n_splits: int, test_fraction: float, seed: int
) -> list[Split]:
    """Return repeated random divisions by pose whose test rows are also the validation rows.

    Raises:
        ConfigError: there are too few poses for this fraction.
    """
    outer = GroupShuffleSplit(n_splits=n_splits, test_size=test_fraction, random_state=seed)
    return [
        Split(index, np.sort(train), np.sort(test), np.sort(test))
        for index, (train, test) in enumerate(_divide(outer, samples, "test_fraction"))
    ]


def leave_one_pose_out(samples: Samples, *, validation_fraction: float, seed: int) -> list[Split]:
    """Return one division a pose, in the order of the data set's first rows of each pose.

    Raises:
        ConfigError: there are too few poses.
    """
    divisions = _divide(LeaveOneGroupOut(), samples, "number of poses")
    divisions.sort(key=lambda rows: int(rows[1][0]))
    return [
        divided_inside(samples, index, train, test, validation_fraction, seed)
        for index, (train, test) in enumerate(divisions)
    ]


def _divide(splitter: Any, samples: Samples, option: str) -> list[tuple[IntArray, IntArray]]:
    """Return (train, test) rows; what scikit-learn refuses becomes a ConfigError."""
    try:
        return list(splitter.split(samples.q, groups=samples.pose_id))
    except ValueError as error:
        n_poses = len(np.unique(samples.pose_id))
        raise ConfigError(
            f"{len(samples)} samples of {n_poses} poses cannot be divided with this {option}: "
            f"{error}"
        ) from error
