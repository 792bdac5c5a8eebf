"""Keep finished trainings on disk with joblib, by a hash of their inputs.

An entry is a folder that is written under a temporary name and then renamed, so two processes may
use the cache at once. Test data never enter a training, so they never enter a key.
"""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import platformdirs

from stiff_protocols.contract.errors import StoreError, warn
from stiff_protocols.contract.files import make_folder

if TYPE_CHECKING:
    import joblib

Training = TypeVar("Training")

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


def remembered(shaped_by: object, compute: Callable[[], Training]) -> Training:
    """Return a training from the cache, or compute and store it.

    Its key is the hash of `shaped_by`: numbers, texts and arrays. If the folder cannot be used or
    the disk is full, the training is computed, with a warning.
    """
    import joblib  # a command without networks does without it

    computed: list[Training] = []

    def once() -> Training:
        computed.append(compute())
        return computed[-1]

    try:
        cached = _memory(usable_folder()).cache(_trained, ignore=["compute"])
        # only the hash: joblib writes the arguments next to a result, and warns if that takes long
        cached_training: Training = cached(joblib.hash(shaped_by), once)
        return cached_training
    except (StoreError, OSError) as error:
        warn(f"the pre-training cache is not used: {error}")
        return computed[-1] if computed else compute()


def _trained(key: str, compute: Callable[[], Training]) -> Training:
    """Return the training; joblib stores it only by `key`."""
    return compute()


def _memory(folder: Path | None) -> joblib.Memory:
    import joblib

    # a corrupt entry is trained again; joblib would print the traceback of reading it
    logging.getLogger("joblib").setLevel(logging.ERROR)
    return joblib.Memory(folder, verbose=0)
