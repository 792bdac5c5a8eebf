"""Expected errors of predictions; a fit's error at left-out poses in a few numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from stiff_protocols.contract.arrays import FloatArray, frozen_array
from stiff_protocols.contract.errors import DataError


@dataclass(frozen=True, eq=False)
class ErrorLengths:
    """Lengths of one kind of error of predicted deflections.

    Attributes:
        name: name of the kind, as printed.
        values: (n,) m; None: unknown.
        source: text on the source of the values, or the reason why they are unknown.
    """

    name: str
    values: FloatArray | None
    source: str


@dataclass(frozen=True)
class CrossValidatedError:
    """Lengths of the error vectors at left-out samples, each predicted by a fit without its pose.

    Attributes:
        mean: of the lengths, m.
        rms: their root mean square, m.
        quantile_90: length that nine of ten do not exceed, m.
        n_samples: number of left-out samples.
        n_folds: parts of the poses, each left out by one fit.
    """

    mean: float
    rms: float
    quantile_90: float
    n_samples: int
    n_folds: int

    def __post_init__(self) -> None:
        lengths = frozen_array([self.mean, self.rms, self.quantile_90], "error lengths", (3,))
        if (lengths < 0.0).any() or min(self.n_samples, self.n_folds) < 1:
            raise DataError(f"a cross-validated error is {self}, expected lengths and counts")

    @classmethod
    def of(cls, errors: FloatArray, n_folds: int) -> Self:
        """Return the numbers of (n, 3) errors at left-out samples, m."""
        lengths = np.linalg.norm(errors, axis=1)
        return cls(
            float(lengths.mean()),
            float(np.sqrt(np.mean(lengths**2))),
            float(np.quantile(lengths, 0.9)),
            len(lengths),
            n_folds,
        )
