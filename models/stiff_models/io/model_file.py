"""Fitted models as files: what skops writes, with stiffbench's own objects as plain dictionaries.

A file holds the model's key, its options, its robot and its fitted attributes; `load` gives a
model with bit-equal predictions on the same machine. Nothing in a file is code: skops builds
objects of the types in a fixed list alone (no pickle), and a dictionary names models and frozen
dataclasses of ours alone, whose constructors check what they are given. The file of a plugin's
model has the hash of the plugin's code, and is read only where the user names the plugin.
"""

from __future__ import annotations

import dataclasses
import importlib
import io
import sys
import zipfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, TypeGuard, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError
from sklearn.base import BaseEstimator

from stiff_models.model_catalog import MODELS, model_info
from stiff_protocols.contract.errors import DataError, ModelError, NotFittedError, StiffBenchError
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.types import Robot

if TYPE_CHECKING:
    import torch

FORMAT = 5
_OWN = "stiffbench"
"""Key that marks the dictionary of an object of ours: "model", "record" or "module"."""
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
"""Types that are read beside those that skops trusts."""


def key_of(model: object) -> str:
    """Return the catalogue key under which a model is saved; ModelError where it has none."""
    key, cls = _name_of(type(model)), type(model)
    if not _is_own(cls) or key == _full_name(cls):
        raise ModelError(
            f"{type(model).__name__} is no model that stiffbench ships, and its files hold no "
            "others; it can be saved by its own means"
        )
    return key


def save(model: Any, path: Path, plugin: Mapping[str, Mapping[str, Any]] | None = None) -> None:
    """Write a fitted model to one file, whole or not at all; errors as of `FittedModel.save`.

    Args:
        model: one of ours, or a plugin's.
        path: the file; one that exists is replaced.
        plugin: key of a plugin's model -> its options; None: the model is ours.
    """
    import skops.io  # takes seconds

    key = next(iter(plugin)) if plugin else key_of(model)
    if not hasattr(model, "robot_"):
        raise NotFittedError(f"{type(model).__name__}: call fit before save")
    try:
        node = _plugin_node(model, key, plugin[key]) if plugin else _plain(model)
        content = {"format": FORMAT, "written_by": version("stiffbench"), "model": node}
        data = bytes(skops.io.dumps(content))
        unknown = sorted({*skops.io.get_untrusted_types(data=data)} - {*TRUSTED})
    except Exception as error:  # whatever a stranger's object does when it is taken apart
        raise ModelError(f"{key} cannot be saved: {error}") from error
    if unknown:
        raise ModelError(
            f"{key} cannot be saved: it holds {', '.join(unknown)} (valid: objects of "
            "scikit-learn, numpy and scipy)"
        )
    with written_whole(Path(path)) as temporary:
        temporary.write_bytes(data)


def _plugin_node(model: Any, key: str, params: Mapping[str, Any]) -> dict[str, Any]:
    fitted = {name: part for name, part in vars(model).items() if name not in params}
    for name, part in fitted.items():
        if _is_module(part):
            raise ModelError(f"{name} is a torch module; keep its weights as arrays")
    about = {"key": key, "code": code_of(type(model)), "params": _plain(dict(params))}
    return {_OWN: "plugin", **about, "fitted": _plain(fitted)}


def load(path: Path | str, plugins: Mapping[str, type] | None = None) -> Any:
    """Return the model that a file holds.

    Networks run on the device of the model's options; where that is "cuda" and there is none here,
    on "auto".

    Args:
        path: the file.
        plugins: key -> class of the plugins' models that may be built.

    Raises:
        DataError: the file cannot be read, is damaged or of another format, or holds a model or an
            object that this version does not know.
    """
    try:
        node = _content(Path(path).read_bytes())["model"]
        model = _model(node) if node[_OWN] == "model" else _plugin_model(node, plugins or {})
        if not isinstance(getattr(model, "robot_", None), Robot):
            raise DataError("holds a model without its robot")
        return model
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # a crafted or damaged archive can raise anything
        said = " ".join(str(error).split())  # an array's text has several lines
        if not isinstance(error, StiffBenchError):
            said = (
                f"holds no model that stiffbench {version('stiffbench')} can build: "
                f"{type(error).__name__}: {said}"
            )
        raise DataError(f"{path}: {said}") from error


def _content(data: bytes) -> Mapping[str, Any]:
    """What `save` gave to skops, seen through for what skops does not look at."""
    import skops.io

    _check_archive(data)
    content: Mapping[str, Any] = skops.io.loads(data, trusted=list(TRUSTED))
    if content["format"] != FORMAT:
        raise DataError(
            f"has format {content['format']}, written by stiffbench {content['written_by']} "
            f"(valid here: {FORMAT})"
        )
    return content


def _check_archive(data: bytes) -> None:
    """See that the bytes are an archive that unpacks to no more than it takes: no zip bomb."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(member.file_size for member in archive.infolist())
            known = "schema.json" in archive.namelist()
    except zipfile.BadZipFile as error:
        raise DataError(
            "not a model file, or a corrupt one; give a file that `bench fit` wrote"
        ) from error
    if not known:
        raise DataError("not a model file of stiffbench; give a file that `bench fit` wrote")
    if size > len(data):  # `save` compresses nothing
        raise DataError(f"a file of {len(data)} bytes unpacks to {size}")


def _plain(value: Any) -> Any:
    """Return a value with each object of ours as a dictionary; skops knows the rest or refuses."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, tuple):
        return tuple(_plain(item) for item in value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, PurePath):
        return str(value)
    if _is_module(value):
        state = {name: tensor.cpu().numpy() for name, tensor in value.state_dict().items()}
        return {_OWN: "module", "state": state}
    cls = type(value)
    if _is_own(cls) and isinstance(value, BaseEstimator):
        fitted = {name: part for name, part in vars(value).items() if _is_fitted(name)}
        params = _plain(value.get_params(deep=False))
        return {_OWN: "model", "class": _name_of(cls), "params": params, "fitted": _plain(fitted)}
    if _is_record(cls):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(cls) if f.init}
        return {_OWN: "record", "class": _name_of(cls), "fields": _plain(fields)}
    return value


def _restored(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return type(value)(_restored(item) for item in value)
    if not isinstance(value, dict):
        return value
    if _OWN not in value:
        return {key: _restored(item) for key, item in value.items()}
    if value[_OWN] == "model":
        return _model(value)
    cls = _class_of(value["class"])
    if not _is_record(cls):
        raise DataError(f"holds {value['class']}, which is no frozen dataclass of stiffbench's")
    return cls(**_restored(value["fields"]))


def _model(node: Mapping[str, Any]) -> BaseEstimator:
    cls = _class_of(node["class"])
    if not issubclass(cls, BaseEstimator):
        raise DataError(f"holds {node['class']}, which is no model of stiffbench's")
    params = _restored(node["params"])
    if params.get("device") == "cuda":
        import torch

        params["device"] = "cuda" if torch.cuda.is_available() else "auto"
    _check_options(cls, params)
    model = cls(**params)
    modules = {}
    for name, value in node["fitted"].items():
        if not _is_fitted(name):
            raise DataError(f"sets {name!r}, which is no fitted attribute")
        if isinstance(value, dict) and value.get(_OWN) == "module":
            modules[name] = value["state"]
        else:
            setattr(model, name, _restored(value))
    for name, state in modules.items():  # last: their shape follows from the rest
        setattr(model, name, _module(model, name, state))
    return model


def _plugin_model(node: Mapping[str, Any], plugins: Mapping[str, type]) -> Any:
    key = str(node["key"])
    if key not in plugins:
        raise DataError(
            f"holds {key}, a plugin's model; name the plugin's file (--plugin, or `use_plugin`)"
        )
    cls = plugins[key]
    if code_of(cls) != node["code"]:
        raise DataError(f"holds {key} of other code than the plugin's file has now; fit it again")
    model = cls(**_restored(node["params"]))
    for name, value in node["fitted"].items():
        if not name.isidentifier() or name.startswith("__"):
            raise DataError(f"sets {name!r}, which is no fitted attribute")
        setattr(model, name, _restored(value))
    return model


def _module(model: Any, name: str, state: Mapping[str, Any]) -> torch.nn.Module:
    import torch

    from stiff_models.device import torch_device

    with torch.device("meta"):  # shapes alone: a file may promise more than it holds
        module: torch.nn.Module = model._empty_module(name)
    tensors = {key: torch.from_numpy(np.array(array)) for key, array in state.items()}
    module.load_state_dict(tensors, assign=True)
    return module.to(torch_device(model.get_params().get("device", "cpu"))).eval()


def _check_options(cls: type, params: Mapping[str, object]) -> None:
    """See that options have the values that a user could set: no network has 10**9 layers."""
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
    torch = sys.modules.get("torch")  # who holds a module has imported it
    return torch is not None and isinstance(value, torch.nn.Module)


def _is_own(cls: type) -> bool:
    return cls.__module__.partition(".")[0] in _OWN_PACKAGES


def _is_record(cls: type) -> bool:
    """Objects of frozen dataclasses of ours are stored by their fields."""
    parameters = getattr(cls, "__dataclass_params__", None)
    return _is_own(cls) and parameters is not None and bool(parameters.frozen)


def _full_name(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _name_of(cls: type) -> str:
    """Return the key of a class in the catalogue, which outlives a move; else "module:Name"."""
    name = _full_name(cls)
    keys = [info.key for info in MODELS if info.target == name]
    return keys[0] if keys else vars(cls).get("key", name)  # `key`: of a class made from a key


def _class_of(name: str) -> type:
    """Return the class of a catalogue key or "module:Name"; only modules of ours are imported."""
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
        raise DataError(f"holds {name}, which this version of stiffbench lacks")
    return cls
