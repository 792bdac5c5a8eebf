"""How many rows the splits of a contest train and test on: what the corrected t test takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiff_protocols.record import CellResult


@dataclass(frozen=True)
class SplitSizes:
    """Sizes of the splits of one contest.

    Attributes:
        n_train, n_test: rows of one split, means over the splits.
        n_samples: rows of the data set.
    """

    n_train: float
    n_test: float
    n_samples: int

    @property
    def test_share(self) -> float:
        """Part of the data set (0..1) that a split tests on.

        Where a split trains on a part of the rest alone (a learning curve), this still is what ties
        the splits' results together, not n_test / (n_test + n_train): few training rows hardly
        overlap from split to split (counted in tests/protocols/test_false_positives.py).
        """
        return self.n_test / self.n_samples


def split_sizes(results: Sequence[CellResult], n_samples: int) -> SplitSizes:
    """Return the sizes of the splits of a model's results.

    Args:
        results: of one model, at least one of them with a prediction.
        n_samples: rows of the data set.
    """
    n_test = np.mean([len(r.prediction.rows) for r in results if r.prediction is not None])
    n_train = np.mean([result.n_train for result in results])
    return SplitSizes(float(n_train), float(n_test), n_samples)
