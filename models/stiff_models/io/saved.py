"""Fitted models as files: one safetensors file, with everything but the arrays as JSON in its head.

A file holds the model's key, its options, its robot and its fitted attributes;
`load` gives a model with bit-equal predictions on the same machine. Nothing in a file is code:
whoever opens a stranger's file runs none of his (no pickle; see `state_codec`, `estimator_bytes`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from stiff_models.catalog import MODELS, model_info
from stiff_models.io.checked_model import CheckedModel
from stiff_models.io.state_codec import Array, pack, unpack
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    ModelError,
    NotFittedError,
    StiffBenchError,
)
from stiff_protocols.contract.files import written_whole

FORMAT = 1
_HEAD, _SHA256 = "stiffbench_model", "sha256"


def key_of(model: object) -> str:
    """Return the catalogue key under which a model is saved.

    Raises:
        ModelError: it is no model that stiffbench ships.
    """
    key = _key_of_class(type(model))
    if not key:
        raise ModelError(
            f"{type(model).__name__} is no model that stiffbench ships, and its files hold no "
            "others; it can be saved by its own means"
        )
    return key


def save(model: CheckedModel, path: Path) -> None:
    """Write a fitted model to one file, whole or not at all; one that exists is replaced.

    Raises:
        NotFittedError: `fit` was not called.
        ModelError: the model is none of stiffbench's own, or holds what no file can.
        StoreError: the file cannot be written.
    """
    key_of(model)
    if not hasattr(model, "robot_"):
        raise NotFittedError(f"{type(model).__name__}: call fit before save")
    structure, arrays = pack(model, _key_of_class)
    head = {"format": FORMAT, "stiffbench": version("stiffbench"), "model": structure}
    text = json.dumps(head, allow_nan=False)
    metadata = {_HEAD: text, _SHA256: _digest(text, arrays)}
    with written_whole(Path(path)) as temporary:
        save_file(arrays, temporary, metadata=metadata)


def load(path: Path | str) -> CheckedModel:
    """Return the model that a file holds.

    Networks run on the device of the model's options; where that is "cuda" and there is none here,
    on "auto".

    Raises:
        DataError: the file cannot be read, is damaged or of another format, or holds a model or an
            object that this version does not know.
    """
    path = Path(path)
    text, arrays = _read(path)
    try:
        head = json.loads(text)
        if head["format"] != FORMAT:
            raise DataError(
                f"has format {head['format']}, written by stiffbench {head['stiffbench']} "
                f"(valid here: {FORMAT})"
            )
        if "key" not in head["model"]:
            raise DataError("names no model")
        return unpack(head["model"], arrays, _class_of_key)
    except StiffBenchError as error:
        raise DataError(f"{path}: {error}") from error
    except Exception as error:  # a crafted or damaged structure can raise anything
        raise DataError(
            f"{path}: holds no model that stiffbench {version('stiffbench')} can build: "
            f"{type(error).__name__}: {error}"
        ) from error


def _read(path: Path) -> tuple[str, dict[str, Array]]:
    """Return the head's text and the arrays of a file that is whole."""
    try:
        path.open("rb").close()  # so that a file that is not there is an OSError
        with safe_open(path, framework="numpy") as file:
            metadata: Mapping[str, str] = file.metadata() or {}
            arrays = {name: file.get_tensor(name) for name in file.keys()}
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: no model file, or a damaged one: {error}") from error
    if _HEAD not in metadata:
        raise DataError(f"{path}: no model file of stiffbench's (valid: what model.save wrote)")
    if metadata.get(_SHA256) != _digest(metadata[_HEAD], arrays):
        raise DataError(f"{path}: damaged: its checksum is another one")
    return metadata[_HEAD], arrays


def _digest(text: str, arrays: Mapping[str, Array]) -> str:
    digest = hashlib.sha256(text.encode())
    for name in sorted(arrays):
        digest.update(name.encode())
        digest.update(arrays[name].tobytes())
    return digest.hexdigest()


def _key_of_class(cls: type) -> str:
    """Return the key of a shipped class; "" for any other."""
    name = f"{cls.__module__}:{cls.__qualname__}"
    for info in MODELS:
        if info.target == name:
            return info.key
    if not cls.__module__.startswith("stiff_models."):
        return ""
    key: Any = vars(cls).get("key", "")  # a family without number makes its classes
    return key if isinstance(key, str) else ""


def _class_of_key(key: str) -> type[CheckedModel]:
    try:
        info = model_info(key)
    except ConfigError as error:
        raise DataError(str(error)) from error
    if info.missing():
        raise DataError(f"holds a {key}, which cannot be used here: {info.missing()}")
    cls: type[CheckedModel] = info.load()
    return cls
