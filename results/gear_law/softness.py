"""Measure how soft robots are under small loads, in each world.

`python results/gear_law/softness.py` writes softness.md (minutes). `vjm-full` is fitted to all
samples; the table has the median of measured over predicted deflection among the 30 % smallest and
the 30 % largest loads.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
from tabulate import tabulate

import stiffbench as sb
from stiff_datasets.twin.effects import STRUCTURE, WORLDS, World

PAGE = Path(__file__).with_suffix(".md")
ROBOTS = ("kr10-twin-omni", "ur5-twin", *(f"arm-family@robot={n}" for n in range(10)))
SHARE = 0.3
MEASURED = "fanuc-r2000ic"
EXPECTED = (0.85, 1.2)
"""Range of the ratio under small loads about the measured robot's 1.07."""


def softness(dataset: str) -> tuple[float, float]:
    """Return the two medians: under small, and under large loads."""
    data = sb.load_dataset(dataset)
    samples = data.samples
    model = sb.make_model("vjm-full").fit(data)
    predicted = model.predict(samples.q, samples.wrench)
    along = np.einsum("na,na->n", samples.deflection, predicted)
    ratio = along / np.einsum("na,na->n", predicted, predicted)
    force = np.linalg.norm(samples.wrench[:, :3], axis=1)
    low, high = np.quantile(force, [SHARE, 1.0 - SHARE])
    return float(np.median(ratio[force <= low])), float(np.median(ratio[force >= high]))


def explained(dataset: str, world: World) -> str:
    """Return the ratio under small loads without each effect of the structure."""
    every, ratios = WORLDS[world], []
    for effect in every:
        if effect in STRUCTURE:
            with mock.patch.dict(WORLDS, {world: tuple(of for of in every if of is not effect)}):
                small, _ = softness(f"{dataset}@world={world}")
            ratios.append(f"{effect.__name__} {small:.2f}")
    return ", ".join(ratios)


def main() -> None:
    """Write the page."""
    rows, outside = [], []
    for robot in ROBOTS:
        worlds = {world: softness(f"{robot}@world={world}") for world in WORLDS}
        rows.append({"robot": robot, **worlds})
        for world, (small, _) in worlds.items():
            if not EXPECTED[0] <= round(small, 2) <= EXPECTED[1]:
                without = explained(robot, world)
                outside.append(f"- {robot}, {world}: {small:.2f}. Without one effect: {without}.")
    rows.append({"robot": f"{MEASURED} (measured)", **dict.fromkeys(WORLDS, softness(MEASURED))})
    frame = pd.DataFrame(rows).map(
        lambda cell: cell if isinstance(cell, str) else f"{cell[0]:.2f} / {cell[1]:.2f}"
    )
    table = tabulate(frame, [*frame.columns], "github", showindex=False, disable_numparse=True)
    text = (
        "# How soft robots are under small loads\n\n"
        "`python results/gear_law/softness.py` writes this page. Median of measured over predicted "
        "deflection (`vjm-full`, fitted to all samples): the 30 % smallest loads / the 30 % "
        "largest.\n\n"
    )
    if outside:
        table += "\n\nOutside 0.85 to 1.2 under small loads:\n\n" + "\n".join(outside)
    PAGE.write_text(f"{text}{table}\n", encoding="utf-8")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
