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
        train_known: the number of training rows was stored; else it is all that was not tested.
    """

    n_train: float
    n_test: float
    train_known: bool

    @property
    def test_share(self) -> float:
        """Part of the rows (0..1) that a split tests on."""
        return self.n_test / (self.n_test + self.n_train)


def split_sizes(results: Sequence[CellResult], n_samples: int) -> SplitSizes:
    """Return the sizes of the splits of a model's results.

    Args:
        results: of one model, at least one of them with a prediction.
        n_samples: rows of the data set.
    """
    n_test = np.mean([len(r.prediction.rows) for r in results if r.prediction is not None])
    trained = [result.n_train for result in results]
    known = all(trained)
    n_train = np.mean(trained) if known else n_samples - n_test
    return SplitSizes(float(n_train), float(n_test), known)
