"""Generators of row divisions. Nothing here looks at a deflection."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, islice
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import IntArray, Samples, Split

NO_ROWS: IntArray = np.empty(0, dtype=np.int64)
Division = tuple[IntArray, IntArray]
"""Training and test rows, in increasing order."""


class LazySplits(Sequence[Split]):
    """Splits that are computed during iteration, without memory for all of them.

    `make` returns all `n` splits, the same at every call; ConfigError: the first cannot be made.
    """

    def __init__(self, make: Callable[[], Iterator[Split]], n: int) -> None:
        """Store the function, and check that the data can be divided."""
        self._make, self._n = make, n
        next(make())

    def __len__(self) -> int:
        return self._n

    def __iter__(self) -> Iterator[Split]:
        return self._make()

    @overload
    def __getitem__(self, index: int) -> Split: ...
    @overload
    def __getitem__(self, index: slice) -> list[Split]: ...
    def __getitem__(self, index: int | slice) -> Split | list[Split]:
        """Return splits by number; all previous splits are computed, so iterate for many."""
        if isinstance(index, slice):
            return list(self)[index]
        return next(islice(self, range(self._n)[index], None))

    def expanded(self, made_of: Callable[[Split], Iterable[Split]], times: int = 1) -> LazySplits:
        """Return `times` as many splits: the results of `made_of` for each split."""
        return LazySplits(lambda: chain.from_iterable(map(made_of, self)), times * len(self))


Number = TypeVar("Number", int, float)


def numbers_in(option: str, text: str, kind: type[Number], *, fewest: int) -> list[Number]:
    """Return the numbers of an option such as "0,1,5"; ConfigError for none from `fewest`."""
    try:
        numbers = [kind(word) for word in text.split(",")]
    except ValueError:
        numbers = [kind(fewest - 1)]
    if not all(math.isfinite(number) and number >= fewest for number in numbers):
        kind_word = "whole " if kind is int else ""
        raise ConfigError(
            f"{option}={text!r}: valid are {kind_word}numbers from {fewest}, separated by commas"
        )
    return numbers


def inner_validation(samples: Samples, train: IntArray, fraction: float, seed: int) -> Split:
    """Divide training rows by pose into a fitting and a validation part (test stays empty).

    A single pose cannot be divided; then the validation part is empty.

    Raises:
        ConfigError: the fraction leaves no pose to fit to.
    """
    n_poses = len(np.unique(samples.pose_id[train]))
    if n_poses < 2:
        return Split(0, train, NO_ROWS, NO_ROWS)
    if math.ceil(fraction * n_poses) == n_poses:
        raise indivisible(
            samples.take(train),
            f"validation_fraction={fraction:g} leaves no pose to fit to (valid: at most "
            f"{n_poses - 1}/{n_poses})",
        )
    ((fitted_to, validates),) = group_shuffles(samples.pose_id[train], 1, fraction, seed)
    return Split(0, np.sort(train[fitted_to]), np.sort(train[validates]), NO_ROWS)


def group_shuffles(
    groups: NDArray[Any], n_divisions: int, test_fraction: float, seed: int
) -> Iterator[Division]:
    """Yield random divisions of the groups of rows, those of scikit-learn's GroupShuffleSplit.

    They are written out because scikit-learn takes a second to import, in every run.

    Args:
        groups: (n,) group of each row; its rows stay together.
        n_divisions: number of divisions.
        test_fraction: share (0..1) of the groups to test on, rounded up.
        seed: seed of the divisions.
    """
    distinct_groups, group_of_row = np.unique(groups, return_inverse=True)
    n_groups = len(distinct_groups)
    n_test = math.ceil(test_fraction * n_groups)
    random = np.random.RandomState(seed)  # as scikit-learn
    for _ in range(n_divisions):
        tested = np.isin(group_of_row, random.permutation(n_groups)[:n_test])
        yield np.flatnonzero(~tested), np.flatnonzero(tested)


def indivisible(samples: Samples, reason: str) -> ConfigError:
    """Return the error for samples that cannot be divided, with an option and what is valid."""
    n_poses = len(np.unique(samples.pose_id))
    return ConfigError(f"{len(samples)} samples of {n_poses} poses cannot be divided: {reason}")


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
