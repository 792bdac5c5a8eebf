"""The base class of protocols: `splits`, and what a protocol may do besides."""

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
"""(what the user set, model, option, text) -> value of the option's type; ConfigError: neither."""


class EvaluationProtocol:
    """Divides a data set, and says what fitted models are asked and scored on.

    Only `splits` is needed. The other methods have a default: override what the protocol changes.
    A class need not inherit: `completed` adds the defaults to any object with `splits`.

    Attributes:
        selects_on_test: the validation rows are the test rows, so results are optimistic.
        reports_training: training rows are reported with the test rows (`Split.also_reported`).
            Such results are marked everywhere, and neither ranked nor compared.
        pooled: the metrics are computed once over the predictions of all splits (as in
            leave-one-out), not once per split.
        caveat: what the errors are if they are not errors of predicted deflections; printed under
            every table.
    """

    selects_on_test: bool = False
    reports_training: bool = False
    pooled: bool = False
    caveat: str = ""

    def splits(self, samples: Samples, *, n_splits: int | None, seed: int) -> Sequence[Split]:
        """Return the splits; the same arguments give the same splits.

        Args:
            samples: to be divided; a fair division does not look at their deflections.
            n_splits: how many draws, in each condition; None: the protocol's own number.
            seed: of the draws.
        """
        raise NotImplementedError

    def prepared(self, data: BenchmarkData) -> BenchmarkData:
        """Return the data that is divided; called once before `splits`.

        A protocol may remember the robot here, or add samples after those of the data set. Its
        results are then of another data set: `Presentation.measured_sha256` links the two.
        ConfigError: the data do not serve the protocol.
        """
        return data

    def source_datasets(self) -> Sequence[str]:
        """Return every word that its splits have as `source`, such as kr10-twin@specimen=9."""
        return ()

    def grids(self, models: Sequence[ModelInfo], parse: ParseOption) -> Mapping[str, Grid] | None:
        """Return the candidates of options by model key; None: options stay as they are set.

        ConfigError: there are no such candidates.
        """
        return None

    def tuned(self, model: Any, grid: Grid) -> Any:
        """Return what is fitted in place of an unfitted model, and chooses from `grid` in its fit.

        Called if `grids` returns candidates; `grid` is empty for a model without any, and lacks
        the options that the user set.
        """
        return model

    def commanded(
        self, predict: Deflection, robot: Robot, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return (n, n_joints) joint positions [rad or m] at which deflections are predicted.

        They are the reported rows' own `q` (n, n_joints), unless the protocol corrects commands
        with predictions; `wrench` (n, 6) are their loads. A new object is asked, in the process
        of the model: it has no deflections.
        """
        return q

    def scored(
        self, predicted: FloatArray, commands: FloatArray, data: BenchmarkData, rows: IntArray
    ) -> FloatArray:
        """Return the (n, 3) values [m] that are compared with the deflections of the rows.

        `predicted` (n, 3) m are a model's predictions at the (n, n_joints) commands. Asked in the
        run's own process.
        """
        return predicted

    def path_commands(
        self, predict: Deflection, robot: Robot, q: FloatArray, wrench: FloatArray
    ) -> FloatArray:
        """Return (n, n_joints) commands [rad or m] with which `BenchmarkData.paths` are driven.

        They put the points at (n, n_joints) `q` under (n, 6) `wrench` back on their paths. Asked
        like `commanded`, of data whose protocol added paths to them.
        """
        return q

    def path_errors(self, commands: FloatArray, data: BenchmarkData) -> FloatArray:
        """Return the (n, 3) errors [m] that the commands leave on `data.paths`."""
        raise NotImplementedError


_MEMBERS = [name for name in vars(EvaluationProtocol) if not name.startswith("_")]


class _Completed(EvaluationProtocol):
    """An object with `splits`, with the defaults for what it has not."""

    def __init__(self, protocol: object) -> None:
        own = {name: getattr(protocol, name) for name in _MEMBERS if hasattr(protocol, name)}
        self.__dict__.update(own)


def completed(protocol: object) -> EvaluationProtocol:
    """Return a protocol with all methods of the base class, for any object with `splits`."""
    return protocol if isinstance(protocol, EvaluationProtocol) else _Completed(protocol)
