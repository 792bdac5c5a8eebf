"""Where stiffbench keeps what belongs to a user: fetched data sets and registered files."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

from stiff_protocols import files
from stiff_protocols.errors import DataError, StoreError

VARIABLE = "STIFFBENCH_HOME"
"""Environment variable that names another folder."""


def home() -> Path:
    """Return the folder; it need not exist yet.

    Raises:
        DataError: the variable names a user who does not exist.
    """
    named = os.environ.get(VARIABLE)
    try:
        return Path(named).expanduser() if named else platformdirs.user_data_path("stiffbench")
    except RuntimeError as error:
        raise DataError(f"{VARIABLE}={named}: {error}") from error


def make_folder(folder: Path) -> None:
    """Make a folder at or below `home`, with its parents.

    Raises:
        DataError: it cannot be made.
    """
    try:
        files.make_folder(folder)
    except StoreError as error:
        raise DataError(
            f"{error}; name another folder in the environment variable {VARIABLE}"
        ) from error
