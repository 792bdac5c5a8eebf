"""`sample-efficiency`: how many measured poses does a model need?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.protocol_base import EvaluationProtocol
from stiff_protocols.contract.types import IntArray, Samples, Split, TextArray
from stiff_protocols.splits.generators import LazySplits, divided_inside, indivisible, numbers_in
from stiff_protocols.splits.random_splits import Fraction


def condition_of(n_poses: int) -> str:
    """Return the condition of splits with this number of measured poses."""
    return f"n = {n_poses}"


@dataclass(kw_only=True, eq=False)
class SampleEfficiency(EvaluationProtocol):
    """A learning curve over nested subsets of the training poses, tested on the same poses.

    In each draw a fifth of the poses is the test part of every size, and the subset of a size
    holds the smaller ones. What a model gets is what it costs: validation poses count.

    Attributes:
        sizes: numbers of measured poses, separated by commas; those that reach beyond the
            training side become one with all of it.
        test_fraction: of all poses, rounded down (30 of 151, as in the source paper).
        validation_fraction: of a subset's poses, may choose the epoch.
    """

    sizes: str = "5,10,20,40,80,121"
    test_fraction: Fraction = 0.2
    validation_fraction: Fraction = 0.2

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return `n_splits` (default 1) draws of every size.

        ConfigError: `sizes` are not numbers, or there are too few poses.
        """
        poses = np.unique(samples.pose_id)
        n_test = int(self.test_fraction * len(poses))
        if n_test == 0 or len(poses) - n_test < 2:
            raise indivisible(
                samples,
                f"test_fraction={self.test_fraction:g} of the poses, rounded down, must leave one "
                "to test and two to learn from",
            )
        requested_sizes = numbers_in("sample-efficiency.sizes", self.sizes, int, fewest=1)
        sizes = sorted({min(size, len(poses) - n_test) for size in requested_sizes})

        def divided() -> Iterator[Split]:
            for index in range(n_splits or 1):
                order = np.random.default_rng([seed, index]).permutation(poses)
                test = _rows(samples, order[:n_test])
                for size in sizes:
                    train, condition = _rows(samples, order[n_test:][:size]), condition_of(size)
                    yield divided_inside(
                        samples, index, train, test, self.validation_fraction, seed, condition
                    )

        return LazySplits(divided, (n_splits or 1) * len(sizes))


def _rows(samples: Samples, poses: TextArray) -> IntArray:
    return np.flatnonzero(np.isin(samples.pose_id, poses))
