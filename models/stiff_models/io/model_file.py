"""Read and write fitted models as skops files; stiffbench's objects become plain dictionaries.

A file holds the model's key, options, robot and fitted attributes. `load` returns a model with
bit-equal predictions on the same machine. Files contain no code: skops builds only objects of the
types in a fixed list (no pickle). A dictionary names only models and frozen dataclasses of
stiffbench, whose constructors check their arguments. The file of a third-party model has the hash
of the plugin's code, and is read only if the user names the plugin.
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

from stiff_models.model_catalog import MODELS, model_info
from stiff_protocols.contract.errors import DataError, ModelError, NotFittedError, StiffBenchError
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.stiffness_model import StiffnessModel
from stiff_protocols.contract.types import Robot

if TYPE_CHECKING:
    import torch

FORMAT = 5
_KIND_KEY = "stiffbench"
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
    import skops.io  # takes seconds

    key = next(iter(plugin)) if plugin else key_of(model)
    if not hasattr(model, "robot_"):
        raise NotFittedError(f"{type(model).__name__}: call fit before save")
    try:
        node = _plugin_node(model, key, plugin[key]) if plugin else _plain(model)
        content = {"format": FORMAT, "written_by": version("stiffbench"), "model": node}
        data = bytes(skops.io.dumps(content))
        unknown = sorted({*skops.io.get_untrusted_types(data=data)} - {*TRUSTED})
    except Exception as error:  # third-party objects may raise anything
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
            raise ModelError(f"{name} is a torch module; store its weights as arrays")
    about = {"key": key, "code": code_of(type(model)), "params": _plain(dict(params))}
    return {_KIND_KEY: "plugin", **about, "fitted": _plain(fitted)}


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
        node = _content(Path(path).read_bytes())["model"]
        model = _model(node) if node[_KIND_KEY] == "model" else _plugin_model(node, plugins or {})
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


def _content(data: bytes) -> Mapping[str, Any]:
    """Return the dictionary that `save` wrote, with the checks that skops omits."""
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
    """Raise DataError unless the bytes are an uncompressed archive: a guard against zip bombs."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(member.file_size for member in archive.infolist())
            has_schema = "schema.json" in archive.namelist()
    except zipfile.BadZipFile as error:
        raise DataError(
            "not a model file, or a corrupt file; give a file that `bench fit` wrote"
        ) from error
    if not has_schema:
        raise DataError("not a model file of stiffbench; give a file that `bench fit` wrote")
    if size > len(data):  # `save` compresses nothing
        raise DataError(f"a file of {len(data)} bytes unpacks to {size} bytes; fit the model again")


def _plain(value: Any) -> Any:
    """Return a value with each stiffbench object as a dictionary; skops handles other objects."""
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
        return {_KIND_KEY: "module", "state": state}
    cls = type(value)
    if _is_own(cls) and isinstance(value, StiffnessModel):
        fitted = {name: part for name, part in vars(value).items() if _is_fitted(name)}
        params = _plain(value.get_params(deep=False))
        return {
            _KIND_KEY: "model",
            "class": _name_of(cls),
            "params": params,
            "fitted": _plain(fitted),
        }
    if _is_record(cls):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(cls) if f.init}
        return {_KIND_KEY: "record", "class": _name_of(cls), "fields": _plain(fields)}
    return value


def _restored(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return type(value)(_restored(item) for item in value)
    if not isinstance(value, dict):
        return value
    if _KIND_KEY not in value:
        return {key: _restored(item) for key, item in value.items()}
    if value[_KIND_KEY] == "model":
        return _model(value)
    cls = _class_of(value["class"])
    if not _is_record(cls):
        raise DataError(f"holds {value['class']}, which is not a frozen dataclass of stiffbench")
    return cls(**_restored(value["fields"]))


def _model(node: Mapping[str, Any]) -> StiffnessModel:
    cls = _class_of(node["class"])
    if not issubclass(cls, StiffnessModel):
        raise DataError(f"holds {node['class']}, which is not a stiffbench model")
    params = _restored(node["params"])
    if params.get("device") == "cuda":
        import torch

        params["device"] = "cuda" if torch.cuda.is_available() else "auto"
    _check_options(cls, params)
    model = cls(**params)
    modules = {}
    for name, value in node["fitted"].items():
        if not _is_fitted(name):
            raise DataError(f"sets {name!r}, which is not a fitted attribute")
        if isinstance(value, dict) and value.get(_KIND_KEY) == "module":
            modules[name] = value["state"]
        else:
            setattr(model, name, _restored(value))
    for name, state in modules.items():  # last: their shape depends on the other attributes
        setattr(model, name, _module(model, name, state))
    return model


def _plugin_model(node: Mapping[str, Any], plugins: Mapping[str, type]) -> Any:
    key = str(node["key"])
    if key not in plugins:
        raise DataError(
            f"holds {key}, a third-party model; name its plugin file (--plugin, or `use_plugin`)"
        )
    cls = plugins[key]
    if code_of(cls) != node["code"]:
        raise DataError(f"holds {key}, whose plugin file has changed since; fit the model again")
    model = cls(**_restored(node["params"]))
    for name, value in node["fitted"].items():
        if not name.isidentifier() or name.startswith("__"):
            raise DataError(f"sets {name!r}, which is not a fitted attribute")
        setattr(model, name, _restored(value))
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
