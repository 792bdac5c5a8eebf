"""`bench reproduce effects`: does the order of the models outlast other physics of the twin?

The default twin's lost motion, gear slopes and tilting bearings are what two of the models have as
parameters. Here its physics become rougher step by step, and then another robot's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stiff_bench.figures.figure import Prepared
from stiff_bench.figures.style import (
    PAGE_INCH,
    REFERENCE_COLOR,
    looks,
    name_panels,
    new_figure,
    plain_numbers,
    share_legend,
)
from stiff_bench.paper.pages import write_study
from stiff_bench.paper.study import ARMS, BEAM, EFFECT_STEPS
from stiff_bench.store.database import stored_results
from stiff_bench.tables.metric_table import mean_over
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import MM
from stiff_models.catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.types import KNOWN

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAMILY = "arms"
ALONE = {step: [twin.name] for step, twin in EFFECT_STEPS.items()} | {"beam": [BEAM.name]}
"""Column of one data set -> its name."""
COLUMNS = {**ALONE, FAMILY: [arm.name for arm in ARMS]}
"""Column -> its data sets."""
FIRST, LAST = next(iter(EFFECT_STEPS)), next(reversed(EFFECT_STEPS))
TWINS = {FIRST: "default", LAST: "rough", "beam": "beam", FAMILY: FAMILY}
"""Columns whose orders of the models are compared -> name of the twin, or of the family."""
ABOUT_KNOWN = (
    "`oracle` and `instrument noise`: what the twin's own physics, and what the noise of its "
    "instruments alone would score"
)
Errors = Mapping[str, Mapping[str, float]]
"""Model -> data set -> mean 3-D error, m."""
Ratios = Mapping[str, Mapping[str, Quantity]]
"""Model -> column -> 3-D error relative to the VJM's on the same data."""


def stored_errors(folder: Path) -> dict[str, dict[str, float]]:
    """Return model -> data set -> 3-D error, m, mean over the splits.

    What a simulation knows of its own data stands among the models.

    Raises:
        StoreError: nothing is stored, or it is damaged.
    """
    each: dict[str, dict[str, list[float]]] = {}
    for result in stored_results(folder):
        found = result.prediction
        if result.status != "ok" or found is None:
            continue
        data, model = result.shown.dataset, result.shown.model
        seen = {model: found.predicted}
        if model == REFERENCE_MODEL:
            seen |= {KNOWN[key]: deflection for key, deflection in found.known.items()}
        for name, predicted in seen.items():
            error = float(np.linalg.norm(predicted - found.measured, axis=1).mean())
            each.setdefault(name, {}).setdefault(data, []).append(error)
    if REFERENCE_MODEL not in each:
        raise StoreError(f"{folder}: no result of {REFERENCE_MODEL} to compare with")
    return {
        model: {data: float(np.mean(values)) for data, values in of.items()}
        for model, of in each.items()
    }


def relative(errors: Errors, columns: Mapping[str, Sequence[str]]) -> Ratios:
    """Return model -> column -> 3-D error relative to the VJM's on the same data.

    A column of several data sets has the mean and the standard deviation over them.
    """
    vjm, found = errors[REFERENCE_MODEL], dict[str, dict[str, Quantity]]()
    for model, of in errors.items():
        found[model] = {}
        for column, data in columns.items():
            ratios = [of[one] / vjm[one] for one in data if one in of and one in vjm]
            if ratios:
                ratio = mean_over(ratios)
                found[model][column] = ratio if len(data) > 1 else replace(ratio, n=None)
    return found


def ratio_table(
    errors: Errors,
    columns: Mapping[str, Sequence[str]],
    best_on: str,
    notes: Sequence[str],
    apart: Sequence[str] = (),
) -> Table:
    """Return a row a model of errors relative to the VJM's, the best on one column first.

    Args:
        errors: of each model on each data set.
        columns: what stands above a column -> its data sets; without results it is left out.
        best_on: the column that sorts the models.
        notes: of this table.
        apart: columns on which no note says the VJM's own error.
    """
    ratios, vjm = relative(errors, columns), errors[REFERENCE_MODEL]
    heads = [head for head in columns if head in ratios[REFERENCE_MODEL]]
    sizes = [
        f"{head} {MM * np.mean([vjm[one] for one in columns[head] if one in vjm]):.3f}"
        for head in heads
        if head not in apart
    ]
    return Table(
        title="3-D error relative to the VJM's on the same data",
        columns=[Column("model", "text"), *(Column(head, format=".2f") for head in heads)],
        rows=[
            [model, *(of.get(head) for head in heads)]
            for model, of in sorted(
                ratios.items(), key=lambda one: one[1].get(best_on, Quantity(np.inf)).order or 0.0
            )
        ],
        notes=[f"3-D error of the VJM [mm]: {', '.join(sizes)}.", *notes],
    )


def effects_table(errors: Errors) -> Table:
    """Return each model's 3-D error relative to the VJM's, best on the rough twin first."""
    notes = ["Each column to the left of beam adds an effect to those before it."]
    if any(arm in errors[REFERENCE_MODEL] for arm in COLUMNS[FAMILY]):
        notes.append("arms: mean ± standard deviation over the robots.")
    return ratio_table(errors, COLUMNS, LAST, notes, apart=[FAMILY])


def orders(errors: Errors) -> pd.DataFrame:
    """Return the relative 3-D error of models (rows) on twins, of models that every twin has."""
    found = {
        twin: {
            model: of[column].value
            for model, of in relative(errors, COLUMNS).items()
            if column in of
        }
        for column, twin in TWINS.items()
    }
    return (
        pd.DataFrame(found)
        .drop(index=KNOWN.values(), errors="ignore")
        .dropna(axis="columns", how="all")
        .dropna()
    )


def taus_table(errors: Errors) -> Table:
    """Return Kendall's tau between the orders of the models on every two twins."""
    found = orders(errors)
    twins, taus = list(map(str, found)), found.corr(method="kendall").to_numpy().tolist()
    return Table(
        title=f"Kendall's tau between the orders of {len(found)} models",
        columns=[Column("twin", "text"), *(Column(twin, format=".2f") for twin in twins)],
        rows=[[twin, *row] for twin, row in zip(twins, taus, strict=True)],
        notes=["1: the same order; 0: unrelated; -1: the other way round."],
    )


def effects_figure(errors: Errors) -> Prepared:
    """Return the picture of `effects_table`."""
    return Prepared(
        "3-D error relative to the VJM's as the twin's physics become rougher",
        "(a) kr10-twin-rough, an effect more at each step; (b) twins of other physics: beam, and "
        "ten arms (bars: standard deviation over the robots). Protocol holdout, seed 0. Grey: what "
        "the twin's own physics and what the instruments' noise alone would score.",
        partial(_paint, relative(errors, COLUMNS)),
    )


def _paint(ratios: Ratios) -> Figure:
    figure = new_figure(PAGE_INCH, 3.6)
    panels = figure.subplots(1, 2, sharey=True, width_ratios=[5, 4])
    models = [name for name in ratios if name not in KNOWN.values()]
    styles = dict(zip(models, looks(len(models)), strict=True))
    steps = {step: step for step in EFFECT_STEPS}
    for axes, heads, joined in zip(panels, (steps, TWINS), (True, False), strict=True):
        there = [name for name in heads if name in ratios[REFERENCE_MODEL]]
        for model, of in ratios.items():
            known = [(i, of[name]) for i, name in enumerate(there) if name in of]
            x, y = [i for i, _ in known], [found.order for _, found in known]
            if model in KNOWN.values():
                line = ":" if model == KNOWN["noise"] else "--"
                axes.plot(x, y, line if joined else "_", color=REFERENCE_COLOR, label=model)
                continue
            look = styles[model]
            style = look.connected() | {"marker": look.marker} if joined else look.points()
            spread = [found.spread or 0.0 for _, found in known]
            axes.errorbar(x, y, spread, capsize=1.5, label=model, **style)
        axes.set_xticks(range(len(there)), [heads[name] for name in there])
        axes.set_yscale("log")
        plain_numbers(axes.yaxis)
    panels[0].set_ylabel("3-D error / VJM's")
    name_panels(panels)
    share_legend(figure, reversed(panels), ncols=4)
    return figure


def write_effects(output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write OUTPUT/effects.md, .csv and the figure; arguments and errors as in `write_study`."""
    errors = stored_errors(output / "effects" / "runs")
    tables = [effects_table(errors), taus_table(errors)]
    return write_study(
        output / "effects",
        "Does the order of the models outlast other physics?",
        _ABOUT,
        lambda fmt: render(tables, fmt, command),
        command=command,
        n_missing=n_missing,
        figures={"effects": effects_figure(errors)},
    )


_ABOUT = (
    "models have their default recipes, or the options in their names; protocol `holdout`, seed 0: "
    "three splits on the twins of the KR10, one on each arm",
    ABOUT_KNOWN,
    "`preset=paper`: pre-trained on the paper's poses and loads; without it, in the training "
    "samples' ranges",
)
