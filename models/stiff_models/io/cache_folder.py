"""Find the folder of the cache of trainings."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import platformdirs

from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.files import make_folder

VARIABLE = "STIFFBENCH_CACHE"
"""Environment variable that names another folder, or `OFF`."""
OFF = "off"
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def cache_folder() -> Path | None:
    """Return the folder, which need not exist yet; None if STIFFBENCH_CACHE is "off".

    StoreError: the variable names a user who does not exist.
    """
    named = os.environ.get(VARIABLE)
    if named == OFF:
        return None
    try:
        return Path(named).expanduser() if named else platformdirs.user_cache_path("stiffbench")
    except RuntimeError as error:
        raise StoreError(f"{VARIABLE}={named}: {error}") from error


def usable_folder() -> Path | None:
    """Return the folder, created if needed; None if the cache is switched off.

    StoreError: it cannot be written, or other users can write files there. Joblib stores pickles,
    which run code when they are read.
    """
    folder = cache_folder()
    if folder is None:
        return None
    if not folder.exists():
        make_folder(folder)
        folder.chmod(stat.S_IRWXU)
    if not os.access(folder, os.W_OK):
        raise StoreError(f"{folder}: cannot be written")
    about = folder.stat()
    if hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & _OTHERS_WRITE):
        raise StoreError(
            f"{folder}: belongs to another user, or others may write there; run chmod go-w on it, "
            f"or set {VARIABLE} to a folder of your own"
        )
    return folder
