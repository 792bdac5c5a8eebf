"""Keep finished trainings on disk with joblib, by a hash of their inputs.

An entry is a folder that is written under a temporary name and then renamed, so two processes may
use the cache at once. Test data never enter a training, so they never enter a key.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import joblib

from stiff_models.io.cache_folder import usable_folder
from stiff_protocols.contract.errors import StoreError, warn

Training = TypeVar("Training")


def remembered(shaped_by: object, compute: Callable[[], Training]) -> Training:
    """Return a training from the cache, or compute and store it.

    Its key is the hash of `shaped_by`: numbers, texts and arrays. If the folder cannot be used or
    the disk is full, the training is computed, with a warning.
    """
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
    # a corrupt entry is trained again; joblib would print the traceback of reading it
    logging.getLogger("joblib").setLevel(logging.ERROR)
    return joblib.Memory(folder, verbose=0)
