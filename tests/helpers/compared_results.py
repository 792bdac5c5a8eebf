"""Folders of results with errors that a test chooses."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from helpers import made_results
from helpers.made_results import MadeResults
from stiff_protocols.contract.types import BenchmarkData, FloatArray, IntArray

N_POSES = 40
Errors = Callable[[int, IntArray], FloatArray]
"""Number of the split, rows -> (n, 3) error, m."""

made_data = functools.partial(made_results.made_data, n_poses=N_POSES)


def fifths(n_splits: int) -> list[IntArray]:
    """Return the test rows of splits that divide the poses like cross-validation."""
    order = np.random.default_rng(1).permutation(N_POSES)
    return [np.sort(order[number::n_splits]) for number in range(n_splits)]


def store_results(
    folder: Path,
    models: dict[str, Errors],
    *,
    tests: Sequence[IntArray] | None = None,
    data: BenchmarkData | None = None,
    dataset: str = "made",
    options: dict[str, dict[str, object]] | None = None,
    failed: dict[str, Sequence[int]] | None = None,
    model_fields: dict[str, dict[str, object]] | None = None,
    **about: Any,
) -> Path:
    """Store a result of every model on every split.

    `failed` names the splits without a result. `about` has arguments of `MadeResults.add`;
    `model_fields` has such arguments of one model.
    """
    made, tests = MadeResults(folder), fifths(5) if tests is None else tests
    common = {"data": data or made_data(), "tests": tests, "kind": "measured", "n_train": 32}
    for model, errors in models.items():
        errors_mm = [1e3 * errors(index, rows) for index, rows in enumerate(tests)]
        without = (failed or {}).get(model, ())
        fields = common | about | (model_fields or {}).get(model, {})
        fields["options"] = (options or {}).get(model)
        made.add(model, errors_mm, dataset, "kfold", failed=without, **fields)
    return folder


def spread(mean: float, deviation: float, seed: int = 3) -> Errors:
    """Return errors along x with this mean that differ by row, but not by split."""
    draws = np.random.default_rng(seed).normal(mean, deviation, N_POSES)

    def errors(_: int, rows: IntArray) -> FloatArray:
        return np.column_stack([draws[rows], np.zeros((len(rows), 2))])

    return errors


def steady(*of_splits: float) -> Errors:
    """Return errors along x with this mean [m] per split; they grow slightly with the row."""

    def errors(index: int, rows: IntArray) -> FloatArray:
        x = of_splits[index] * (1.0 + 0.01 * (rows - rows.mean()) / N_POSES)
        return np.column_stack([x, np.zeros((len(rows), 2))])

    return errors
