"""`bench reproduce effects`: does the order of the models outlast other physics of the twin?

The default twin's lost motion, gear slopes and tilting bearings are what two of the models have as
parameters. Here its physics become rougher step by step, and then another robot's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

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
from stiff_bench.paper.pages import (
    figures_and_missing,
    listed,
    pictures,
    provenance,
    written,
)
from stiff_bench.paper.study import ARMS, BEAM, EFFECT_STEPS, EFFECTS_FOLDER
from stiff_bench.store.database import stored_results
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Cell, Column, Quantity, Table
from stiff_bench.tables.units import MM
from stiff_models.catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.types import KNOWN

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEPS = {variant.name: text for text, variant in EFFECT_STEPS.items()}
"""Data set -> what it adds to the one before."""
FAMILY = "arms"
OTHERS = {BEAM.name: "beam", FAMILY: FAMILY}
COLUMNS = {name: (name,) for name in (*STEPS, BEAM.name)} | {FAMILY: [arm.name for arm in ARMS]}
"""Column -> its data sets."""
TWINS = {next(iter(STEPS)): "default", next(reversed(STEPS)): "rough", **OTHERS}
"""Twins whose orders of the models are compared; the arms are one of them."""
ABOUT_KNOWN = (
    "`oracle` and `instrument noise`: what the twin's own physics, and what the noise of its "
    "instruments alone would score"
)
Errors = Mapping[str, Mapping[str, float]]
"""Model -> data set -> mean 3-D error, m."""


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


def relative(
    errors: Errors, columns: Mapping[str, Sequence[str]] = COLUMNS
) -> dict[str, dict[str, Quantity]]:
    """Return model -> column -> 3-D error relative to the VJM's on the same data.

    Args:
        errors: of each model on each data set.
        columns: the data sets of each column; several: mean and standard deviation over them.
    """
    vjm, found = errors[REFERENCE_MODEL], dict[str, dict[str, Quantity]]()
    for model, of in errors.items():
        found[model] = {}
        for column, data in columns.items():
            ratios = [of[one] / vjm[one] for one in data if one in of and one in vjm]
            if ratios:
                spread = float(np.std(ratios, ddof=1)) if len(ratios) > 1 else None
                n = len(ratios) if len(data) > 1 else None
                found[model][column] = Quantity(float(np.mean(ratios)), spread, n=n)
    return found


def effects_table(errors: Errors) -> Table:
    """Return each model's 3-D error relative to the VJM's, best on the rough twin first."""
    ratios, last = relative(errors), next(reversed(STEPS))
    heads = STEPS | OTHERS
    there = {name: head for name, head in heads.items() if name in ratios[REFERENCE_MODEL]}
    vjm = {there[d]: errors[REFERENCE_MODEL][d] for d in there if d != FAMILY}
    notes = [
        "Each column to the left of beam adds an effect to those before it.",
        *(["arms: mean ± standard deviation over the robots."] if FAMILY in there else []),
    ]
    return ratio_table(ratios, there, last, vjm, notes)


def ratio_table(
    ratios: Mapping[str, Mapping[str, Quantity]],
    heads: Mapping[str, str],
    best_on: str,
    vjm: Mapping[str, float],
    notes: Sequence[str],
) -> Table:
    """Return a row a model of errors relative to the VJM's.

    Args:
        ratios: what `relative` gives.
        heads: its columns that are shown -> what stands above them.
        best_on: the column that sorts the models, best first.
        vjm: what stands above a column -> the VJM's own error, m.
        notes: of this table.
    """
    order = sorted(
        ratios, key=lambda model: ratios[model].get(best_on, Quantity(np.inf)).order or 0.0
    )
    sizes = ", ".join(f"{head} {MM * error:.3f}" for head, error in vjm.items())
    return Table(
        title="3-D error relative to the VJM's on the same data",
        columns=[Column("model", "text"), *(Column(one, format=".2f") for one in heads.values())],
        rows=[[model, *(ratios[model].get(name) for name in heads)] for model in order],
        notes=[f"3-D error of the VJM [mm]: {sizes}.", *notes],
    )


def orders(errors: Errors) -> dict[str, dict[str, float]]:
    """Return twin -> model -> relative 3-D error, for models that every twin has."""
    ratios = relative(errors)
    there = [name for name in TWINS if name in ratios[REFERENCE_MODEL]]
    models = [
        model
        for model, of in ratios.items()
        if model not in KNOWN.values() and all(name in of for name in there)
    ]
    return {TWINS[name]: {m: ratios[m][name].order or 0.0 for m in models} for name in there}


def taus_table(errors: Errors) -> Table:
    """Return Kendall's tau between the orders of the models on every two twins."""
    from scipy.stats import kendalltau

    of = orders(errors)
    models = list(next(iter(of.values())))
    rows: list[list[Cell]] = [
        [one, *(kendalltau([a[m] for m in models], [b[m] for m in models])[0] for b in of.values())]
        for one, a in of.items()
    ]
    return Table(
        title=f"Kendall's tau between the orders of {len(models)} models",
        columns=[Column("twin", "text"), *(Column(name, format=".2f") for name in of)],
        rows=rows,
        notes=["1: the same order; 0: unrelated; -1: the other way round."],
    )


def effects_figure(errors: Errors) -> Prepared:
    """Return the picture of `effects_table`."""
    return Prepared(
        "effects",
        "3-D error relative to the VJM's as the twin's physics become rougher",
        "(a) kr10-twin-rough, an effect more at each step; (b) twins of other physics: beam, and "
        "ten arms (bars: standard deviation over the robots). Protocol holdout, seed 0. Grey: what "
        "the twin's own physics and what the instruments' noise alone would score.",
        partial(_paint, relative(errors)),
    )


def _paint(ratios: Mapping[str, Mapping[str, Quantity]]) -> Figure:
    figure = new_figure(PAGE_INCH, 3.6)
    panels = figure.subplots(1, 2, sharey=True, width_ratios=[5, 4])
    models = [name for name in ratios if name not in KNOWN.values()]
    styles = dict(zip(models, looks(len(models)), strict=True))
    for axes, heads, joined in zip(panels, (STEPS, TWINS), (True, False), strict=True):
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
    """Write OUTPUT/effects.md and its figure; yield each file.

    Args:
        output: the folder; results are in OUTPUT/effects/runs.
        command: that made them.
        n_missing: how many of the study's results are not stored.

    Raises:
        StoreError: nothing is stored, a file cannot be written, or a stored one is damaged.
    """
    folder = output / EFFECTS_FOLDER
    errors = stored_errors(folder / "runs")
    figure = effects_figure(errors)
    yield from pictures([figure], folder / "figures")
    tables = [effects_table(errors), taus_table(errors)]
    yield written(output / "effects.csv", render(tables, "csv", command))
    page = [
        "# Does the order of the models outlast other physics?",
        listed(*_ABOUT, *provenance(folder / "runs", command, n_missing)),
        render(tables, "github", command),
        *figures_and_missing([figure], f"{EFFECTS_FOLDER}/figures", {}),
    ]
    yield written(output / "effects.md", "\n\n".join(page))


_ABOUT = (
    "models have their default recipes, or the options in their names; protocol `holdout`, seed 0: "
    "three splits on the twins of the KR10, one on each arm",
    ABOUT_KNOWN,
    "`preset=paper`: pre-trained on the paper's poses and loads; without it, in the training "
    "samples' ranges",
)
