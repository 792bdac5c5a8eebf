"""`bench data calibrate`: the search, its record, and its figures beside the paper's."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from tabulate import tabulate

from stiff_bench.progress import phases
from stiff_bench.provenance import environment
from stiff_bench.published import published_rows, published_stiffness
from stiff_bench.registry import build_registry, lookup
from stiff_bench.units import MM
from stiff_datasets.calibration import (
    FIGURE_SEEDS,
    SEARCH_SEEDS,
    VjmFigures,
    calibrate,
    line_figures,
    mean_figures,
    misfit,
)
from stiff_datasets.kr10_twin import CONSTANTS
from stiff_datasets.specimen import LAST_SPECIMEN
from stiff_datasets.twins import shipped_constants
from stiff_protocols.files import make_folder, written_whole
from stiff_protocols.types import AXES

METRICS = ("mae", "stde", "me")


def calibrate_twin(*, generations: int, seed: int, output: Path) -> str:
    """Search the constants, write them and the record, and return the figures as text.

    Raises:
        StoreError: a file cannot be written.
    """
    make_folder(output)  # before the work, not after it
    start = time.perf_counter()
    make_vjm = lookup(build_registry().models, "model", "vjm").load()
    target = paper_figures()
    shipped = shipped_constants(CONSTANTS)
    with phases():
        found = calibrate(shipped, make_vjm, target, generations=generations, seed=seed)
    specimens = [
        mean_figures(line_figures(found.constants, make_vjm, specimen=number))
        for number in range(LAST_SPECIMEN + 1)
    ]
    constants = found.constants.model_dump(mode="json")
    record = {
        "command": f"bench data calibrate --generations {generations} --seed {seed}",
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "seconds": round(time.perf_counter() - start),
        "environment": environment(),
        "search_seeds": SEARCH_SEEDS,
        "figure_seeds": FIGURE_SEEDS,
        "misfit": misfit(specimens[0], target),
        "steps": [asdict(step) for step in found.steps],
        "paper": _plain(target),
        "specimens": [_plain(figures) for figures in specimens],
        "constants": constants,
    }
    toml, text = output / f"{CONSTANTS}.toml", output / f"{CONSTANTS}.json"
    with written_whole(toml) as temporary:
        temporary.write_text(tomli_w.dumps(constants), encoding="utf-8")
    with written_whole(text) as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return f"{figures_text(specimens, target)}\n\nconstants: {toml}\nrecord: {text}"


def paper_figures() -> VjmFigures:
    """Return the paper's Tables 2 and 3, SI units."""
    (row,) = published_rows("table_2")
    errors = {
        metric: np.array([row.values_mm[metric, axis] for axis in AXES]) / MM for metric in METRICS
    }
    return VjmFigures(**errors, stiffness=np.array(list(published_stiffness().values())))


def figures_text(specimens: list[VjmFigures], target: VjmFigures) -> str:
    """Return the paper's Tables 2 and 3 beside the twin's, as github tables.

    Args:
        specimens: figures of each specimen; the first has the constants as they stand.
        target: the paper's.
    """
    rows = []
    for metric in METRICS:
        for i, axis in enumerate(AXES):
            values = np.array([getattr(figures, metric)[i] for figures in specimens]) * MM
            rows.append(
                _row(
                    f"{axis.upper()} {metric.upper()} [mm]",
                    values,
                    getattr(target, metric)[i] * MM,
                    "{:.3f}",
                )
            )
    for joint, (name, paper) in enumerate(published_stiffness().items()):
        values = np.array([figures.stiffness[joint] for figures in specimens])
        rows.append(_row(f"{name} [Nm/rad]", values, paper, "{:.0f}"))
    headers = ["VJM on all samples", "paper", "twin", "off", f"{len(specimens)} specimens"]
    align = ["left", *["right"] * 4]
    return tabulate(rows, headers=headers, tablefmt="github", colalign=align, disable_numparse=True)


def _row(name: str, values: np.ndarray[Any, Any], paper: float, form: str) -> list[str]:
    return [
        name,
        form.format(paper),
        form.format(values[0]),
        f"{values[0] / paper - 1.0:+.0%}",
        f"{form.format(values.mean())} ± {form.format(values.std(ddof=1))}",
    ]


def _plain(figures: VjmFigures) -> Mapping[str, list[float]]:
    """Return the figures for the record: mm and N m/rad, rounded to what is repeatable."""
    errors = {f"{name}_mm": (getattr(figures, name) * MM).round(4).tolist() for name in METRICS}
    return errors | {"stiffness_Nm_per_rad": figures.stiffness.round(1).tolist()}
