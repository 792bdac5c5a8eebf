"""What every built-in family shares: a checked `predict`, `save`, intervals of a normal error."""

from __future__ import annotations

from pathlib import Path

from stiff_models.io import saved
from stiff_models.io.checked_model import CheckedModel
from stiff_protocols.contract.types import FloatArray, Interval


def normal_interval(mean: FloatArray, deviation: FloatArray, coverage: float) -> Interval:
    """Return the central interval of each axis.

    Args:
        mean: (n, 3) m.
        deviation: (n, 3) standard deviation, m.
        coverage: probability, between 0 and 1, of each axis alone.
    """
    from scipy.special import ndtri  # not every model needs it

    half = ndtri(0.5 + coverage / 2.0) * deviation
    return Interval(mean - half, mean + half, coverage)


class FittedModel(CheckedModel):
    """Base of the built-in families."""

    def save(self, path: Path) -> None:
        """Write the fitted model to one file that `stiff_models.load` reads; see `saved`.

        Raises:
            NotFittedError: `fit` was not called.
            StoreError: the file cannot be written.
        """
        saved.save(self, path)
