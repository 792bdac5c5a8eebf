"""Stiffness model families, one plugin file each, and the parts that they share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stiff_models.fitted_model import FittedModel

__all__ = ["load"]


def load(path: Path | str) -> FittedModel:
    """Return the fitted model that `model.save(path)` or `bench fit` wrote; see `model_file.load`.

    Raises:
        DataError: the file cannot be read, is corrupt, or holds objects unknown to this version.
    """
    from stiff_models.io.model_file import load as load_file

    model: FittedModel = load_file(path)
    return model
