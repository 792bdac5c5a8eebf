"""Folders of results whose errors a test chooses."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from helpers.made_samples import samples_with
from stiff_bench.results.leaderboard import merge_training_seeds
from stiff_bench.results.load import StoredResults
from stiff_bench.results.scored_task import sort_key
from stiff_bench.results.scores import Scores
from stiff_bench.store.database import FILE, ResultStore
from stiff_bench.store.names import Variant
from stiff_datasets.robots.shipped_robots import shipped_robot
from stiff_protocols.contract.record import Fit, FitResult, Presentation, RunManifest
from stiff_protocols.contract.types import BenchmarkData, IntArray, Interval, Prediction

N_POSES, N_TEST = 12, 4
TWINS = tuple(f"twin@specimen={number}" for number in range(5))
VJM_MM = (0.2, 0.21, 0.19)
"""Errors of the VJM on the splits of `MadeResults.add_robot`."""
GOOD = (0.30, 0.35, 0.32, 0.40, 0.28, 0.33, 0.45)
FAIR = (0.70, 0.80, 0.75, 0.66, 0.90, 0.72, 0.40)
"""Error over the VJM's by robot; `FAIR` has the smaller error on the last robot."""
ROBOT = shipped_robot("kr10_r1100_2", tcp=(0.06, 0.0, 0.08))


def made_data(number: int = 0, n_poses: int = N_POSES) -> BenchmarkData:
    """Return poses of a KR10 with one load each, in two groups of equal size."""
    rng = np.random.default_rng(number)
    samples = samples_with(
        q=rng.uniform(-1.5, 1.5, (n_poses, 6)),
        wrench=np.pad(rng.uniform(-100.0, 100.0, (n_poses, 3)), ((0, 0), (0, 3))),
        deflection=rng.normal(scale=1e-3, size=(n_poses, 3)),
        pose_id=np.array([f"P{pose:02}" for pose in range(n_poses)]),
        group=np.repeat(["near", "far"], n_poses // 2),
    )
    return BenchmarkData(samples, ROBOT)


class MadeResults:
    """Writes cells; each split tests four of the twelve poses, or the given rows."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._store = ResultStore(folder)

    def add(
        self,
        model: str | Variant,
        errors_mm: Sequence[ArrayLike] = (),
        dataset: str = "twin",
        protocol: str = "holdout",
        *,
        data: BenchmarkData | None = None,
        tests: Sequence[IntArray] | None = None,
        rows: Sequence[int] | None = None,
        failed: Sequence[int] = (),
        version: int = 0,
        run_id: str = "run-1",
        splits_named: str = "",
        condition: str = "",
        coverage: float | None = None,
        options: Mapping[str, object] | None = None,
        source: str = "",
        n_train: int | None = None,
        n_splits: int = 0,
        seed: int = 0,
        model_version: str = "",
        interval_version: int = 0,
        **fields,
    ) -> list[str]:
        """Write a cell per split and return the cells' keys; a variant's options keep their types.

        Errors are along z unless they are (n, 3). With a coverage there are intervals, as wide
        as the errors and 2 mm more. `rows` are tested in every split, `tests[i]` in split i.
        """
        data = data or made_data(sum(dataset.encode()) + version)
        self._store.write_data(data)
        of_model = model if isinstance(model, Variant) else Variant.of_word(model)
        of_data = Variant.of_word(dataset)
        about = {"kind": "simulated"} | fields
        presentation = Presentation(of_model.name, dataset, protocol, **about)
        keys = []
        for index in range(max(len(errors_mm), *(split + 1 for split in failed), 0)):
            cell = Fit(
                model=of_model.key,
                model_params={"name": of_model.name} | of_model.options | (options or {}),
                dataset=of_data.key,
                dataset_params={"specimen": "0"} | of_data.options,
                data_sha256=data.sha256,
                protocol=protocol,
                protocol_params={},
                split_index=index,
                split_sha256=f"split-{splits_named}{index}",
                model_version=model_version,
                interval_version=interval_version,
                seed=seed,
                condition=condition,
                coverage=coverage,
                source_sha256=source,
            )
            result = FitResult(cell, presentation, run_id, "failed", failure="it broke")
            if index not in failed:
                tested = (np.arange(N_TEST) + index * N_TEST) % N_POSES if rows is None else rows
                tested = np.asarray(tested if tests is None else tests[index])
                done = self._done(cell, presentation, run_id, data, tested, errors_mm[index])
                result = replace(done, n_train=n_train or len(data.samples) - len(tested))
            self._store.write_fits([replace(result, n_splits=n_splits)])
            keys.append(cell.key)
        return keys

    def add_each(self, errors_mm: Mapping[str, Sequence[float]], *where: str, **how) -> None:
        """Write the cells of several models: model -> its errors."""
        for model, errors in errors_mm.items():
            self.add(model, errors, *where, **how)

    def add_robot(
        self, number: int, ratios: Mapping[str, float], *, words: str = "", **how
    ) -> None:
        """Write three splits of the VJM, and of models with these ratios to it, on a robot."""
        data = made_data(number)
        data = replace(data, robot=replace(data.robot, name=f"robot-{number}"))
        for model, ratio in {"vjm": 1.0, **ratios}.items():
            errors = [ratio * error for error in VJM_MM]
            self.add(model, errors, f"arm-{number}{words}", data=data, **how)

    def add_robots(self, **how) -> None:
        """Write results of the models `good` and `fair` on seven robots."""
        for number, (good, fair) in enumerate(zip(GOOD, FAIR, strict=True)):
            self.add_robot(number, {"good": good, "fair": fair}, **how)

    def scores(self, metric: str = "norm", protocol: str = "", **chosen) -> Scores:
        """Return the scores of all protocols, or of one."""
        stored = merge_training_seeds(StoredResults.read(self.folder))
        tasks = [task for task in stored.tasks if protocol in ("", task.name.protocol)]
        return Scores.of(stored, sort_key(metric), tasks, **chosen)

    def _done(self, cell, presentation, run_id, data, rows, error_mm) -> FitResult:
        measured = data.samples.deflection[rows]
        error = np.zeros((len(rows), 3))
        error[:, slice(3) if np.ndim(error_mm) == 2 else 2] = np.asarray(error_mm) * 1e-3
        prediction = Prediction(rows, measured + error, measured, reference=measured + 1e-3)
        if cell.coverage is not None:
            reach = np.abs(error) + 1e-3
            interval = Interval(measured - reach, measured + reach, cell.coverage)
            prediction = replace(prediction, interval=interval)
        return FitResult(cell, presentation, run_id, "ok", prediction)

    def add_run(self, run_id: str, cells: Sequence[str]) -> None:
        """Write the manifest of a run of these cells."""
        environment = {"stiffbench": "9.9", "commit": "0123456789abcdef", "dirty": "false"}
        self._store.write_manifest(
            RunManifest(run_id, "bench run", "now", "finished", environment, tuple(cells))
        )


def change(folder: Path, statement: str, *values: object) -> None:
    """Change a folder's file without the store: damage, or an older state."""
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        db.execute(statement, values)


def forget(folder: Path, *keys: str) -> None:
    """Delete cells of a folder, as if they had never been computed."""
    for key in keys:
        change(folder, "DELETE FROM cell WHERE key = ?", key)


def damage(folder: Path, *keys: str) -> None:
    """Change stored rows so that their checksums fail."""
    for key in keys:
        change(folder, "UPDATE cell SET run_id = run_id || '!' WHERE key = ?", key)
