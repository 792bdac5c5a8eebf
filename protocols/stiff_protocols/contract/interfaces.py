"""What the engine asks of a data set and a protocol: structural types, no base class."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from stiff_protocols.contract.plugin import Grid
from stiff_protocols.contract.stiffness_model import StiffnessModel
from stiff_protocols.contract.types import (
    BenchmarkData,
    Deflection,
    FloatArray,
    IntArray,
    Robot,
    Samples,
    Split,
)


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
