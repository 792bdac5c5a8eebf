"""`bench reproduce effects` and `transfer`: models on many robots, relative to the VJM.

Effects: does the order of the models outlast other physics of the twin? The default twin's lost
motion, gear slopes and tilting bearings are what two of the models have as parameters. Here its
physics become rougher step by step, and then another robot's. Transfer: what do simulated data add
to a few measured poses?
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.leaderboard import of_newest_data
from stiff_bench.figures import style
from stiff_bench.figures.figure import Prepared
from stiff_bench.paper.pages import write_study
from stiff_bench.paper.study import ARMS, BEAM, EFFECT_STEPS, TRANSFER_DATA
from stiff_bench.tables.metric_table import mean_over
from stiff_bench.tables.render import render
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import MM
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.types import KNOWN

FAMILY = "arms"
COLUMNS = {
    **{step: [twin.name] for step, twin in EFFECT_STEPS.items()},
    "beam": [BEAM.name],
    FAMILY: [arm.name for arm in ARMS],
}
TRANSFER_COLUMNS = {head: [one.name for one in data] for head, data in TRANSFER_DATA.items()}
"""Column -> its data sets."""
FIRST, LAST = next(iter(EFFECT_STEPS)), next(reversed(EFFECT_STEPS))
TWINS = {FIRST: "default", LAST: "rough", "beam": "beam", FAMILY: FAMILY}
"""Columns whose orders of the models are compared -> name of the twin, or of the family."""
_ABOUT_KNOWN = (
    "`oracle` and `instrument noise`: what the twin's own physics, and what the noise of its "
    "instruments alone would score"
)
_ABOUT_EFFECTS = (
    "models have their default recipes, or the options in their names; protocol `holdout`, seed 0: "
    "three splits on the twins of the KR10, one on each arm",
    _ABOUT_KNOWN,
    "`preset=paper`: pre-trained on the paper's poses and loads; without it, in the training "
    "samples' ranges",
)
_ABOUT_TRANSFER = (
    "models have their default recipes, or the options in their names; protocol `holdout`, seed 0: "
    "one split on each simulated robot, five on the measured FANUC",
    "`mlp-pretrained`, `dt-cnn` and `adann-2r` without `supervision` learn no measured deflection: "
    "the labels only identify the VJM that makes their simulated data",
    "`preset=paper`: the source paper's poses and loads, of the KR10 alone",
    "`deep-ensemble` has 2 members in place of 5; arms: the first five of ten",
    _ABOUT_KNOWN,
)


def stored_errors(folder: Path) -> pd.DataFrame:
    """Return the mean 3-D errors [m] over the splits: a row a model, a column a data set.

    What a simulation knows of its own data stands among the models. Newest results count.

    Raises:
        StoreError: nothing is stored, or it is corrupt.
    """
    stored = StoredResults.read(folder)
    asked = {key: place for run in stored.runs for place, key in enumerate(run.cells)}
    counting = (
        result
        for case in of_newest_data(stored.cases)
        for model in case.competitors
        for result in case.results(model)
    )
    rows = []
    for result in sorted(counting, key=lambda one: asked.get(one.cell.key, -1)):
        found = result.prediction
        assert found is not None
        seen = {result.shown.model: found.predicted}
        if result.shown.model == REFERENCE_MODEL:
            seen |= {KNOWN[key]: deflection for key, deflection in found.known.items()}
        for model, predicted in seen.items():
            error = np.linalg.norm(predicted - found.measured, axis=1).mean()
            rows.append((model, result.shown.dataset, error))
    errors = pd.DataFrame(rows, columns=["model", "data", "error"])
    if REFERENCE_MODEL not in set(errors["model"]):
        raise StoreError(f"{folder}: no result of {REFERENCE_MODEL} to compare with")
    return errors.pivot_table("error", "model", "data", lambda of: np.mean([*of]), sort=False)


def relative(errors: pd.DataFrame, columns: Mapping[str, Sequence[str]]) -> dict[str, pd.DataFrame]:
    """Return column -> errors relative to the VJM's, a column each of its data sets that it has."""
    vjm = errors.T[REFERENCE_MODEL].dropna()
    ratios = errors / vjm
    of_columns = {head: [one for one in data if one in vjm] for head, data in columns.items()}
    return {head: ratios[data] for head, data in of_columns.items() if data}


def ratio_table(
    errors: pd.DataFrame,
    columns: Mapping[str, Sequence[str]],
    best_on: str,
    notes: Sequence[str],
    apart: Sequence[str] = (),
) -> Table:
    """Return a row a model of errors relative to the VJM's, the best on one column first.

    A column, what stands above it -> its data sets, is left out without results. A note says the
    VJM's own errors, but for columns that stand `apart`.
    """
    ratios, vjm = relative(errors, columns), errors.T[REFERENCE_MODEL]
    heads = [head for head in ratios if head not in apart]
    sizes = [f"{head} {MM * vjm[ratios[head].columns].mean():.3f}" for head in heads]
    mean = pd.DataFrame({head: of.mean(axis=1) for head, of in ratios.items()})
    ordered = mean.sort_values(best_on, kind="stable") if best_on in mean else mean

    def cell(model: str, head: str) -> Quantity | None:
        found = ratios[head].T[model].dropna().tolist()
        if not found:
            return None
        return mean_over(found) if len(columns[head]) > 1 else Quantity(found[0])

    return Table(
        title="3-D error relative to the VJM's on the same data",
        columns=[Column("model", "text"), *(Column(head, format=".2f") for head in ratios)],
        rows=[[model, *(cell(model, head) for head in ratios)] for model in ordered.index],
        notes=[f"3-D error of the VJM [mm]: {', '.join(sizes)}.", *notes],
    )


def effects_table(errors: pd.DataFrame) -> Table:
    """Return each model's 3-D error relative to the VJM's, best on the rough twin first."""
    notes = ["Each column to the left of beam adds an effect to those before it."]
    if FAMILY in relative(errors, COLUMNS):
        notes.append("arms: mean ± standard deviation over the robots.")
    return ratio_table(errors, COLUMNS, LAST, notes, apart=[FAMILY])


def transfer_table(errors: pd.DataFrame) -> Table:
    """Return each model's 3-D error relative to the VJM's, best on the default twin first."""
    note = "Mean ± standard deviation over the specimens of a twin, and over the arms."
    return ratio_table(errors, TRANSFER_COLUMNS, "default", [note])


def orders(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the relative 3-D error of models (rows) on twins, of models that every twin has."""
    ratios = relative(errors, COLUMNS)
    found = {name: ratios[head].mean(axis=1) for head, name in TWINS.items() if head in ratios}
    return pd.DataFrame(found).drop(index=KNOWN.values(), errors="ignore").dropna()


def taus_table(errors: pd.DataFrame) -> Table:
    """Return Kendall's tau between the orders of the models on every two twins."""
    found = orders(errors)
    twins, taus = list(map(str, found)), found.corr(method="kendall").to_numpy().tolist()
    return Table(
        title=f"Kendall's tau between the orders of {len(found)} models",
        columns=[Column("twin", "text"), *(Column(twin, format=".2f") for twin in twins)],
        rows=[[twin, *row] for twin, row in zip(twins, taus, strict=True)],
        notes=["1: the same order; 0: unrelated; -1: the other way round."],
    )


def effects_figure(errors: pd.DataFrame) -> Prepared:
    """Return the picture of `effects_table`."""
    return Prepared(
        "3-D error relative to the VJM's as the twin's physics become rougher",
        "(a) kr10-twin-rough, an effect more at each step; (b) twins of other physics: beam, and "
        "ten arms (bars: standard deviation over the robots). Protocol holdout, seed 0. Grey: what "
        "the twin's own physics and what the instruments' noise alone would score.",
        partial(_paint, relative(errors, COLUMNS)),
    )


def _paint(ratios: Mapping[str, pd.DataFrame]) -> Figure:
    figure = style.new_figure(style.PAGE_INCH, 3.6)
    panels = figure.subplots(1, 2, sharey=True, width_ratios=[5, 4])
    mean = pd.DataFrame({head: of.mean(axis=1) for head, of in ratios.items()})
    spread = pd.DataFrame({head: of.std(axis=1) for head, of in ratios.items()}).fillna(0.0)
    models = [name for name in mean.index if name not in KNOWN.values()]
    look = dict(zip(models, style.looks(len(models)), strict=True))
    steps = {step: step for step in EFFECT_STEPS}
    for axes, heads, joined in zip(panels, (steps, TWINS), (True, False), strict=True):
        there = [head for head in heads if head in ratios]
        for model in mean.index:
            y = mean.loc[model, there].dropna()
            x = [there.index(head) for head in y.index]
            if model in KNOWN.values():
                line = ":" if model == KNOWN["noise"] else "--"
                style_of = line if joined else "_"
                axes.plot(x, y, style_of, color=style.REFERENCE_COLOR, label=model)
                continue
            one = look[model]
            drawn = one.connected() | {"marker": one.marker} if joined else one.points()
            axes.errorbar(x, y, spread.loc[model, y.index], capsize=1.5, label=model, **drawn)
        axes.set_xticks(range(len(there)), [heads[name] for name in there])
        axes.set_yscale("log")
        style.plain_numbers(axes.yaxis)
    panels[0].set_ylabel("3-D error / VJM's")
    style.name_panels(panels)
    style.share_legend(figure, reversed(panels), ncols=4)
    return figure


def write_effects(output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write OUTPUT/effects.md, .csv and the figure; arguments and errors as in `write_study`."""
    errors = stored_errors(output / "effects" / "runs")
    return write_study(
        output / "effects",
        "Does the order of the models outlast other physics?",
        _ABOUT_EFFECTS,
        partial(render, [effects_table(errors), taus_table(errors)], command=command),
        command=command,
        n_missing=n_missing,
        figures={"effects": effects_figure(errors)},
    )


def write_transfer(output: Path, command: str, n_missing: int) -> Iterator[Path]:
    """Write OUTPUT/transfer.md and .csv; arguments and errors as in `write_study`."""
    return write_study(
        output / "transfer",
        "What do simulated data add to a few measured poses?",
        _ABOUT_TRANSFER,
        partial(
            render, [transfer_table(stored_errors(output / "transfer" / "runs"))], command=command
        ),
        command=command,
        n_missing=n_missing,
    )
