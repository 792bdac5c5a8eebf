"""What the engine asks of a model: two methods, and optional ones that have defaults.

A model has scikit-learn *semantics*: a constructor with keyword-only arguments that only stores
them, `fit` that computes, fitted attributes that end in an underscore, `get_params` and
`set_params` (inherit `sklearn.base.BaseEstimator` for them, or write them).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Self

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
        springs_: a `stiff_protocols.springs.identification.IdentifiedSprings`: what the samples
            say of each spring.
        curves_: name of each training -> (n_points, 3) array of step, training loss and validation
            loss (NaN: none), in the network's own units. "spring " and a joint's name -> torque on
            a joint that nothing loads before [N m or N], its turn [rad or m] and the turn's
            standard deviation.
        best_params_: option -> value that was chosen in the fit.
    """

    diagnostics_: dict[str, float]
    springs_: Any
    curves_: dict[str, FloatArray]
    best_params_: Mapping[str, Any]

    def fit(
        self, train: Samples, *, robot: Robot, validation: Samples | None = None, seed: int = 0
    ) -> Self:
        """Learn from `train`.

        Args:
            train: the only samples the parameters may be fitted to.
            robot: kinematics of the robot that was measured.
            validation: samples that may choose an epoch, never fit a parameter; None: none.
            seed: seed of everything random; the same seed gives the same model.
        """
        raise NotImplementedError

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] for (n, n_joints) `q` [rad] and (n, 6) `wrench`."""
        raise NotImplementedError

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the constructor's arguments as stored."""
        raise NotImplementedError

    def set_params(self, **params: Any) -> Self:
        """Store new values of constructor arguments."""
        raise NotImplementedError

    def check_params(self) -> None:
        """Raise ConfigError for options that do not fit together, before anything is computed.

        It names the option, its value and what is valid.
        """

    def check_robot(self, robot: Robot) -> None:
        """Raise ConfigError for a robot that the options cannot serve, as `check_params`."""

    def missing(self) -> str:
        """Return what is missing on this machine (a package, weights); "" for nothing."""
        return ""

    def chooses_epoch(self) -> bool:
        """Return False if the last epoch is kept: validation rows are then training rows.

        Only a model with `uses_validation` is asked.
        """
        return True

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return where each deflection lies with probability `coverage` (0..1), axis by axis.

        Models without it get split-conformal intervals.
        """
        raise NotImplementedError

    def predict_at_tcp(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] of the robot's own TCP under wrenches that act there.

        For a model whose `predict` is of another measured point. Tool paths are corrected for the
        TCP, which the commands move.
        """
        return self.predict(q, wrench)

    def covariance(
        self, q: FloatArray, wrench: FloatArray, other_q: FloatArray, other_wrench: FloatArray
    ) -> FloatArray:
        """Return (3, n, m) the covariance [m²] at n and m poses and loads, axis by axis.

        It is that of the deflections without a measurement's noise, given the training samples.
        With it the next poses are chosen: a measurement lowers the variance elsewhere by what it
        has in common with it.
        """
        raise NotImplementedError

    def noise_variance(self) -> FloatArray:
        """Return (3,) the variance [m²] of a measured deflection's own error; see `covariance`."""
        raise NotImplementedError

    @property
    def regime(self) -> str:
        """How training labels are used, as a row must say; "" for the usual way.

        It follows from the options and from `use_source` alone. Transfer without target labels and
        transfer with them cannot be compared.
        """
        return ""

    @property
    def source_words(self) -> str:
        """What the simulated source domain is, by the options and `use_source`; "" for none."""
        return ""

    def use_source(self, source: BenchmarkData | None) -> None:
        """Store what the next `fit` makes its source domain of; None: the training samples.

        The other robot or specimen has as many joints of the same types; all of its samples may be
        learned from. A copy by `sklearn.base.clone` must keep the source (write
        `__sklearn_clone__`): intervals come from copies.
        """
        raise NotImplementedError

    def save(self, path: Path) -> None:
        """Write the fitted model to a file that `stiff_models.load` reads."""
        raise NotImplementedError


def offers(model: object, method: str) -> bool:
    """Say whether a model, or its class, has an optional method of its own."""
    own = getattr(model, method, None)
    default = getattr(StiffnessModel, method)
    return own is not None and getattr(own, "__func__", own) is not default


def optional(model: object, method: str) -> Any:
    """Return an optional method of a model; `StiffnessModel`'s if it has none."""
    own = getattr(model, method, None)
    return partial(getattr(StiffnessModel, method), model) if own is None else own


def interval_at_tcp(
    model: StiffnessModel, interval: Interval, q: FloatArray, wrench: FloatArray
) -> Interval:
    """Return an interval about a model's `predict`, moved to its prediction of the robot's TCP.

    Its width stays: how wrong the tool's rotation is over the distance is not in it.
    """
    if not offers(model, "predict_at_tcp"):
        return interval
    shift = model.predict_at_tcp(q, wrench) - model.predict(q, wrench)
    return Interval(interval.lower + shift, interval.upper + shift, interval.coverage)
