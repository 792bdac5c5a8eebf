"""Folders of results with errors of a test's own making."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from made_results import ROBOT
from made_samples import samples_with
from stiff_bench.analysis.collected import Case, collect
from stiff_bench.run.cell import metric_records
from stiff_bench.store.database import ResultStore, read_data
from stiff_bench.store.names import Variant
from stiff_bench.store.samples import StoredData
from stiff_protocols.contract.record import Cell, CellResult, Presentation
from stiff_protocols.contract.types import BenchmarkData, FloatArray, IntArray, Prediction

N_POSES = 40
Errors = Callable[[int, IntArray], FloatArray]
"""Number of the split, rows -> (n, 3) error, m."""


def made_data(seed: int = 0) -> BenchmarkData:
    """Forty poses of a KR10 with one load each; the first half of them is one group."""
    rng = np.random.default_rng(seed)
    samples = samples_with(
        q=rng.uniform(-1.5, 1.5, (N_POSES, 6)),
        wrench=np.column_stack([rng.uniform(-100.0, 100.0, (N_POSES, 3)), np.zeros((N_POSES, 3))]),
        deflection=rng.normal(scale=1e-3, size=(N_POSES, 3)),
        pose_id=np.array([f"p{number:02}" for number in range(N_POSES)]),
        group=np.repeat(["near", "far"], N_POSES // 2),
    )
    return BenchmarkData(samples, ROBOT)


def fifths(n_splits: int) -> list[IntArray]:
    """Test rows of splits that divide the poses like cross-validation."""
    order = np.random.default_rng(1).permutation(N_POSES)
    return [np.sort(order[number::n_splits]) for number in range(n_splits)]


def store_results(
    folder: Path,
    models: dict[str, Errors],
    *,
    tests: Sequence[IntArray] | None = None,
    data: BenchmarkData | None = None,
    dataset: str = "made",
    condition: str = "",
    n_train: int = 32,
    failed: dict[str, Sequence[int]] | None = None,
    own: dict[str, dict[str, object]] | None = None,
    **shown: object,
) -> Path:
    """Store a result of every model on every split.

    `failed` names splits without one; `shown` is what stands beside all numbers, `own` beside
    those of one model.
    """
    data = data or made_data()
    store = ResultStore(folder)
    store.write_data(data)
    for model, errors in models.items():
        for index, rows in enumerate(fifths(5) if tests is None else tests):
            key, *settings = dataset.split("@")
            options = {"specimen": 0} | {
                name: int(value) for name, value in (word.split("=") for word in settings)
            }
            of_model = Variant.of_word(model)
            params = {"name": model, **of_model.options}
            cell = Cell(
                *(of_model.key, params, key, options, data.sha256, "kfold", {}, index),
                *(f"split {index}", 0),
                condition=condition,
            )
            facts = {"kind": "measured", "task": "stiffness"} | shown | (own or {}).get(model, {})
            result = CellResult(cell, Presentation(model, dataset, "kfold", **facts), "run", "ok")
            if index in (failed or {}).get(model, ()):
                store.write_cell(replace(result, status="failed", failure="it broke"))
                continue
            measured = data.samples.deflection[rows]
            prediction = Prediction(rows, measured + errors(index, rows), measured)
            records = metric_records(prediction, None)
            store.write_cell(
                replace(result, records=records, prediction=prediction, n_train=n_train)
            )
    return folder


def case_in(folder: Path) -> tuple[Case, StoredData]:
    """The only case of a folder, and its data."""
    (case,) = collect(folder)
    return case, read_data(folder, case.name.data_sha256)


def spread(mean: float, deviation: float, seed: int = 3) -> Errors:
    """Errors along x of this mean that differ from row to row, but not from split to split."""
    draws = np.random.default_rng(seed).normal(mean, deviation, N_POSES)

    def errors(_: int, rows: IntArray) -> FloatArray:
        return np.column_stack([draws[rows], np.zeros((len(rows), 2))])

    return errors


def steady(*of_splits: float) -> Errors:
    """Errors along x with this mean in each split, m; they grow with the row a little."""

    def errors(index: int, rows: IntArray) -> FloatArray:
        x = of_splits[index] * (1.0 + 0.01 * (rows - rows.mean()) / N_POSES)
        return np.column_stack([x, np.zeros((len(rows), 2))])

    return errors
