"""`sklearn:module.Class`: any scikit-learn regressor as a model, its arguments as options."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import itertools
import re
from dataclasses import field, make_dataclass
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import all_estimators

from stiff_models.networks.encoded_model import StandardisedRows
from stiff_models.physics.vjm import OnPhysics
from stiff_models.regressors.regressor_model import RegressorModel, for_three_outputs
from stiff_protocols.contract.errors import ConfigError, ModelError, unknown_name
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.types import FloatArray

PREFIX = "sklearn:"
ON_PHYSICS = "vjm+"
_DOT = "/"
"""Replaces the dots of a key in its class's qualified name, which pickle would split."""


class SklearnModel(RegressorModel):
    """A regressor of scikit-learn on standardised features and deflections.

    A regressor of one output is fitted once per axis. A regressor with a `random_state` gets the
    seed of the fit, unless the option is set.
    """

    key: ClassVar[str]
    estimator_class: ClassVar[type[BaseEstimator]]

    def check_params(self) -> None:
        """Check the options as the regressor does in a fit; ConfigError if one is not valid."""
        try:
            self._regressor(0)
            self._estimator()._validate_params()
        except (ValueError, TypeError) as error:
            raise ConfigError(f"{self.key}: {error}") from error

    def _estimator(self) -> Any:
        names = inspect.signature(self.estimator_class).parameters
        return self.estimator_class(**{name: getattr(self, name) for name in names})

    def _regressor(self, seed: int) -> Any:
        estimator = self._estimator()
        if estimator.get_params(deep=False).get("random_state", seed) is None:
            estimator.set_params(random_state=seed)
        return for_three_outputs(estimator)

    def _learn(self, train: StandardisedRows, validation: StandardisedRows | None) -> None:
        try:
            super()._learn(train, validation)
        except ValueError as error:
            raise self._refusal("learn", error) from error

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        try:
            return super()._predict(q, wrench)
        except ValueError as error:  # for example, fewer training samples than neighbours
            raise self._refusal("predict", error) from error

    def _refusal(self, action: str, error: ValueError) -> ModelError:
        return ModelError(
            f"{self.key} cannot {action} these samples: {' '.join(str(error).split())}"
        )


def member(key: str) -> ModelInfo:
    """Return the catalogue entry of "sklearn:module.Class" or "vjm+sklearn:module.Class".

    Raises:
        ConfigError: the key does not name a regressor, or its regressor requires another object.
    """
    model = _model_class(key)
    inputs = "the residual of the VJM" if issubclass(model, OnPhysics) else "standardised features"
    return ModelInfo(
        key=key,
        target=model,
        version=1,
        library="scikit-learn",
        summary=f"scikit-learn's {model.estimator_class.__name__} on {inputs}",
        reference=f"sklearn.{_public_path(model.estimator_class)}",
    )


@functools.cache  # one key, one class
def _model_class(key: str) -> type[SklearnModel]:
    residual = key.startswith(ON_PHYSICS)
    estimator = _regressor_class(key, key.removeprefix(ON_PHYSICS).removeprefix(PREFIX))
    types = _documented_types(estimator)
    parameters = inspect.signature(estimator).parameters
    option = Annotated[Any, BeforeValidator(literal)]
    lines = [f"    {name}: {types.get(name, 'see scikit-learn')}" for name in parameters]
    return make_dataclass(
        ("Vjm" if residual else "") + estimator.__name__,
        [
            (name, option, field(default=parameter.default))
            for name, parameter in parameters.items()
        ],
        bases=(OnPhysics, SklearnModel) if residual else (SklearnModel,),
        namespace={
            "key": key,
            "estimator_class": estimator,
            "__doc__": f"scikit-learn's {estimator.__name__}.\n\nAttributes:\n" + "\n".join(lines),
            "__module__": __name__,
            "__qualname__": key.replace(".", _DOT),
        },
        kw_only=True,
        eq=False,
        repr=False,
    )


def __getattr__(name: str) -> type[SklearnModel]:
    """Return the class of a key, so that pickles can refer to it in any process."""
    if not name.startswith((PREFIX, ON_PHYSICS + PREFIX)):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _model_class(name.replace(_DOT, "."))


def _documented_types(estimator: type) -> dict[str, str]:
    """Return types, range and default of each parameter in a class's numpydoc section."""
    text = inspect.cleandoc(estimator.__doc__ or "").partition("Parameters\n---")[2]
    documented = re.findall(r"^(\w+) ?: (.+(?:\n {12,}\S.*)*)", text, re.MULTILINE)
    return {name: " ".join(kind.split()) for name, kind in reversed(documented)}


def key_of_class(cls: type) -> str:
    """Return the key of a class of scikit-learn, such as "sklearn:linear_model.Ridge"."""
    return PREFIX + _public_path(cls)


def literal(value: Any) -> Any:
    """Return the Python value of a text: "300", "0.5", "None", "true", "(10, 10)".

    A text that is not a Python literal stays a text ("sqrt"). Other values are not changed.
    """
    if not isinstance(value, str):
        return value
    words = {"true": True, "false": False, "none": None}
    if value.lower() in words:
        return words[value.lower()]
    try:
        return ast.literal_eval(value)
    except (ValueError, SyntaxError):
        return value


def _regressor_class(key: str, path: str) -> type[BaseEstimator]:
    module, _, name = path.rpartition(".")
    try:
        estimator = getattr(importlib.import_module(f"sklearn.{module}"), name) if module else None
    except (ImportError, AttributeError):
        estimator = None
    if not isinstance(estimator, type):
        raise _unknown(key, name)
    is_estimator = issubclass(estimator, BaseEstimator)
    parameters = inspect.signature(estimator).parameters.values() if is_estimator else ()
    for parameter in parameters:
        if parameter.default is parameter.empty:
            raise ConfigError(
                f"{key!r}: sklearn.{path} requires {parameter.name!r}, an object that no option "
                "can set; write a plugin"
            )
    if not is_estimator or not issubclass(estimator, RegressorMixin):
        raise ConfigError(
            f"{key!r}: sklearn.{path} is not a regressor (valid: a scikit-learn class that "
            f"predicts numbers, for example {PREFIX}ensemble.RandomForestRegressor)"
        )
    if _public_path(estimator) != path:
        raise _unknown(key, name)
    return estimator


def _unknown(key: str, name: str) -> ConfigError:
    """Return the error for an unknown key; if the class is in another module, name its key."""
    prefix = (ON_PHYSICS if key.startswith(ON_PHYSICS) else "") + PREFIX
    classes = [cls for _, cls in all_estimators(type_filter="regressor")]
    same = [cls for cls in classes if cls.__name__.lower() == name.lower()]
    return unknown_name("model", key, [prefix + _public_path(cls) for cls in same or classes])


def _public_path(cls: type) -> str:
    """Return "ensemble.RandomForestRegressor" of a class in sklearn.ensemble._forest."""
    parts = cls.__module__.split(".")[1:]
    public = itertools.takewhile(lambda part: not part.startswith("_"), parts)
    return ".".join([*public, cls.__name__])
