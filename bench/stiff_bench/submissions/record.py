"""A fit as an open record: identity, hashes, metrics, predictions, cost and environment.

Lengths are in mm, as in every file that others read; the schema is in `results/schema/`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from stiff_bench.tables.units import MM
from stiff_protocols.contract.record import PATH_ERROR, CellResult, Cost
from stiff_protocols.contract.types import FloatArray, Prediction
from stiff_protocols.scoring.metrics import METRICS

SCHEMA_FILE = Path("results/schema/record.json")
"""Place of the committed schema in the repository."""
FACTS = (
    *("stiffbench", "commit", "python", "platform", "processor", "gpu", "threads"),
    *("numpy", "scipy", "scikit-learn", "torch"),
)
"""Facts of a run's environment that a record repeats."""
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
SourceSha256 = Annotated[str, Field(pattern="^([0-9a-f]{64})?$")]
Vector = tuple[float, float, float]
Options = Mapping[str, str | int | float | bool | list[str] | None]


class Costs(BaseModel):
    """Time and memory of a fit.

    Attributes:
        fit_s: wall time of the fit, s.
        predict_s: wall time of predicting the test rows together, s.
        latency_s: wall time of predicting one row, s.
        throughput_per_s: rows predicted per second in one large call.
        memory_bytes: memory that fit and prediction added to the process; null: unknown.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    fit_s: float
    predict_s: float
    latency_s: float
    throughput_per_s: float
    memory_bytes: int | None


class Record(BaseModel):
    """One model on one data set and split.

    Attributes:
        format: version of this schema.
        key: hash of everything that identifies the fit.
        model: name on the command line, with the options that differ from their defaults.
        model_key, model_options, model_version: catalogue key, all options, and the version: a
            number of a built-in model, a hash of the files of a plugin.
        dataset: name on the command line.
        dataset_key, dataset_options, kind: catalogue key, all options, "simulated" or "measured".
        data_sha256: hash of the samples and the robot.
        protocol: name on the command line.
        protocol_key, protocol_options, condition: catalogue key, all options, and the condition,
            such as "n = 20".
        split_index, split_sha256, n_splits: number and hash of the split, and number of splits.
        seed: of splits and models.
        source_sha256: hash of the other robot's data that the model may learn from; "": none.
        status: "ok", "failed", or "skipped": the model could not be used on that machine.
        failure: reason of a fit that is not ok.
        n_train, n_labels, n_poses: training samples, samples that the fit used, training poses.
        metrics: errors of the predictions by name, axis and unit, such as "mae_x_mm".
        path_error_mm: mean 3-D error left on tool paths that the model corrected; null: none were.
        diagnostics: numbers that the fit reports, such as stiffnesses; null: not finite.
        cost: time and memory; null: the fit is not ok.
        rows: numbers of the test rows in the data set.
        predicted_mm: predicted deflection of each row, base frame.
        measured_mm: deflection of the data set at each row, base frame.
        coverage: nominal coverage of the intervals; null: none.
        lower_mm, upper_mm: bounds of the intervals of each row; null: none.
        run_id, environment: the run that computed it, its versions and its machine.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    format: Literal[1] = 1
    key: Annotated[str, Field(pattern="^[0-9a-f]{24}$")]
    model: str
    model_key: str
    model_options: Options
    model_version: str
    dataset: str
    dataset_key: str
    dataset_options: Options
    kind: str
    data_sha256: Sha256
    protocol: str
    protocol_key: str
    protocol_options: Options
    condition: str
    split_index: Annotated[int, Field(ge=0)]
    split_sha256: Sha256
    n_splits: Annotated[int, Field(ge=0)]
    seed: Annotated[int, Field(ge=0)]
    source_sha256: SourceSha256
    status: Literal["ok", "failed", "skipped"]
    failure: str
    n_train: Annotated[int, Field(ge=0)]
    n_labels: Annotated[int, Field(ge=0)]
    n_poses: Annotated[int, Field(ge=0)]
    metrics: Mapping[str, float]
    path_error_mm: float | None
    diagnostics: Mapping[str, float | None]
    cost: Costs | None
    rows: list[Annotated[int, Field(ge=0)]]
    predicted_mm: list[Vector]
    measured_mm: list[Vector]
    coverage: float | None
    lower_mm: list[Vector] | None
    upper_mm: list[Vector] | None
    run_id: str
    environment: Mapping[str, str]

    @classmethod
    def of(cls, result: CellResult, environment: Mapping[str, str]) -> Record:
        """Return the record of a result.

        Args:
            result: a fit, failed ones too.
            environment: of the run that computed it.
        """
        cell, names, prediction = result.cell, result.presentation, result.prediction
        interval = None if prediction is None else prediction.interval
        diagnostics = {
            name: value if math.isfinite(value) else None
            for name, value in result.diagnostics.items()
            if name != PATH_ERROR
        }
        return cls(
            key=cell.key,
            model=names.model,
            model_key=cell.model,
            model_options=cell.model_params,
            model_version=cell.model_version,
            dataset=names.dataset,
            dataset_key=cell.dataset,
            dataset_options=cell.dataset_params,
            kind=names.kind,
            data_sha256=cell.data_sha256,
            protocol=names.protocol,
            protocol_key=cell.protocol,
            protocol_options=cell.protocol_params,
            condition=cell.condition,
            split_index=cell.split_index,
            split_sha256=cell.split_sha256,
            n_splits=result.n_splits,
            seed=cell.seed,
            source_sha256=cell.source_sha256,
            status=result.status,
            failure=result.failure,
            n_train=result.n_train,
            n_labels=result.n_labels,
            n_poses=result.n_poses,
            metrics={} if prediction is None else record_metrics(prediction),
            path_error_mm=result.diagnostics.get(PATH_ERROR),
            diagnostics=diagnostics,
            cost=None if result.cost is None else Costs(**result.cost._asdict()),
            rows=[] if prediction is None else prediction.rows.tolist(),
            predicted_mm=[] if prediction is None else _in_mm(prediction.predicted),
            measured_mm=[] if prediction is None else _in_mm(prediction.measured),
            coverage=None if interval is None else interval.coverage,
            lower_mm=None if interval is None else _in_mm(interval.lower),
            upper_mm=None if interval is None else _in_mm(interval.upper),
            run_id=result.run_id,
            environment={name: environment[name] for name in FACTS if name in environment},
        )

    def result(self, of_vjm: CellResult) -> CellResult:
        """Return the stored form of a fit that is ok.

        Args:
            of_vjm: the VJM on the same split: it has data, split and reference.
        """
        assert of_vjm.prediction is not None and self.cost is not None
        prediction = replace(of_vjm.prediction, predicted=self.predicted, interval=None)
        diagnostics = {name: nan if v is None else v for name, v in self.diagnostics.items()}
        if self.path_error_mm is not None:
            diagnostics[PATH_ERROR] = self.path_error_mm
        cell = replace(
            of_vjm.cell,
            model=self.model_key,
            model_params=self.model_options,
            model_version=self.model_version,
        )
        return CellResult(
            cell=cell,
            presentation=replace(
                of_vjm.presentation, model=self.model, regime="", picked_on_test=False
            ),
            run_id=self.run_id,
            status="ok",
            prediction=prediction,
            cost=Cost(**self.cost.model_dump()),
            diagnostics=diagnostics,
            n_train=self.n_train,
            n_labels=self.n_labels,
            n_poses=self.n_poses,
            n_splits=self.n_splits,
        )

    @property
    def predicted(self) -> FloatArray:
        """(n, 3) predicted deflection, m, base frame."""
        return np.array(self.predicted_mm, dtype=np.float64).reshape(-1, 3) / MM

    @property
    def measured(self) -> FloatArray:
        """(n, 3) deflection of the data set, m, base frame."""
        return np.array(self.measured_mm, dtype=np.float64).reshape(-1, 3) / MM

    @property
    def place_text(self) -> str:
        """Data set, protocol and split for people."""
        where = ", ".join(filter(None, [self.condition, f"seed {self.seed}"]))
        return f"{self.dataset} under {self.protocol} ({where}, split {self.split_index})"


def _in_mm(lengths: FloatArray) -> list[Any]:
    """Return (n, 3) lengths [m] as lists of numbers in mm."""
    rows: list[Any] = (MM * lengths).tolist()
    return rows


def record_metrics(prediction: Prediction) -> dict[str, float]:
    """Return the metrics of predictions, with axis and unit in their names."""
    values = {}
    for metric in METRICS.values():
        if metric.of_prediction is None:
            continue
        unit, factor = ("mm", MM) if metric.unit == "m" else ("", 1.0)
        for axis, value in metric.values(prediction).items():
            values["_".join(filter(None, [metric.key, axis, unit]))] = factor * value
    return values


def schema_text() -> str:
    """Return the JSON Schema of a record, as the repository holds it."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    schema |= Record.model_json_schema(mode="serialization")
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
