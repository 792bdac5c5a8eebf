"""Small folders of results from which every figure can be drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from helpers.made_results import TWINS, MadeResults
from stiff_bench.store.database import ResultStore, read_results

SIZES = (5, 10, 40)
CURVE = np.array([[10.0, 0.5, 0.6], [20.0, 0.2, 0.3], [30.0, 0.1, 0.4]])


def compared(folder: Path) -> MadeResults:
    """Store four models on two splits."""
    made = MadeResults(folder)
    for name, error in (("vjm", 0.4), ("gp", 0.1), ("mlp", 0.2), ("$x_1$ <b>", 0.3)):
        made.add(name, [error, error])
    return made


def learned(folder: Path, n_twins: int = 3, **presentation) -> MadeResults:
    """Store two models, three sizes, some specimens; errors are e^(specimen) / size."""
    made = MadeResults(folder)
    for number, twin in enumerate(TWINS[:n_twins]):
        for size in SIZES:
            for name, factor in (("vjm", 1.0), ("gp", 0.5)):
                error = factor * np.exp(number) / size
                protocol = {"protocol": "sample-efficiency", "condition": f"n = {size}"}
                made.add(name, [error], dataset=twin, n_train=size, **protocol, **presentation)
    return made


def with_fields(made: MadeResults, model: str, *, split: int | None = None, **changes) -> None:
    """Change fields of the stored results of a model, on one split or on all."""
    store = ResultStore(made.folder)
    for result in list(read_results(made.folder)):
        if result.presentation.model == model and split in (None, result.fit.split_index):
            store.write_fits([replace(result, **changes)])
