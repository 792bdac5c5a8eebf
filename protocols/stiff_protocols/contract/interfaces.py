"""What the engine asks of a model, a data set and a protocol: structural types, no base class.

A model has scikit-learn *semantics*: a constructor with keyword-only arguments that only
stores them, `fit` that computes, fitted attributes that end in an underscore, `get_params`
and `set_params` (inherit `sklearn.base.BaseEstimator` for them, or write them).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

from stiff_protocols.contract.plugin import Grid
from stiff_protocols.contract.types import (
    BenchmarkData,
    Deflection,
    FloatArray,
    IntArray,
    Interval,
    Robot,
    Samples,
    Split,
)


@runtime_checkable
class StiffnessModel(Protocol):
    """Predicts the deflection of a robot's TCP under a known wrench."""

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

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] for (n, n_joints) `q` [rad] and (n, 6) `wrench`."""

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the constructor's arguments as stored."""

    def set_params(self, **params: Any) -> Self:
        """Store new values of constructor arguments."""


@runtime_checkable
class ReportsDiagnostics(Protocol):
    """Optional power: numbers such as stiffnesses; `diagnostics_`: name with unit -> value."""

    diagnostics_: Mapping[str, float]


@runtime_checkable
class IdentifiesSprings(Protocol):
    """Optional power: stiffnesses of springs; `springs_`: what the samples say of each.

    It is a `stiff_protocols.springs.identification.IdentifiedSprings`.
    """

    springs_: Any


SPRING_CURVE = "spring "
"""Begins the name of a curve that is a joint's spring."""


@runtime_checkable
class KeepsCurves(Protocol):
    """Optional power: training and validation loss per step, or identified springs.

    Attributes:
        curves_: name of each training -> (n_points, 3) array of step, training loss and validation
            loss (NaN: none), in the network's own units. "spring " and a joint's name -> torque on
            a joint that nothing loads before [N m or N], its turn [rad or m] and the turn's
            standard deviation.
    """

    curves_: Mapping[str, FloatArray]


@runtime_checkable
class ChecksParams(Protocol):
    """Optional power: refuse options that do not fit together before anything is computed."""

    def check_params(self) -> None:
        """Raise ConfigError, naming the option, its value and what is valid."""


@runtime_checkable
class ChecksRobot(Protocol):
    """Optional power: refuse a robot that the options cannot serve, before anything is computed."""

    def check_robot(self, robot: Robot) -> None:
        """Raise ConfigError, naming the option, its value and what is valid."""


@runtime_checkable
class ChoosesEpoch(Protocol):
    """Optional power of a model with `uses_validation`: say whether its options use the rows."""

    def chooses_epoch(self) -> bool:
        """Return False when the last epoch is kept; the rows then are training rows."""


def chooses_epoch(model: StiffnessModel) -> bool:
    """Say whether a model that is given validation rows chooses its epoch by them."""
    return model.chooses_epoch() if isinstance(model, ChoosesEpoch) else True


@runtime_checkable
class ChoosesOptions(Protocol):
    """Optional power: choose options in the fit; `best_params_`: option -> chosen value."""

    best_params_: Mapping[str, Any]


@runtime_checkable
class PredictsInterval(Protocol):
    """Optional power: say how sure a prediction is. Others get split-conformal intervals."""

    def predict_interval(self, q: FloatArray, wrench: FloatArray, coverage: float) -> Interval:
        """Return where each deflection lies with probability `coverage` (0..1), axis by axis."""


@runtime_checkable
class PredictsAtTcp(Protocol):
    """Optional power: predict the robot's own TCP, where `predict` is of another measured point.

    Tool paths are corrected for the TCP, which the commands move.
    """

    def predict_at_tcp(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] of the TCP under wrenches that act there."""


def tcp_deflection(model: StiffnessModel) -> Deflection:
    """Return the function that predicts the deflection of the robot's own TCP."""
    return model.predict_at_tcp if isinstance(model, PredictsAtTcp) else model.predict


def interval_at_tcp(
    model: StiffnessModel, interval: Interval, q: FloatArray, wrench: FloatArray
) -> Interval:
    """Return an interval about a model's `predict`, moved to its prediction of the robot's TCP.

    Its width stays: how wrong the tool's rotation is over the distance is not in it.
    """
    if not isinstance(model, PredictsAtTcp):
        return interval
    shift = model.predict_at_tcp(q, wrench) - model.predict(q, wrench)
    return Interval(interval.lower + shift, interval.upper + shift, interval.coverage)


@runtime_checkable
class PredictsCovariance(Protocol):
    """Optional power: say how unknown deflections go together, to choose the next poses by.

    A measurement lowers the variance elsewhere by what it has in common with it.
    """

    def covariance(
        self, q: FloatArray, wrench: FloatArray, other_q: FloatArray, other_wrench: FloatArray
    ) -> FloatArray:
        """Return (3, n, m) the covariance [m²] at n and m poses and loads, axis by axis.

        That of the deflections without a measurement's noise, given the training samples.
        """

    def noise_variance(self) -> FloatArray:
        """Return (3,) the variance [m²] of a measured deflection's own error, axis by axis."""


@runtime_checkable
class StatesRegime(Protocol):
    """Optional power: say what a row must say of how the training labels were used.

    Transfer without target labels and transfer with them cannot be compared.
    """

    @property
    def regime(self) -> str:
        """Words that follow from the options and from `use_source` alone; "" for nothing."""


def regime_of(model: StiffnessModel) -> str:
    """Return what a model says of how it uses training labels; "" for nothing."""
    return model.regime if isinstance(model, StatesRegime) else ""


@runtime_checkable
class StatesSource(Protocol):
    """Optional power: say what the simulated source domain of a model is."""

    @property
    def source_words(self) -> str:
        """Words that follow from the options and from `use_source` alone."""


@runtime_checkable
class LearnsFromSource(Protocol):
    """Optional power: build the simulated source domain from another robot's samples.

    A copy by `sklearn.base.clone` must keep the source (write `__sklearn_clone__`): intervals come
    from copies.
    """

    def use_source(self, source: BenchmarkData | None) -> None:
        """Store what the next `fit` makes its source domain of; None: the training samples.

        The other robot or specimen has as many joints of the same types; all of its samples may be
        learned from.
        """


@runtime_checkable
class KnowsWhatIsMissing(Protocol):
    """Optional power: say why a model with its options cannot be used on this machine."""

    def missing(self) -> str:
        """Return what is missing (a package, a file of weights); "" for nothing."""


@runtime_checkable
class SavesItself(Protocol):
    """Optional power: be written to a file that `stiff_models.load` reads."""

    def save(self, path: Path) -> None:
        """Write the fitted model to `path`."""


@runtime_checkable
class StiffnessDataset(Protocol):
    """Makes or reads one data set; constructor arguments are its options."""

    def load(self) -> BenchmarkData:
        """Return samples and robot; the same options give the same numbers."""


@runtime_checkable
class EvaluationProtocol(Protocol):
    """Says how a data set is divided and which part may choose an epoch.

    Attributes:
        selects_on_test: the validation rows are the test rows, so results are optimistic.
        pooled: the metrics are computed once over the predictions of all splits (as in
            leave-one-out), not once a split.
    """

    selects_on_test: bool
    pooled: bool

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return the splits; the same arguments give the same splits.

        Args:
            samples: to be divided; a fair division does not look at their deflections.
            n_splits: how many draws, in each condition; None: the protocol's own number.
            seed: of the draws.
        """


@runtime_checkable
class ReportsTrainingRows(Protocol):
    """Optional power of a protocol: report training rows beside the test rows, and say so.

    Attributes:
        reports_training: whether it does so with its options; its results are then marked
            everywhere, and never ranked or compared.
    """

    reports_training: bool


def reports_training(protocol: EvaluationProtocol) -> bool:
    """Say whether a protocol declares that it reports training rows."""
    return isinstance(protocol, ReportsTrainingRows) and bool(protocol.reports_training)


@runtime_checkable
class DividesByRobot(Protocol):
    """Optional power of a protocol: be told which robot was measured, before it divides."""

    def use_robot(self, robot: Robot) -> None:
        """Remember the robot."""


@runtime_checkable
class CorrectsPaths(Protocol):
    """Optional power of a protocol: score tool paths that models correct, not their predictions.

    The data set's robot moves along them under load (`BenchmarkData.under_load`).
    """

    def with_paths(self, data: BenchmarkData) -> BenchmarkData:
        """Return the data with the points of the paths behind the samples, in path order.

        Their group is `PATH_GROUP`, their pose_id the path's name, their deflection the error of
        the path without correction. ConfigError: the robot cannot be asked, or has no such path.
        """

    def commanded(
        self, predict: Deflection, robot: Robot, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return (n, n_joints) commands [rad] for path points, corrected with predictions.

        `q` (n, n_joints) are their commands without correction, `wrench` (n, 6) their loads. A new
        object is asked, in the process of the model: there are no deflections.
        """

    def removed(self, q: FloatArray, data: BenchmarkData, rows: IntArray) -> FloatArray:
        """Return (n, 3) how much less the path error [m] is with commands than without."""


@runtime_checkable
class TunesModels(Protocol):
    """Optional power of a protocol: have a model's options chosen on the training side.

    Attributes:
        grid: name of a grid of each model's catalogue line, or a path that ends in .toml.
    """

    grid: str

    def tuned(self, model: StiffnessModel, grid: Grid) -> StiffnessModel:
        """Return what is fitted in an unfitted model's place and chooses from the grid in its fit.

        Options that are not in the grid stay as they are; it is empty where a model has none.
        """


@runtime_checkable
class NamesSources(Protocol):
    """Optional power of a protocol: have models learn from another robot's or specimen's data."""

    def source_datasets(self) -> Sequence[str]:
        """Return every word that its splits have as `source`, such as kr10-twin@specimen=9."""
