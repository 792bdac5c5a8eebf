"""The interface of a model: two required methods, and optional methods with defaults.

A model has scikit-learn *semantics*: a constructor with keyword-only arguments that only stores
them, `fit` that computes, fitted attributes that end in an underscore, `get_params` and
`set_params` (inherit `StiffnessModel` or `sklearn.base.BaseEstimator` for them, or write them).
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import (
    BenchmarkData,
    FloatArray,
    Interval,
    Robot,
    Samples,
)


class StiffnessModel:
    """A model that predicts the deflection of a robot's TCP under a known wrench.

    Inheriting is optional: any object with `fit`, `predict`, `get_params` and `set_params` is a
    model. It may have any of the other methods and attributes below; without one, the default here
    holds.

    Attributes:
        diagnostics_: numbers such as stiffnesses, name with unit -> value; printed with a result.
        springs_: a `stiff_protocols.springs.identification.IdentifiedSprings` with each spring's
            stiffness and error.
        curves_: name of each training -> (n_points, 3) array of step, training loss and validation
            loss (NaN: none), in the network's own units. "spring " and a joint's name -> torque on
            a previously unloaded joint [N m or N], its turn [rad or m] and the turn's standard
            deviation.
        best_params_: option -> value chosen in the fit.
        takes_directions: true for a model that learns from `Samples.directions`; others are not
            given such samples.
        takes_levers: true for one that learns from `Samples.levers`, too, and whose
            `predict_reading` takes them as a third argument.
    """

    takes_directions: ClassVar[bool] = False
    takes_levers: ClassVar[bool] = False

    diagnostics_: dict[str, float]
    springs_: Any
    curves_: dict[str, FloatArray]
    best_params_: Mapping[str, Any]

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Learn from `train`.

        Args:
            train: the only samples for fitting parameters.
            robot: kinematics of the measured robot.
            validation: samples that may choose an epoch but not fit a parameter; None: none.
            seed: seed of all random numbers; the same seed gives the same model.
        """
        raise NotImplementedError

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] for (n, n_joints) `q` [rad] and (n, 6) `wrench`."""
        raise NotImplementedError

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the constructor's arguments as stored, by name; `deep` changes nothing."""
        options = inspect.signature(type(self)).parameters
        return {name: getattr(self, name) for name in sorted(options)}

    def set_params(self, **params: Any) -> Self:
        """Store new values of constructor arguments.

        Raises:
            ValueError: the constructor has no such argument.
        """
        for name, value in params.items():
            if name not in self.get_params():
                raise ValueError(f"{type(self).__name__} has no option {name!r}")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        """Return the class with the options that differ from their defaults."""
        options = inspect.signature(type(self)).parameters
        changed = [
            f"{name}={value!r}"
            for name, value in self.get_params().items()
            if repr(value) != repr(options[name].default)
        ]
        return f"{type(self).__name__}({', '.join(changed)})"

    def check_params(self) -> None:
        """Raise ConfigError for options that contradict each other, before any computation.

        The message names the option, its value and the valid values.
        """

    def check_robot(self, robot: Robot) -> None:
        """Raise ConfigError for a robot that the options do not support, as `check_params`."""

    def missing(self) -> str:
        """Return what is missing on this machine (a package, weights); "" for nothing."""
        return ""

    def chooses_epoch(self) -> bool:
        """Return False if the last epoch is kept: validation rows are then training rows.

        It is called only for a model with `uses_validation`.
        """
        return True

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return each deflection's interval of probability `coverage` (0..1), axis by axis.

        Models without it get split-conformal intervals.
        """
        raise NotImplementedError

    def predict_at_tcp(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] of the robot's TCP under wrenches that act there.

        It is for a model whose `predict` refers to another measured point. Tool paths are corrected
        for the TCP, which the commands move.
        """
        return self.predict(q, wrench)

    def predict_at_point(self, q: FloatArray, wrench: FloatArray, point: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] of a point of the tool under wrenches that act there.

        It is for a model of springs, which predict at every point of a rigid tool. `point` is (3,)
        in the frame of the last joint, m.
        """
        raise NotImplementedError

    def predict_reading(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] that the rig of the training samples would read.

        It is for a model that tells robot and rig apart. Measured data are compared with it; the
        truth of a simulation and tool paths are compared with `predict`.
        """
        return self.predict(q, wrench)

    def covariance(
        self, q: FloatArray, wrench: FloatArray, other_q: FloatArray, other_wrench: FloatArray
    ) -> FloatArray:
        """Return the (3, n, m) covariance [m²] at n and m poses and loads, axis by axis.

        It is the covariance of deflections without measurement noise, given the training samples.
        It serves to choose the next poses: a measurement lowers the variance at correlated poses.
        """
        raise NotImplementedError

    def noise_variance(self) -> FloatArray:
        """Return the (3,) variances [m²] of a measured deflection's error; see `covariance`."""
        raise NotImplementedError

    @property
    def regime(self) -> str:
        """Use of training labels, to be stated in a row; "" for the usual use.

        It depends only on the options and on `use_source`. Transfer without target labels and
        transfer with target labels cannot be compared.
        """
        return ""

    @property
    def source_words(self) -> str:
        """Description of the simulated source domain by options and `use_source`; "" for none."""
        return ""

    def use_source(self, source: BenchmarkData | None) -> None:
        """Store the data for the source domain of the next `fit`; None: the training samples.

        The other robot or specimen has as many joints of the same types; all of its samples may be
        used. A copy by `sklearn.base.clone` must keep the source (implement `__sklearn_clone__`),
        because intervals come from copies.
        """
        raise NotImplementedError

    def save(self, path: Path) -> None:
        """Write the fitted model to a file that `stiff_models.load` reads."""
        raise NotImplementedError


def offers(model: object, method: str) -> bool:
    """Return whether a model, or its class, overrides an optional method."""
    member = getattr(model, method, None)
    default = getattr(StiffnessModel, method)
    return member is not None and getattr(member, "__func__", member) is not default


def optional(model: object, method: str) -> Any:
    """Return an optional method of a model; `StiffnessModel`'s if it has none."""
    member = getattr(model, method, None)
    return partial(getattr(StiffnessModel, method), model) if member is None else member


def interface_fault(model: object) -> str:
    """Return why `fit` or `predict` of a model cannot be called by stiffbench; "" if they can."""
    definitions = {
        "fit": "fit(self, train, *, robot, validation=None, seed=0)",
        "predict": "predict(self, q, wrench)",
    }
    missing = [name for name in definitions if not callable(getattr(model, name, None))]
    if missing:
        valid = " and ".join(definitions[name] for name in missing)
        return f"has no {' and no '.join(missing)} method (valid: {valid})"
    for name, definition in definitions.items():
        options = dict.fromkeys(("robot", "validation", "seed") if name == "fit" else ())
        arguments = ("train",) if name == "fit" else ("q", "wrench")
        try:
            signature = inspect.signature(getattr(model, name))
        except ValueError:  # an extension module states no signature
            continue
        try:
            signature.bind(*arguments, **options)
        except TypeError as error:
            return f"has {name}{signature}: {error} (valid: {definition})"
    return ""


MODELS_OF_READINGS = (
    "bayes-springs",
    "curve-springs",
    "fourier-springs",
    "vjm",
    "vjm-full",
    "vjm-multisegment",
)
"""Keys of the shipped models with `takes_directions` and `takes_levers`."""


def check_readings(model: object, samples: Samples) -> None:
    """Raise ConfigError if a model cannot learn from the samples' directions, or their levers."""
    if samples.directions.size and not getattr(model, "takes_directions", False):
        numbers = samples.is_read.sum(axis=1)
        few, most = int(numbers.min()), int(numbers.max())
        count = f"{few} to {most}" if few < most else f"{most}"
        raise ConfigError(
            f"{type(model).__name__} learns from deflections along x, y and z; these samples have "
            f"{count} number{'s' * (most > 1)} a row, each along a direction of its own (valid: "
            f"{', '.join(MODELS_OF_READINGS)})"
        )
    _check_levers(model, samples.levers)


def predicted_readings(
    model: object, q: FloatArray, wrench: FloatArray, levers: FloatArray
) -> FloatArray:
    """Return the (n, 3) deflections [m] of `predict_reading` at the points of `Samples.levers`.

    Raises:
        ConfigError: the model predicts at the TCP only.
    """
    _check_levers(model, levers)
    at = (levers,) if levers.size else ()
    return np.asarray(optional(model, "predict_reading")(q, wrench, *at))


def _check_levers(model: object, levers: FloatArray) -> None:
    if levers.size and not getattr(model, "takes_levers", False):
        raise ConfigError(
            f"{type(model).__name__} knows deflections of the TCP; these samples were read at "
            f"other points (valid: {', '.join(MODELS_OF_READINGS)})"
        )


def interval_at_points(
    model: StiffnessModel, interval: Interval, q: FloatArray, wrench: FloatArray, levers: FloatArray
) -> Interval:
    """Return an interval about `predict`, moved to the points of levers; its width stays."""
    if not levers.size:
        return interval
    at_tcp = optional(model, "predict_reading")(q, wrench)
    return interval.moved(predicted_readings(model, q, wrench, levers) - at_tcp)


def interval_at_tcp(
    model: StiffnessModel, interval: Interval, q: FloatArray, wrench: FloatArray
) -> Interval:
    """Return an interval about a model's `predict`, moved to its prediction of the robot's TCP.

    Its width does not change: it ignores the error of the tool's rotation over the distance.
    """
    if not offers(model, "predict_at_tcp"):
        return interval
    return interval.moved(model.predict_at_tcp(q, wrench) - model.predict(q, wrench))
