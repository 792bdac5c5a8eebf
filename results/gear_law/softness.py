"""Measure how soft robots are under small loads, in each world.

`python results/gear_law/softness.py` writes softness.md (minutes). `vjm-full` is fitted to all
samples; the table has the median of measured over predicted deflection among the 30 % smallest and
the 30 % largest loads.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from tabulate import tabulate

import stiffbench as sb
from stiff_datasets.twin.effects import WORLDS

PAGE = Path(__file__).with_suffix(".md")
ROBOTS = ("kr10-twin-omni", "ur5-twin", *(f"arm-family@robot={n}" for n in range(10)))
SHARE = 0.3
MEASURED = "fanuc-r2000ic"


def softness(dataset: str) -> str:
    """Return the two medians: under small, and under large loads."""
    data = sb.load_dataset(dataset)
    samples = data.samples
    model = sb.make_model("vjm-full").fit(data)
    predicted = model.predict(samples.q, samples.wrench)
    along = np.einsum("na,na->n", samples.deflection, predicted)
    ratio = along / np.einsum("na,na->n", predicted, predicted)
    force = np.linalg.norm(samples.wrench[:, :3], axis=1)
    low, high = np.quantile(force, [SHARE, 1.0 - SHARE])
    return f"{np.median(ratio[force <= low]):.2f} / {np.median(ratio[force >= high]):.2f}"


def main() -> None:
    """Write the page."""
    rows = []
    for robot in ROBOTS:
        worlds = {world: softness(f"{robot}@world={world}") for world in WORLDS}
        rows.append({"robot": robot, **worlds})
    rows.append({"robot": f"{MEASURED} (measured)", **dict.fromkeys(WORLDS, softness(MEASURED))})
    frame = pd.DataFrame(rows)
    table = tabulate(frame, [*frame.columns], "github", showindex=False, disable_numparse=True)
    text = (
        "# How soft robots are under small loads\n\n"
        "`python results/gear_law/softness.py` writes this page. Median of measured over predicted "
        "deflection (`vjm-full`, fitted to all samples): the 30 % smallest loads / the 30 % "
        "largest.\n\n"
    )
    PAGE.write_text(f"{text}{table}\n", encoding="utf-8")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
