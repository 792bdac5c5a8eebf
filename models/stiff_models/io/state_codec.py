"""What a fitted model holds, as JSON beside plain arrays, and back: no code is ever stored.

`None`, truth values, whole numbers, finite floats and text stand for themselves. Everything else is
an object with a "type": see `_Packer.pack`. Arrays are kept bit for bit, in the order in memory
that they had (matrix products of the other order may differ in the last bit).
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, TypeGuard, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError
from sklearn.base import BaseEstimator

from stiff_models.io.checked_model import CheckedModel
from stiff_protocols.contract.errors import DataError, ModelError

if TYPE_CHECKING:
    import torch

Array = np.ndarray[Any, Any]
Node = Any
"""What `json` reads and writes."""

_PLAIN_DTYPES = frozenset("f8 f4 f2 i8 i4 i2 i1 u8 u4 u2 u1 b1".split())
_OWN_PACKAGES = ("stiff_models", "stiff_protocols")


def pack(model: CheckedModel, key_of: Callable[[type], str]) -> tuple[Node, dict[str, Array]]:
    """Take a fitted model apart.

    Args:
        model: after `fit`.
        key_of: returns the catalogue key of a class, "" where it has none.

    Returns:
        The structure, and the arrays that it names.

    Raises:
        ModelError: it holds something that cannot be stored.
    """
    packer = _Packer(key_of)
    return packer.model(model), packer.arrays


def unpack(
    node: Node, arrays: Mapping[str, Array], class_of: Callable[[str], type[CheckedModel]]
) -> CheckedModel:
    """Put a model together again; arguments as `pack` returned them.

    Args:
        node: the structure.
        arrays: what it names.
        class_of: returns the class of a catalogue key.

    Raises:
        DataError: the structure names a class that no file may build.
    """
    return _Unpacker(arrays, class_of).model(node)


class _Packer:
    """Collects the arrays of one model."""

    def __init__(self, key_of: Callable[[type], str]) -> None:
        self.arrays: dict[str, Array] = {}
        self._key_of = key_of

    def model(self, model: CheckedModel) -> Node:
        cls, key = type(model), self._key_of(type(model))
        if not key and not _is_own(cls):
            raise ModelError(f"{cls.__name__} is no class of stiffbench's")
        params = model.get_params(deep=False)
        fitted = {name: value for name, value in vars(model).items() if is_fitted(name)}
        return {
            "type": "model",
            **({"key": key} if key else {"class": _name_of(cls)}),
            "params": self._named(cls, params),
            "fitted": self._named(cls, fitted),
        }

    def _named(self, cls: type, values: Mapping[str, object]) -> Node:
        nodes = {}
        for name, value in values.items():
            try:
                nodes[name] = self._module(value) if _is_module(value) else self.pack(value)
            except ModelError as error:
                raise ModelError(f"{cls.__name__}.{name}: {error}") from error
        return nodes

    def pack(self, value: object) -> Node:
        if isinstance(value, np.generic):
            return {"type": "scalar", **self._array(np.asarray(value))}
        if value is None or isinstance(value, bool | int | str):
            return value
        if isinstance(value, float):
            return value if math.isfinite(value) else {"type": "float", "value": repr(value)}
        if isinstance(value, np.ndarray):
            return {"type": "array", **self._array(value)}
        if isinstance(value, list | tuple):
            kind = "list" if isinstance(value, list) else "tuple"
            return {"type": kind, "items": [self.pack(item) for item in value]}
        if isinstance(value, dict):
            pairs = [[self.pack(key), self.pack(item)] for key, item in value.items()]
            return {"type": "dict", "items": pairs}
        if isinstance(value, PurePath):
            return str(value)
        return self._object(value)

    def _object(self, value: object) -> Node:
        if isinstance(value, CheckedModel):
            return self.model(value)
        if dataclasses.is_dataclass(value) and _is_record(type(value)):
            fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.init}
            cls = type(value)
            return {"type": "record", "class": _name_of(cls), "fields": self._named(cls, fields)}
        if isinstance(value, BaseEstimator):
            from stiff_models.io.estimator_bytes import estimator_to_bytes

            data = np.frombuffer(estimator_to_bytes(value), dtype=np.uint8)
            return {"type": "estimator", **self._array(data)}
        raise ModelError(f"a {type(value).__name__} cannot be stored")

    def _module(self, module: torch.nn.Module) -> Node:
        state = module.state_dict()
        arrays = {name: self._array(tensor.cpu().numpy()) for name, tensor in state.items()}
        return {"type": "module", "state": arrays}

    def _array(self, array: Array) -> Node:
        """Store an array; text, complex numbers and the like as their bytes."""
        if array.dtype.hasobject or array.dtype.names:
            raise ModelError(f"an array of {array.dtype} cannot be stored")
        name = str(len(self.arrays))
        transposed = array.flags.f_contiguous and not array.flags.c_contiguous
        stored = np.array(array.T if transposed else array, order="C")
        if array.dtype.str.lstrip("<|") not in _PLAIN_DTYPES:
            stored = np.frombuffer(stored.tobytes(), dtype=np.uint8)
        self.arrays[name] = stored
        shape = list((array.T if transposed else array).shape)
        return {
            "data": name,
            "dtype": array.dtype.str,
            "shape": shape,
            **({"transposed": True} if transposed else {}),
        }


class _Unpacker:
    """Reads nodes back; any error of the nodes' own form is the caller's to name."""

    def __init__(
        self, arrays: Mapping[str, Array], class_of: Callable[[str], type[CheckedModel]]
    ) -> None:
        self._arrays = arrays
        self._class_of = class_of

    def model(self, node: Node) -> CheckedModel:
        cls = self._class_of(node["key"]) if "key" in node else _own_model(node["class"])
        params = {name: self.unpack(value) for name, value in node["params"].items()}
        if params.get("device") == "cuda" and not _has_cuda():
            params["device"] = "auto"
        _check_options(cls, params)
        model = cls(**params)
        modules = {}
        for name, value in node["fitted"].items():
            if not is_fitted(name):
                raise DataError(f"sets {name!r}, which is no fitted attribute")
            if isinstance(value, dict) and value["type"] == "module":
                modules[name] = value["state"]
            else:
                setattr(model, name, self.unpack(value))
        for name, state in modules.items():  # last: their shape follows from the rest
            setattr(model, name, self._module(model, name, state))
        return model

    def _module(self, model: CheckedModel, name: str, state: Node) -> torch.nn.Module:
        import torch

        from stiff_models.device import torch_device

        with torch.device("meta"):  # shapes alone: a file may promise more than it holds
            module = model._empty_module(name)
        tensors = {key: torch.from_numpy(self._array(value)) for key, value in state.items()}
        module.load_state_dict(tensors, assign=True)
        return module.to(torch_device(model.get_params().get("device", "cpu"))).eval()

    def unpack(self, node: Node) -> Any:
        if not isinstance(node, dict):
            return node
        kind = node["type"]
        if kind in ("list", "tuple"):
            items = [self.unpack(item) for item in node["items"]]
            return items if kind == "list" else tuple(items)
        if kind == "dict":
            return {self.unpack(key): self.unpack(value) for key, value in node["items"]}
        if kind == "float":
            return float(node["value"])
        if kind == "record":
            fields = {name: self.unpack(value) for name, value in node["fields"].items()}
            return _own_record(node["class"])(**fields)
        if kind == "model":
            return self.model(node)
        array = self._array(node)
        if kind == "estimator":
            from stiff_models.io.estimator_bytes import estimator_from_bytes

            return estimator_from_bytes(array.tobytes())
        if kind not in ("array", "scalar"):
            raise DataError(f"holds a {kind!r}, which this version does not know")
        return array[()] if kind == "scalar" else array

    def _array(self, node: Node) -> Array:
        stored, dtype = self._arrays[node["data"]], np.dtype(node["dtype"])
        if dtype.hasobject or dtype.names:
            raise DataError(f"holds an array of {dtype}")
        if stored.dtype != dtype:
            stored = np.frombuffer(stored.tobytes(), dtype=dtype)
        array = stored.reshape(node["shape"]).copy()
        return array.T if node.get("transposed") else array


def _check_options(cls: type, params: Mapping[str, object]) -> None:
    """See that options have the values that a user could set: no network has 10**9 layers."""
    owner = cls if dataclasses.is_dataclass(cls) else cls.__init__  # type: ignore[misc]
    hints = get_type_hints(owner, include_extras=True)
    for name, value in params.items():
        if name in hints:
            try:
                _adapter(hints[name]).validate_python(value)
            except ValidationError as error:
                reason = error.errors()[0]["msg"]
                raise DataError(f"has the option {name} = {value!r}: {reason}") from error


@functools.cache
def _adapter(annotation: Any) -> TypeAdapter[Any]:
    return TypeAdapter(annotation)


def is_fitted(name: str) -> bool:
    """Say whether an attribute's name is that of a fitted one."""
    return name.endswith("_") and not name.startswith("_")


def _is_module(value: object) -> TypeGuard[torch.nn.Module]:
    torch = sys.modules.get("torch")  # who holds a module has imported it
    return torch is not None and isinstance(value, torch.nn.Module)


def _is_own(cls: type) -> bool:
    return cls.__module__.partition(".")[0] in _OWN_PACKAGES


def _is_record(cls: type) -> bool:
    """Say whether objects of `cls` are stored by their fields: frozen dataclasses of ours."""
    parameters = getattr(cls, "__dataclass_params__", None)
    return _is_own(cls) and parameters is not None and bool(parameters.frozen)


def _name_of(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _own_record(name: str) -> type:
    cls = _own_class(name)
    if not _is_record(cls):
        raise DataError(f"holds an object of {name}, which is no frozen dataclass of stiffbench's")
    return cls


def _own_model(name: str) -> type[CheckedModel]:
    cls = _own_class(name)
    if not issubclass(cls, CheckedModel):
        raise DataError(f"holds an object of {name}, which is no model of stiffbench's")
    return cls


def _own_class(name: str) -> type:
    """Return the class called "module:Name"; nothing outside of our packages is ever imported."""
    module_name, _, class_name = name.partition(":")
    if module_name.partition(".")[0] not in _OWN_PACKAGES:
        raise DataError(f"holds an object of {name}, which no model file may hold")
    try:
        cls = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError):
        cls = None
    if not isinstance(cls, type) or _name_of(cls) != name:
        raise DataError(f"holds an object of {name}, which this version of stiffbench lacks")
    return cls


def _has_cuda() -> bool:
    import torch

    return torch.cuda.is_available()
