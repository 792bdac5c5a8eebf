"""A large folder of results: real data, protocols and splits, made-up predictions, no fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from helpers.run_requests import planned
from stiff_bench.plan.cells import CellTask, cell_tasks
from stiff_bench.store.database import ResultStore
from stiff_protocols.contract.record import CellResult, Cost, RunManifest
from stiff_protocols.contract.types import Prediction
from stiff_protocols.scoring.metrics import METRICS

MODELS = (
    *("zero", "mean", "knn", "knn@neighbours=1", "vjm", "vjm@congruence=true"),
    *("vjm-multisegment", "vjm-full", "gp", "vjm-gp"),
)
DATASETS = tuple(f"kr10-twin@specimen={number}" for number in range(6))
PROTOCOLS = (*("holdout", "kfold", "sample-efficiency", "space-transfer", "load-extrapolation"),)
RUN_ID = "20261121T120000Z-made00"


def made_board(folder: Path, *, n_splits: int = 5) -> int:
    """Write a finished run of ten models and return how many values it has.

    `n_splits` is of every protocol in each of its conditions.
    """
    protocols = [f"kfold@folds={n_splits}" if key == "kfold" else key for key in PROTOCOLS]
    plan = planned(models=MODELS, datasets=DATASETS, protocols=tuple(protocols), splits=n_splits)
    tasks = list(cell_tasks(plan))
    store = ResultStore(folder)
    for data in {task.cell.data_sha256: task.data for task in tasks}.values():
        store.write_data(data)
    results = [_made_up(task, np.random.default_rng(number)) for number, task in enumerate(tasks)]
    store.write_cells(results)
    keys = tuple(task.cell.key for task in tasks)
    environment = {"stiffbench": "9.9", "commit": "", "dirty": ""}
    store.write_manifest(RunManifest(RUN_ID, "bench run", "now", "finished", environment, keys))
    return sum(len(m.of_result(result)) for result in results for m in METRICS.values())


def _made_up(task: CellTask, rng: np.random.Generator) -> CellResult:
    """Return a result whose errors are larger the later the model stands in `MODELS`."""
    measured = task.data.samples.deflection[task.split.test]
    scale = 1e-4 * (1 + MODELS.index(task.shown.model.replace("=True", "=true")))
    errors = rng.normal(scale=scale, size=(2, *measured.shape))
    prediction = Prediction(
        task.split.test, measured + errors[0], measured, reference=measured + errors[1]
    )
    cost = Cost(*(rng.uniform(1e-4, 1e-3, 4).tolist()), 2**20)
    return CellResult(
        *(task.cell, task.shown, RUN_ID, "ok", prediction, cost),
        n_train=len(task.split.train) + len(task.split.validation),
        n_splits=task.n_splits,
    )
