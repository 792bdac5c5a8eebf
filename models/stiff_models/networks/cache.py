"""Trainings that were done before, kept on disk by the content of everything that shapes them.

joblib.Memory keeps the results: one folder an entry, written beside its place and renamed, so that
two processes may use it at once. Test data never go into a training, and so never into a key.
"""

from __future__ import annotations

import hashlib
import logging
import platform
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import torch

from stiff_models.io.cache_folder import OFF, VARIABLE, cache_folder, usable_folder
from stiff_models.networks.arithmetic import arithmetic
from stiff_models.networks.training import PRETRAINING_VERSION, Curve
from stiff_models.networks.training_plan import TrainingPlan
from stiff_protocols.contract.errors import StiffBenchWarning, StoreError
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.types import FloatArray


@dataclass(frozen=True, eq=False)
class Trained:
    """The outcome of a training: the network's state, its curve, and the wall time it took.

    `judged` is what was measured with the network right after, by name.
    """

    weights: dict[str, np.ndarray[Any, Any]]
    curve: Curve
    seconds: float
    judged: dict[str, FloatArray]


@dataclass(frozen=True)
class CacheInfo:
    """How many trainings the cache holds in which folder; None when it is switched off."""

    folder: Path | None
    entries: int
    size_bytes: int

    def __str__(self) -> str:
        """Return a line for people."""
        if self.folder is None:
            return f"the cache is switched off ({VARIABLE}={OFF})"
        trainings = "1 training" if self.entries == 1 else f"{self.entries} trainings"
        return f"{trainings}, {self.size_bytes / 2**20:.1f} MiB, in {self.folder}"


def remembered(digest: str, compute: Callable[[], Trained]) -> Trained:
    """Return the training of that digest: from the cache, or computed and then kept there.

    A folder that cannot be used, or a full disk, is no reason to stop: the training is computed,
    with a warning.
    """
    computed: list[Trained] = []

    def once() -> Trained:
        computed.append(compute())
        return computed[-1]

    try:
        memory = _memory(usable_folder())
        trained: Trained = memory.cache(_trained, ignore=["compute"])(digest, once)
        return trained
    except (StoreError, OSError) as error:
        warnings.warn(
            f"pre-training is neither kept nor taken from the cache: {error}",
            StiffBenchWarning,
            stacklevel=2,
        )
        return computed[-1] if computed else compute()


def _trained(digest: str, compute: Callable[[], Trained]) -> Trained:
    """Joblib keeps the result under `digest` alone."""
    return compute()


def cache_info() -> CacheInfo:
    """Return what the cache holds."""
    folder = cache_folder()
    items = (
        [] if folder is None or not folder.is_dir() else _memory(folder).store_backend.get_items()
    )
    return CacheInfo(folder, len(items), sum(item.size for item in items))


def clear_cache() -> CacheInfo:
    """Delete every training and return what was there; StoreError where that cannot be done."""
    before = cache_info()
    if before.entries:
        try:
            _memory(before.folder).clear(warn=False)
        except OSError as error:
            raise StoreError(
                f"{before.folder}: cannot be emptied: {error.strerror or error}"
            ) from error
    return before


def _memory(folder: Path | None) -> joblib.Memory:
    # a damaged entry is trained again; joblib would print the traceback of reading it
    logging.getLogger("joblib").setLevel(logging.ERROR)
    return joblib.Memory(folder, verbose=0)


def training_digest(
    network: torch.nn.Module,
    plan: TrainingPlan,
    seed: int,
    tensors: Iterable[torch.Tensor],
    *,
    actors: Iterable[object],
    about: str,
) -> str:
    """Return the hash of everything that shapes a training.

    That is the network with its first weights, plan and seed (of the batches' order), what it
    learns from or is made of (`tensors`), settings as text (`about`), and a stranger's code: of
    its parts and of the `actors` that take part, such as the model.
    """
    device = next(network.parameters()).device
    digest = hashlib.sha256()
    for text in (
        repr(network),
        repr(plan),
        str(seed),
        about,
        _machine(device),
        repr(arithmetic(device, mixed_precision=plan.mixed_precision)),
        f"{PRETRAINING_VERSION} torch {torch.__version__}",
        *sorted({code_of(type(thing)) for thing in (*network.modules(), *actors)}),
    ):
        digest.update(text.encode() + b"\0")
    for tensor in (*tensors, *network.state_dict().values()):
        array = tensor.detach().cpu().contiguous().numpy()
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _machine(device: torch.device) -> str:
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.machine()
    return f"{device.type} {name} {torch.get_num_threads()} threads"
