"""What is stored: the identity of a cell, its result, and where a run came from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Literal, NamedTuple

from stiff_protocols.contract.arrays import FloatArray
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.types import Prediction


class Cost(NamedTuple):
    """Wall times and memory; they differ from run to run and are no part of a result's identity.

    Attributes:
        fit_s: of the fit, s. A pre-training that was taken from the cache costs nothing.
        predict_s: of predicting the test rows together, s.
        latency_s: of predicting one row alone, median of several, s.
        throughput_per_s: rows predicted a second in one large call.
        memory_bytes: how far the fit and the prediction of the test rows raised the process's
            resident memory above what it was; None where the system does not tell.
    """

    fit_s: float
    predict_s: float
    latency_s: float
    throughput_per_s: float
    memory_bytes: int | None


INTERVAL_VERSION = 3
"""Of how intervals are made: a change of their numbers raises it, so that cells with intervals are
computed again. tests/protocols/scoring/test_golden_scoring.py notices such a change."""


PATH_ERROR = "error left on tool paths [mm]"
"""Diagnostic: mean 3-D error of the paths that a fit corrects beside its test."""
READING_OPTION = "read_on"
"""Option of protocols that says which rows are reported: the fit and its seed are the same."""


@dataclass(frozen=True)
class Cell:
    """One model on one split: what is computed, stored and compared.

    Attributes:
        model, model_params: key and the options that were set.
        dataset, dataset_params, data_sha256: key, options, and hash of the numbers.
        protocol, protocol_params: key and options.
        split_index, split_sha256: which split, and the hash of its rows.
        seed: the run's seed.
        coverage: nominal coverage of the intervals that are computed too; None: none are.
        condition: which of its protocol's; "" where that has but one.
        rows_sha256: hash of training, validation and test rows alone, where sensor errors or more
            reported rows are in the other; else "".
        source_sha256: of the other robot's data that the source domain comes from; else "".
        model_version: of a built-in model its `ModelInfo.version`, with the version of the library
            that it wraps; of a plugin's the hash of its files; "" where it is not known.
        interval_version: the `INTERVAL_VERSION` of a cell with intervals; else 0.
    """

    model: str
    model_params: Mapping[str, Any]
    dataset: str
    dataset_params: Mapping[str, Any]
    data_sha256: str
    protocol: str
    protocol_params: Mapping[str, Any]
    split_index: int
    split_sha256: str
    seed: int
    coverage: float | None = None
    condition: str = ""
    rows_sha256: str = ""
    source_sha256: str = ""
    model_version: str = ""
    interval_version: int = 0

    @cached_property
    def key(self) -> str:
        """Name of the cell: a hash that does not depend on the order of options."""
        identity = self._identity()
        for name in _OPTIONAL:  # what does not apply leaves the key as it was without it
            if not identity[name]:
                del identity[name]
        return _hash(identity)[:24]

    @property
    def model_seed(self) -> int:
        """Seed given to the model: from data, protocol, split and the run's seed alone.

        Common random numbers: what differs between two models on one split is the models, and
        variants that begin with the same pre-training can share it. Two conditions, or two
        readings (`READING_OPTION`), with the same rows give the same fit.
        """
        identity = self._identity()
        identity["protocol_params"] = {
            name: value for name, value in self.protocol_params.items() if name != READING_OPTION
        }
        identity["split_sha256"] = self.rows_sha256 or self.split_sha256
        for name in ("model", "model_params", *_OPTIONAL):
            del identity[name]
        return int(_hash(identity)[:8], 16)

    def _identity(self) -> dict[str, Any]:
        return {item.name: getattr(self, item.name) for item in fields(self)}


_OPTIONAL = (
    *("coverage", "condition", "rows_sha256", "source_sha256"),
    *("model_version", "interval_version"),
)


def _hash(identity: Mapping[str, Any]) -> str:
    canonical = json.dumps(identity, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()


@dataclass(frozen=True)
class Presentation:
    """What must stand beside a cell's numbers wherever they are shown.

    Attributes:
        model, dataset, protocol: keys with the options that differ from their defaults, e.g.
            "ft-mlp@freeze=full".
        kind: of the data, e.g. "simulated".
        regime: how the model used training labels; "" for nothing to say.
        source: what the model's simulated source domain is; "" where it has none.
        picked_on_test: the model chose its epoch on the test part.
        selects_on_test: the protocol lets models do so.
        reports_training: training rows are among those that the metrics are computed on.
        measured_sha256: hash of the data set without the points of tool paths that the protocol
            added to it, whose errors the metrics then are of; "" where it added none.
        pooled: the protocol's metrics are computed over the predictions of all splits together.
        caveats: of the data.
        published: name of the published table that belongs beneath; "" for none.
        warning: of the protocol; "" for none.
    """

    model: str
    dataset: str
    protocol: str
    kind: str
    regime: str = ""
    picked_on_test: bool = False
    selects_on_test: bool = False
    pooled: bool = False
    caveats: tuple[str, ...] = ()
    published: str = ""
    warning: str = ""
    source: str = ""
    reports_training: bool = False
    measured_sha256: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class CellResult(BriefFields):
    """Everything known about a computed cell; metrics are computed from it when it is read.

    Attributes:
        cell: what was computed.
        shown: what must stand beside its numbers.
        run_id: the run that computed it.
        status: "ok", "failed", or "skipped": the model cannot be used on this machine.
        prediction: predicted and measured reported rows; None where it is not ok.
        cost: time and memory, without what split-conformal intervals cost; None where it is not ok.
        diagnostics: numbers the model reported, by name and unit, and `PATH_ERROR` where tool paths
            were corrected.
        warnings: what was warned of during fit and prediction.
        failure: why it failed or was skipped; "" otherwise.
        cause: of a failure, in a word or two that count it: "ValueError", "SIGKILL", "timed out".
        log: the last lines that a failed cell's own process printed.
        calibration_samples: that the split-conformal intervals come from; 0 where the model gave
            its own, and where there are none.
        n_train: rows of the training side, with those that choose an epoch; 0 where it is not ok.
        n_labels: rows of the training side that the model was fitted to: without those that choose
            an epoch; 0 where it is not known.
        n_poses: measured poses of the training side; 0 where it is not known.
        chosen: option -> value, as text, that the fit chose itself; empty where it chose none.
        n_splits: how many splits its run was asked for in its condition; 0 where it is not known.
        curves: name of each training -> (n_points, 3) of step, training loss and validation loss
            (NaN: none), in the network's own units; empty where nothing was trained so.
    """

    cell: Cell
    shown: Presentation
    run_id: str
    status: Literal["ok", "failed", "skipped"]
    prediction: Prediction | None = None
    cost: Cost | None = None
    diagnostics: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    failure: str = ""
    cause: str = ""
    log: tuple[str, ...] = ()
    calibration_samples: int = 0
    n_train: int = 0
    n_labels: int = 0
    n_poses: int = 0
    chosen: Mapping[str, str] = field(default_factory=dict)
    n_splits: int = 0
    curves: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def why_none(self) -> str:
        """Status and reason of a cell without numbers."""
        return f"{self.status}: {self.failure}"


@dataclass(frozen=True)
class RunManifest:
    """Provenance of a run: everything beside the cells that can change a result.

    Attributes:
        run_id: name of the run.
        command: the command line.
        started: UTC, ISO 8601.
        status: "running", "finished" or "interrupted".
        environment: versions, processor, threads, commit and whether the tree was dirty.
        cells: keys of the cells it asked for.
        wall_s: seconds in all; 0 while running.
        peak_memory_bytes: of the process; 0 while running.
        machines: environments of the other machines that took part, by their addresses.
    """

    run_id: str
    command: str
    started: str
    status: Literal["running", "finished", "interrupted"]
    environment: Mapping[str, str]
    cells: tuple[str, ...]
    wall_s: float = 0.0
    peak_memory_bytes: int = 0
    machines: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
