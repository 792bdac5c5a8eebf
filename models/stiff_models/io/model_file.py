"""Read and write fitted models: a zip archive of `model.json` and of arrays (.npy).

The page docs/formats.md has the layout. A file holds the model's class, options, robot and fitted
attributes. `load` returns a model with bit-equal predictions on the same machine. Files contain no
code: `load` builds numbers, texts, arrays, models and frozen dataclasses of stiffbench, whose
constructors check their arguments. Only other objects, such as scikit-learn's, go through skops
with a fixed list of types (no pickle). The file of a third-party model has the hash of the plugin's
code, and is read only if the user names the plugin.
"""

from __future__ import annotations

import dataclasses
import importlib
import io
import json
import math
import re
import sys
import zipfile
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, TypeGuard, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from stiff_models.model_catalog import MODELS, model_info
from stiff_protocols.contract.errors import DataError, ModelError, NotFittedError, StiffBenchError
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.stiffness_model import StiffnessModel
from stiff_protocols.contract.types import Robot

if TYPE_CHECKING:
    import torch

FORMAT = 6
TREE = "model.json"
"""Member with the tree of the model's values."""
_MEMBER = re.compile(r"(?:[\w#][\w.#-]*/)*[\w#][\w.#-]*", re.ASCII)
"""Names of members: no absolute path, and none of a parent folder."""
_PART = re.compile(r"\w[\w.-]*", re.ASCII)
"""Keys that are part of a member's name; others are replaced by "#" and their position."""
_OWN_PACKAGES = ("stiff_models", "stiff_protocols")

_COVARIANCES = (
    "CompoundKernel ConstantKernel DotProduct ExpSineSquared Exponentiation Matern Product RBF "
    "RationalQuadratic Sum WhiteKernel"
)
TRUSTED = (
    *(f"sklearn.gaussian_process.kernels.{name}" for name in _COVARIANCES.split()),
    "sklearn.tree._tree.Tree",
    "sklearn.ensemble._hist_gradient_boosting.predictor.TreePredictor",
    "sklearn.neighbors._kd_tree.KDTree",
    "sklearn.neighbors._ball_tree.BallTree",
    "sklearn.metrics._dist_metrics.EuclideanDistance64",
    "sklearn.metrics._dist_metrics.ManhattanDistance64",
    "sklearn.metrics._dist_metrics.MinkowskiDistance64",
    "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
    "sklearn.neural_network._stochastic_optimizers.SGDOptimizer",
    "sklearn._loss.loss.HalfTweedieLoss",
    "sklearn._loss.loss.HalfTweedieLossIdentity",
)
"""Types that are read in addition to the types that skops trusts."""


def key_of(model: object) -> str:
    """Return the catalogue key under which a model is saved; ModelError if it has none."""
    key, cls = _name_of(type(model)), type(model)
    if not _is_own(cls) or key == _full_name(cls):
        raise ModelError(
            f"{type(model).__name__} is not a stiffbench model; save it with its own library"
        )
    return key


def save(model: Any, path: Path, plugin: Mapping[str, Mapping[str, Any]] | None = None) -> None:
    """Write a fitted model to one file, completely or not at all.

    Errors are the same as for `FittedModel.save`.

    Args:
        model: built-in model, or third-party model of a plugin.
        path: the file; an existing file is replaced.
        plugin: key of a third-party model -> its options; None: the model is built in.
    """
    key = next(iter(plugin)) if plugin else key_of(model)
    if not hasattr(model, "robot_"):
        raise NotFittedError(f"{type(model).__name__}: call fit before save")
    members: dict[str, bytes] = {}
    try:
        parts = _plugin_parts(model, key, plugin[key]) if plugin else _parts(model)
        node = _object_node(parts, "model", members)
        content = {"format": FORMAT, "written_by": version("stiffbench"), "model": node}
        text = json.dumps(content, indent=1, allow_nan=False)
    except Exception as error:  # third-party objects may raise anything
        raise ModelError(f"{key} cannot be saved: {error}") from error
    with written_whole(Path(path)) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, data in {TREE: text.encode(), **members}.items():
            archive.writestr(name, data)


def _plugin_parts(model: Any, key: str, params: Mapping[str, Any]) -> dict[str, Any]:
    fitted = {name: part for name, part in vars(model).items() if name not in params}
    about = {"type": "plugin", "key": key, "code": code_of(type(model))}
    return about | {"params": params, "fitted": fitted}


def load(path: Path | str, plugins: Mapping[str, type] | None = None) -> Any:
    """Return the model of a file.

    Networks run on the device of the model's options. If that is "cuda" and no CUDA device is
    available, they run on "auto".

    Args:
        path: the file.
        plugins: key -> class of the third-party models that may be built.

    Raises:
        DataError: the file cannot be read, is corrupt or of another format, or holds a model or an
            object unknown to this version.
    """
    try:
        members = _members(Path(path).read_bytes())
        node = _tree(members)
        is_plugin = node["type"] == "plugin"
        model = _plugin_model(node, members, plugins or {}) if is_plugin else _value(node, members)
        if members:
            raise DataError(f"holds {sorted(members)[0]}, which {TREE} does not name")
        if not isinstance(getattr(model, "robot_", None), Robot):
            raise DataError("holds a model without its robot")
        return model
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # a crafted or corrupt archive can raise anything
        reason = " ".join(str(error).split())  # an array's text has several lines
        if not isinstance(error, StiffBenchError):
            reason = (
                f"does not hold a model that stiffbench {version('stiffbench')} can build: "
                f"{type(error).__name__}: {reason}"
            )
        raise DataError(f"{path}: {reason}") from error


def _members(data: bytes) -> dict[str, bytes]:
    """Return the members of an uncompressed archive by name: a guard against zip bombs."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size, names = sum(part.file_size for part in archive.infolist()), archive.namelist()
            if size > len(data):  # `save` compresses nothing
                raise DataError(
                    f"a file of {len(data)} bytes unpacks to {size} bytes; fit the model again"
                )
            for name in names:
                if not _MEMBER.fullmatch(name):
                    raise DataError(f"holds {name!r}, which is not a relative path")
            if len({*names}) < len(names):
                raise DataError("holds two members of one name")
            return {name: archive.read(name) for name in names}
    except zipfile.BadZipFile as error:
        raise DataError(
            "not a model file, or a corrupt file; give a file that `bench fit` wrote"
        ) from error


def _tree(members: dict[str, bytes]) -> Any:
    """Return the model's node, and remove the tree from the members."""
    if TREE not in members and "schema.json" in members:  # skops files, up to format 5
        raise DataError(
            "has the format of an earlier stiffbench, which is not read any more; fit the model "
            "again"
        )
    if TREE not in members:
        raise DataError("not a model file of stiffbench; give a file that `bench fit` wrote")
    content = json.loads(members.pop(TREE), object_pairs_hook=_unique)
    if content["format"] != FORMAT:
        raise DataError(
            f"has format {content['format']}, written by stiffbench {content['written_by']} "
            f"(valid here: {FORMAT}); fit the model again"
        )
    return content["model"]


def _unique(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return a dictionary; DataError if a key is there twice."""
    pairs = list(pairs)
    if len(unique := dict(pairs)) < len(pairs):
        raise DataError(f"has a key twice in {[key for key, _ in pairs]}")
    return unique


def _node(value: Any, place: str, members: dict[str, bytes]) -> Any:
    """Return a value as JSON; its arrays, and objects that are not ours, become members.

    `place` is the value's place in the tree, after which its members are named.
    """
    cls = type(value)
    if cls is float and not math.isfinite(value):  # JSON has no such numbers
        return {"type": "float", "value": str(value)}
    if value is None or cls in (bool, int, float, str):
        return value
    if cls is np.ndarray or isinstance(value, np.generic):
        array = np.asarray(value)
        if _is_plain(array.dtype):
            file = io.BytesIO()
            np.lib.format.write_array(file, array, allow_pickle=False)
            kind = "array" if cls is np.ndarray else "scalar"
            members[f"{place}.npy"] = file.getvalue()
            return {"type": kind, "file": f"{place}.npy"}
    if isinstance(value, list):
        return [_node(item, f"{place}/{i}", members) for i, item in enumerate(value)]
    if isinstance(value, tuple):
        return {"type": "tuple", "items": _node([*value], place, members)}
    if isinstance(value, dict):
        if "type" in value or not all(type(key) is str for key in value):
            items = [[key, part] for key, part in value.items()]
            return {"type": "dict", "items": _node(items, place, members)}
        return _nodes(value, place, members)
    if isinstance(value, PurePath):
        return str(value)
    if _is_module(value):
        raise ModelError(f"{place} is a torch module; store its weights as arrays")
    if parts := _parts(value):
        return _object_node(parts, place, members)
    members[f"{place}.skops"] = _skops_data(value)
    return {"type": "skops", "file": f"{place}.skops"}


def _parts(value: Any) -> dict[str, Any]:
    """Return what a file holds of a model or record of ours; empty for another object."""
    cls = type(value)
    if _is_own(cls) and isinstance(value, StiffnessModel):
        fitted = {name: part for name, part in vars(value).items() if _is_fitted(name)}
        modules = {name: part.state_dict() for name, part in fitted.items() if _is_module(part)}
        return {
            "type": "model",
            "class": _name_of(cls),
            "params": value.get_params(deep=False),
            "fitted": {name: part for name, part in fitted.items() if name not in modules},
            "modules": {
                name: {key: tensor.cpu().numpy() for key, tensor in state.items()}
                for name, state in modules.items()
            },
        }
    if _is_record(cls):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(cls) if f.init}
        return {"type": "record", "class": _name_of(cls), "fields": fields}
    return {}


def _object_node(parts: dict[str, Any], place: str, members: dict[str, bytes]) -> dict[str, Any]:
    """Return the JSON of an object's parts: texts, and dictionaries of its values."""
    return {
        name: part if isinstance(part, str) else _nodes(part, f"{place}/{name}", members)
        for name, part in parts.items()
    }


def _nodes(values: Mapping[str, Any], place: str, members: dict[str, bytes]) -> dict[str, Any]:
    return {
        name: _node(value, f"{place}/{name if _PART.fullmatch(name) else f'#{i}'}", members)
        for i, (name, value) in enumerate(values.items())
    }


def _skops_data(value: Any) -> bytes:
    import skops.io  # takes seconds, as it imports scikit-learn and torch

    data = bytes(skops.io.dumps(value))
    if unknown := sorted({*skops.io.get_untrusted_types(data=data)} - {*TRUSTED}):
        raise ModelError(
            f"it holds {', '.join(unknown)} (valid: objects of scikit-learn, numpy and scipy)"
        )
    return data


def _value(node: Any, members: dict[str, bytes]) -> Any:
    """Return the value of a node, and remove what it uses from the members."""
    match node:
        case list():
            return [_value(item, members) for item in node]
        case {"type": "float", "value": str(text)}:
            return float(text)
        case {"type": "array" | "scalar" as kind, "file": str(file)}:
            array = _array(_taken(file, members), file)
            return array if kind == "array" else array[()]
        case {"type": "skops", "file": str(file)}:
            return _skops_value(_taken(file, members))
        case {"type": "tuple" | "dict" as kind, "items": list(items)}:
            return (tuple if kind == "tuple" else dict)(_value(items, members))
        case {"type": "record", "class": str(name), "fields": dict(fields)}:
            cls = _class_of(name)
            if not _is_record(cls):
                raise DataError(f"holds {name}, which is not a frozen dataclass of stiffbench")
            return cls(**_values(fields, members))
        case {"type": "model"}:
            return _model(node, members)
        case {"type": kind}:
            raise DataError(f"holds a value of the type {kind!r} with the keys {[*node]}")
        case dict():
            return _values(node, members)
    return node


def _values(nodes: Mapping[str, Any], members: dict[str, bytes]) -> dict[str, Any]:
    return {name: _value(node, members) for name, node in nodes.items()}


def _taken(file: str, members: dict[str, bytes]) -> bytes:
    """Return a member's bytes and remove it: named once, it cannot fill the memory."""
    if file not in members:
        raise DataError(f"has no member {file!r}, or {TREE} names it twice")
    return members.pop(file)


def _array(data: bytes, file: str) -> np.ndarray[Any, Any]:
    source = io.BytesIO(data)
    array = np.lib.format.read_array(source, allow_pickle=False)
    if not _is_plain(array.dtype) or source.read(1):
        raise DataError(f"{file!r} is not one array of numbers or texts")
    return array


def _is_plain(dtype: np.dtype[Any]) -> bool:
    """Return whether an array holds only numbers, texts or times, which can be stored as .npy."""
    return dtype.kind in "biufcUSmM" and dtype.itemsize > 0


def _skops_value(data: bytes) -> Any:
    import skops.io

    _members(data)  # skops does not look for bombs
    return skops.io.loads(data, trusted=list(TRUSTED))


def _model(node: Mapping[str, Any], members: dict[str, bytes]) -> StiffnessModel:
    cls = _class_of(node["class"])
    if not issubclass(cls, StiffnessModel):
        raise DataError(f"holds {node['class']}, which is not a stiffbench model")
    params = _values(node["params"], members)
    if params.get("device") == "cuda":
        import torch

        params["device"] = "cuda" if torch.cuda.is_available() else "auto"
    _check_options(cls, params)
    model = cls(**params)
    for name in (*node["fitted"], *node["modules"]):
        if not _is_fitted(name):
            raise DataError(f"sets {name!r}, which is not a fitted attribute")
    for name, part in node["fitted"].items():
        setattr(model, name, _value(part, members))
    for name, state in node["modules"].items():  # last: their shape depends on the others
        setattr(model, name, _module(model, name, _values(state, members)))
    return model


def _plugin_model(node: Any, members: dict[str, bytes], plugins: Mapping[str, type]) -> Any:
    key = str(node["key"])
    if key not in plugins:
        raise DataError(
            f"holds {key}, a third-party model; name its plugin file (--plugin, or `use_plugin`)"
        )
    cls = plugins[key]
    if code_of(cls) != node["code"]:
        raise DataError(f"holds {key}, whose plugin file has changed since; fit the model again")
    model = cls(**_values(node["params"], members))
    for name, part in node["fitted"].items():
        if not name.isidentifier() or name.startswith("__"):
            raise DataError(f"sets {name!r}, which is not a fitted attribute")
        setattr(model, name, _value(part, members))
    return model


def _module(model: Any, name: str, state: Mapping[str, Any]) -> torch.nn.Module:
    import torch

    from stiff_models.device import torch_device

    with torch.device("meta"):  # only shapes: the file may state sizes that it does not hold
        module: torch.nn.Module = model._empty_module(name)
    tensors = {key: torch.from_numpy(np.array(array)) for key, array in state.items()}
    module.load_state_dict(tensors, assign=True)
    return module.to(torch_device(model.get_params().get("device", "cpu"))).eval()


def _check_options(cls: type, params: Mapping[str, object]) -> None:
    """Raise DataError for values that a user could not set, such as 10**9 layers."""
    owner = cls if dataclasses.is_dataclass(cls) else cls.__init__  # type: ignore[misc]
    hints = get_type_hints(owner, include_extras=True)
    for name, value in params.items():
        if name in hints:
            try:
                TypeAdapter(hints[name]).validate_python(value)
            except ValidationError as error:
                reason = error.errors()[0]["msg"]
                raise DataError(f"has the option {name} = {value!r}: {reason}") from error


def _is_fitted(name: str) -> bool:
    return name.endswith("_") and not name.startswith("_")


def _is_module(value: object) -> TypeGuard[torch.nn.Module]:
    torch = sys.modules.get("torch")  # imported already if the value is a module
    return torch is not None and isinstance(value, torch.nn.Module)


def _is_own(cls: type) -> bool:
    return cls.__module__.partition(".")[0] in _OWN_PACKAGES


def _is_record(cls: type) -> bool:
    """Return whether a class is a frozen stiffbench dataclass, stored by its fields."""
    parameters = getattr(cls, "__dataclass_params__", None)
    return _is_own(cls) and parameters is not None and bool(parameters.frozen)


def _full_name(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _name_of(cls: type) -> str:
    """Return the catalogue key of a class, which survives a move; else "module:Name"."""
    name = _full_name(cls)
    keys = [info.key for info in MODELS if info.target == name]
    return keys[0] if keys else vars(cls).get("key", name)  # `key`: of a class made from a key


def _class_of(name: str) -> type:
    """Return the class of a catalogue key or "module:Name"; import only stiffbench modules."""
    module_name, _, class_name = name.partition(":")
    if module_name.partition(".")[0] not in _OWN_PACKAGES:
        info = model_info(name)
        if info.missing():
            raise DataError(f"holds a {name}, which cannot be used here: {info.missing()}")
        shipped: type = info.load()
        return shipped
    try:
        cls = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError):
        cls = None
    if not isinstance(cls, type) or not _is_own(cls):  # it may have moved since
        raise DataError(f"holds {name}, which this version of stiffbench does not have")
    return cls
