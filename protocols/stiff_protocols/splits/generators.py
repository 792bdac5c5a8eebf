"""Generators of row divisions. Nothing here looks at a deflection."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from threading import Lock
from typing import Any, overload

import numpy as np
from sklearn.model_selection import GroupKFold, GroupShuffleSplit

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import IntArray, Samples, Split

NO_ROWS: IntArray = np.empty(0, dtype=np.int64)
_RANDOM, _LOCK = np.random.RandomState(0), Lock()


class LazySplits(Sequence[Split]):
    """Splits that are computed while they are looked at: any number of them takes no memory.

    Args:
        make: gives all of them, the same ones at every call.
        n: how many these are.

    Raises:
        ConfigError: the first one cannot be made.
    """

    def __init__(self, make: Callable[[], Iterator[Split]], n: int) -> None:
        """Store how they are made, and see that the data can be divided."""
        self._make, self._n = make, n
        next(make())

    def __len__(self) -> int:
        """Return how many there are."""
        return self._n

    def __iter__(self) -> Iterator[Split]:
        """Compute them one by one."""
        return self._make()

    @overload
    def __getitem__(self, index: int) -> Split: ...
    @overload
    def __getitem__(self, index: slice) -> list[Split]: ...
    def __getitem__(self, index: int | slice) -> Split | list[Split]:
        """Compute all up to the wanted ones: to look at many of them, iterate."""
        if isinstance(index, slice):
            return list(self)[index]
        return next(islice(self, range(self._n)[index], None))


def inner_validation(samples: Samples, train: IntArray, fraction: float, seed: int) -> Split:
    """Divide training rows by pose into a fitting and a validation part (test stays empty).

    A single pose cannot be divided; there is no validation part then. The rows are those of
    scikit-learn's GroupShuffleSplit, which takes several times as long for one division.

    Raises:
        ConfigError: the fraction leaves no pose to fit to.
    """
    poses, pose_of_row = np.unique(samples.pose_id[train], return_inverse=True)
    if len(poses) < 2:
        return Split(0, train, NO_ROWS, NO_ROWS)
    n_validation = math.ceil(fraction * len(poses))
    if n_validation == len(poses):
        raise ConfigError(
            f"{len(train)} samples of {len(poses)} poses cannot be divided with this "
            f"validation_fraction: {fraction:g} of them are all"
        )
    is_drawn = np.zeros(len(poses), dtype=bool)
    is_drawn[_permutation(len(poses), seed)[:n_validation]] = True
    validates = is_drawn[pose_of_row]
    return Split(0, np.sort(train[~validates]), np.sort(train[validates]), NO_ROWS)


def _permutation(n: int, seed: int) -> IntArray:
    """Return the first permutation of a new RandomState(seed), which takes 0.1 ms to make."""
    with _LOCK:
        _RANDOM.seed(seed)
        return _RANDOM.permutation(n)


def holdout_by_pose(
    samples: Samples, *, n_splits: int, test_fraction: float, validation_fraction: float, seed: int
) -> LazySplits:
    """Return repeated random divisions by pose, each with an inner validation part.

    Raises:
        ConfigError: there are too few poses for these fractions.
    """
    outer = GroupShuffleSplit(n_splits=n_splits, test_size=test_fraction, random_state=seed)

    def divided() -> Iterator[Split]:
        for index, (train, test) in enumerate(_divide(outer, samples, "test_fraction")):
            yield divided_inside(samples, index, train, test, validation_fraction, seed)

    return LazySplits(divided, n_splits)


def folds_by_pose(
    samples: Samples, *, n_folds: int, validation_fraction: float, seed: int
) -> LazySplits:
    """Return the divisions of a k-fold cross-validation by pose.

    Raises:
        ConfigError: there are fewer poses than folds, or one fold alone.
    """
    outer = GroupKFold(n_folds, shuffle=True, random_state=seed)

    def divided() -> Iterator[Split]:
        for index, (train, test) in enumerate(_divide(outer, samples, "number of folds")):
            yield divided_inside(samples, index, train, test, validation_fraction, seed)

    return LazySplits(divided, n_folds)


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
) -> LazySplits:
    """Return repeated random divisions by pose whose test rows are also the validation rows.

    Raises:
        ConfigError: there are too few poses for this fraction.
    """
    outer = GroupShuffleSplit(n_splits=n_splits, test_size=test_fraction, random_state=seed)

    def divided() -> Iterator[Split]:
        for index, (train, test) in enumerate(_divide(outer, samples, "test_fraction")):
            yield Split(index, np.sort(train), np.sort(test), np.sort(test))

    return LazySplits(divided, n_splits)


def leave_one_pose_out(samples: Samples, *, validation_fraction: float, seed: int) -> LazySplits:
    """Return one division a pose, in the order of the data set's first rows of each pose.

    Raises:
        ConfigError: there are too few poses.
    """
    poses, first_rows = np.unique(samples.pose_id, return_index=True)
    if len(poses) < 2:
        raise ConfigError(
            f"{len(samples)} samples of one pose cannot be divided: leave-one-out needs two poses"
        )

    def divided() -> Iterator[Split]:
        for index, row in enumerate(np.sort(first_rows)):
            tested = samples.pose_id == samples.pose_id[row]
            train, test = np.flatnonzero(~tested), np.flatnonzero(tested)
            yield divided_inside(samples, index, train, test, validation_fraction, seed)

    return LazySplits(divided, len(poses))


def _divide(splitter: Any, samples: Samples, option: str) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield (train, test) rows; what scikit-learn refuses becomes a ConfigError."""
    try:
        yield from splitter.split(samples.q, groups=samples.pose_id)
    except ValueError as error:
        n_poses = len(np.unique(samples.pose_id))
        raise ConfigError(
            f"{len(samples)} samples of {n_poses} poses cannot be divided with this {option}: "
            f"{error}"
        ) from error
