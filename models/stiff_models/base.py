"""What every built-in family shares: a checked `predict`, and `save`."""

from __future__ import annotations

from pathlib import Path

from stiff_models import saved
from stiff_models.checked_model import CheckedModel


class FittedModel(CheckedModel):
    """Base of the built-in families."""

    def save(self, path: Path) -> None:
        """Write the fitted model to one file that `stiff_models.load` reads; see `saved`.

        Raises:
            NotFittedError: `fit` was not called.
            StoreError: the file cannot be written.
        """
        saved.save(self, path)
