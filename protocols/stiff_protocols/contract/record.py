"""Stored records: the identity of a fit, its result, and the origin of a run."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Literal, NamedTuple

from stiff_protocols.contract.arrays import FloatArray
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.types import Prediction


class Cost(NamedTuple):
    """Wall times and memory; they differ between runs and do not affect a result's identity.

    Attributes:
        fit_s: time of the fit, s. A pre-training from the cache costs nothing.
        predict_s: time to predict the test rows together, s.
        latency_s: time to predict a single row, median of several, s.
        throughput_per_s: rows predicted per second in a large call.
        memory_bytes: increase of the process's resident memory by the fit and the prediction of
            the test rows; None if the system does not report it.
    """

    fit_s: float
    predict_s: float
    latency_s: float
    throughput_per_s: float
    memory_bytes: int | None


INTERVAL_VERSION = 3
"""Version of the intervals' method. Raise it with each change of their numbers, so that fits with
intervals are computed again. tests/protocols/scoring/test_golden_scoring.py fails on a change."""


PATH_ERROR = "error left on tool paths [mm]"
"""Diagnostic: mean 3-D error of the paths that a fit corrects in addition to its test."""
TEACHER_EPOCHS = "epochs of fine-tuning a teacher"
"""Diagnostic: number of epochs that changed a teacher's prediction; 0: it is the teacher's."""
READING_OPTION = "read_on"
"""Option of protocols for the reported rows; it does not change the fit or its seed."""


@dataclass(frozen=True)
class Fit:
    """A model on a split: the unit that is computed, stored and compared.

    Attributes:
        model, model_params: key and set options.
        dataset, dataset_params, data_sha256: key, options, and hash of the numbers.
        protocol, protocol_params: key and options.
        split_index, split_sha256: number of the split, and the hash of its rows.
        seed: the run's seed.
        coverage: nominal coverage of the intervals; None: no intervals.
        condition: condition of its protocol; "" if there is only one.
        rows_sha256: hash of only training, validation and test rows, if `split_sha256` also covers
            sensor errors or more reported rows; else "".
        source_sha256: hash of another robot's data for the source domain; else "".
        model_version: `ModelInfo.version` of a built-in model, with the version of its library; for
            a plugin's model the hash of its files; "" if unknown.
        interval_version: the `INTERVAL_VERSION` of a fit with intervals; else 0.
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
        """Name of the fit: a hash that does not depend on the order of options."""
        identity = self._identity()
        for name in _OPTIONAL:  # empty fields do not change the key
            if not identity[name]:
                del identity[name]
        return _hash(identity)[:24]

    @property
    def model_seed(self) -> int:
        """Seed of the model, only from data, protocol, split and the run's seed.

        Random numbers are common: two models on a split differ only in the models. Variants with
        the same pre-training can share it. Two conditions, or two readings (`READING_OPTION`),
        with the same rows give the same fit.
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
    """Facts that must always be shown with a fit's numbers.

    Attributes:
        model, dataset, protocol: keys with the options that differ from their defaults, e.g.
            "ft-mlp@freeze=full".
        kind: kind of the data, e.g. "simulated".
        regime: use of training labels by the model; "" for the usual use.
        source: description of the model's simulated source domain; "" if it has none.
        picked_on_test: the model chose its epoch on the test part.
        selects_on_test: the protocol allows models to do so.
        reports_training: the metrics also cover training rows.
        measured_sha256: hash of the data set without points of tool paths, if the protocol added
            them; the metrics then are their errors. Else "".
        pooled: the protocol's metrics are computed over the predictions of all splits together.
        caveats: caveats of the data.
        published: name of the published table to show below; "" for none.
        warning: warning of the protocol; "" for none.
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
class FitResult(BriefFields):
    """Result of a computed fit; metrics are computed from it when it is read.

    Attributes:
        fit: identity of the result.
        presentation: facts to show with its numbers.
        run_id: run that computed it.
        status: "ok", "failed", or "skipped": the model cannot be used on this machine.
        prediction: predicted and measured reported rows; None unless "ok".
        cost: time and memory, without the cost of split-conformal intervals; None unless "ok".
        diagnostics: numbers that the model reported, by name and unit, and `PATH_ERROR` if tool
            paths were corrected.
        warnings: warnings during fit and prediction.
        failure: why it failed or was skipped; "" otherwise.
        cause: short cause of a failure, used to count it: "ValueError", "SIGKILL", "timed out".
        log: last printed lines of a failed fit's process.
        calibration_samples: number of samples for split-conformal intervals; 0 if the model has its
            own intervals, or none.
        n_train: rows of the training side, with validation rows; 0 unless "ok".
        n_labels: rows of the training side that the model was fitted to, without validation rows; 0
            if unknown.
        n_poses: measured poses of the training side; 0 if unknown.
        chosen: option -> value, as text, that the fit chose itself; empty if none.
        n_splits: number of splits of its run in its condition; 0 if unknown.
        curves: name of each training -> (n_points, 3) of step, training loss and validation loss
            (NaN: none), in the network's own units; empty without such a training.
    """

    fit: Fit
    presentation: Presentation
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
        """Status and reason of a fit without numbers."""
        return f"{self.status}: {self.failure}"


@dataclass(frozen=True, repr=False)
class RunManifest(BriefFields):
    """Provenance of a run: everything except the fits that can change a result.

    Attributes:
        run_id: name of the run.
        command: the command line.
        started: UTC, ISO 8601.
        status: "running", "finished" or "interrupted".
        environment: versions, processor, threads, commit and whether the tree was dirty.
        cells: keys of the requested fits.
        wall_s: total wall time, s; 0 while running.
        peak_memory_bytes: peak memory of the process; 0 while running.
        machines: environments of other machines in the run, by their addresses.
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
