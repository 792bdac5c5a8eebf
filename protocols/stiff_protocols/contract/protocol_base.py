"""The base class of protocols: `splits`, and optional methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from stiff_protocols.contract.plugin import Grid, ModelInfo
from stiff_protocols.contract.types import (
    BenchmarkData,
    Deflection,
    FloatArray,
    IntArray,
    Robot,
    Samples,
    Split,
)

ParseOption = Callable[[str, ModelInfo, str, str], Any]
"""(set options, model, option, text) -> value of the option's type; ConfigError if not valid."""


class EvaluationProtocol:
    """Divides a data set, and defines the predictions and scores of fitted models.

    Only `splits` is required. The other methods have a default; override those that the protocol
    changes. A class need not inherit: `completed` adds the defaults to any object with `splits`.

    Attributes:
        selects_on_test: the validation rows are the test rows, so results are optimistic.
        reports_training: training rows are reported with the test rows (`Split.also_reported`).
            Such results are marked everywhere, and neither ranked nor compared.
        pooled: the metrics are computed once over the predictions of all splits (as in
            leave-one-out), not once per split.
        caveat: meaning of the errors if they are not errors of predicted deflections; printed under
            every table.
    """

    selects_on_test: bool = False
    reports_training: bool = False
    pooled: bool = False
    caveat: str = ""

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return the splits; the same arguments give the same splits.

        Args:
            samples: samples to divide; a fair division does not use their deflections.
            n_splits: number of draws in each condition; None: the protocol's own number.
            seed: seed of the draws.
        """
        raise NotImplementedError

    def prepared(self, data: BenchmarkData) -> BenchmarkData:
        """Return the data to divide; called once before `splits`.

        A protocol may store the robot here, or append samples to the data set. Its results then
        belong to another data set: `Presentation.measured_sha256` links the two. ConfigError: the
        protocol cannot use the data.
        """
        return data

    def source_datasets(self) -> Sequence[str]:
        """Return every `source` of its splits, such as kr10-twin@specimen=9."""
        return ()

    def grids(self, models: Sequence[ModelInfo], parse: ParseOption) -> Mapping[str, Grid] | None:
        """Return the candidates of options by model key; None: options are not tuned.

        ConfigError: the candidates do not exist.
        """
        return None

    def tuned(self, model: Any, grid: Grid) -> Any:
        """Return a model that chooses from `grid` in its fit, instead of an unfitted model.

        Called if `grids` returns candidates. `grid` is empty for a model without candidates, and
        does not contain options that the user set.
        """
        return model

    def commanded(
        self, predict: Deflection, robot: Robot, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return (n, n_joints) joint positions [rad or m] at which deflections are predicted.

        They are the reported rows' `q` (n, n_joints), unless the protocol corrects commands with
        predictions; `wrench` (n, 6) are their loads. It is called on a new object, without
        deflections, in the model's process.
        """
        return q

    def scored(
        self, predicted: FloatArray, commands: FloatArray, data: BenchmarkData, rows: IntArray
    ) -> FloatArray:
        """Return the (n, 3) values [m] that are compared with the deflections of the rows.

        `predicted` (n, 3) m are a model's predictions at the (n, n_joints) commands. It is called
        in the run's process.
        """
        return predicted

    def path_commands(
        self, predict: Deflection, robot: Robot, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return the (n, n_joints) commands [rad or m] that follow `BenchmarkData.paths`.

        They move the points at (n, n_joints) `q` under (n, 6) `wrench` back to their paths. It is
        called like `commanded`, for data with paths from the protocol.
        """
        return q

    def path_errors(self, commands: FloatArray, data: BenchmarkData) -> FloatArray:
        """Return the (n, 3) remaining errors [m] of the commands on `data.paths`."""
        raise NotImplementedError


_MEMBERS = [name for name in vars(EvaluationProtocol) if not name.startswith("_")]


class _Completed(EvaluationProtocol):
    """An object with `splits`, completed with the defaults."""

    def __init__(self, protocol: object) -> None:
        members = {name: getattr(protocol, name) for name in _MEMBERS if hasattr(protocol, name)}
        self.__dict__.update(members)


def completed(protocol: object) -> EvaluationProtocol:
    """Return a protocol with all methods of the base class, for any object with `splits`."""
    return protocol if isinstance(protocol, EvaluationProtocol) else _Completed(protocol)
