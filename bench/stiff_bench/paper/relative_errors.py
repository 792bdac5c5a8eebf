"""Errors of models relative to the VJM's: table, picture, and how far the models' orders agree."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import pandas as pd
import seaborn
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from seaborn.utils import relative_luminance

from stiff_bench.analysis.collected import StoredResults, of_newest_data
from stiff_bench.figures import style
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.paper.study_file import Study
from stiff_bench.tables.metric_table import mean_over
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import MM
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.types import KNOWN

_LOWER_BOUNDS = list(KNOWN.values())
"""Rows of what a simulation knows of its own data: no models."""
LIGHT = 0.18  # relative luminance from which on black has more contrast than white
ROW_INCH, FRAME_INCH = 0.22, 0.35
COLORS = "RdBu_r"
"""Blue: below the VJM's error; white: equal; red: above."""
STEPS = (0.25, 0.5, 0.7, 1.0, 1.5, 2.0, 4.0)
MOST_RATIO = 4.0
"""Ratio (and its inverse) from which on the colour stays the same: a few would pale the others."""


def mean_errors(stored: StoredResults) -> pd.DataFrame:
    """Return the mean 3-D errors [m] over the splits: a row per model, a column per data set.

    Rows have the order in which the models were asked for. The newest results count. What a
    simulation knows of its own data has rows, too.

    Raises:
        StoreError: there is no result of the VJM.
    """
    asked = {key: place for run in stored.runs for place, key in enumerate(run.cells)}
    results = [
        result
        for case in of_newest_data(stored.cases)
        for model in case.competitors
        for result in case.results(model)
    ]
    rows = []
    for result in sorted(results, key=lambda one: asked.get(one.cell.key, -1)):
        prediction = result.prediction
        assert prediction is not None
        predicted = {result.shown.model: prediction.predicted}
        if result.shown.model == REFERENCE_MODEL:
            predicted |= {KNOWN[key]: values for key, values in prediction.known.items()}
        for model, deflection in predicted.items():
            error = np.linalg.norm(deflection - prediction.measured, axis=1).mean()
            rows.append((model, result.shown.dataset, error))
    errors = pd.DataFrame(rows, columns=["model", "data", "error"])
    if REFERENCE_MODEL not in set(errors["model"]):
        raise StoreError(f"{stored.folder}: no result of {REFERENCE_MODEL} to compare with")
    return errors.pivot_table("error", "model", "data", lambda of: np.mean([*of]), sort=False)


@dataclass(frozen=True, eq=False)
class RelativeErrors:
    """Errors relative to the VJM's on the same data.

    Attributes:
        study: whose groups are the columns; a group without results has none.
        errors: of `mean_errors`.
    """

    study: Study
    errors: pd.DataFrame

    @cached_property
    def ratios(self) -> dict[str, pd.DataFrame]:
        """Group -> errors / VJM's: a row per model, a column per data set of the group."""
        of_vjm = self.errors.T[REFERENCE_MODEL].dropna()
        ratios = self.errors / of_vjm
        groups = {
            name: [one for one in datasets if one in of_vjm]
            for name, datasets in self.study.groups.items()
        }
        return {name: ratios[datasets] for name, datasets in groups.items() if datasets}

    @cached_property
    def means(self) -> pd.DataFrame:
        """Mean ratio: a row per model, a column per group."""
        return pd.DataFrame({name: of_group.mean(axis=1) for name, of_group in self.ratios.items()})

    @property
    def orders(self) -> pd.DataFrame:
        """Mean ratio of the models that every compared group has; columns by their names there."""
        names = {group: name for group, name in self.study.orders.items() if group in self.means}
        compared = self.means[[*names]].rename(columns=names)
        return compared.drop(index=_LOWER_BOUNDS, errors="ignore").dropna()

    @property
    def _sorted(self) -> pd.DataFrame:
        """The means, the best on one group first."""
        sort_by = self.study.sort_by
        return (
            self.means.sort_values(sort_by, kind="stable") if sort_by in self.means else self.means
        )

    def table(self) -> Table:
        """Return a row per model and a column per group, the best on one group first."""
        of_vjm = self.errors.T[REFERENCE_MODEL]
        sizes = [
            f"{group} {MM * of_vjm[ratios.columns].mean():.3f}"
            for group, ratios in self.ratios.items()
        ]
        return Table.of(
            "3-D error relative to the VJM's on the same data",
            [
                Column("model", "text", value=str),
                *(
                    Column(one, format=".2f", value=partial(self._ratio, one))
                    for one in self.ratios
                ),
            ],
            self._sorted.index,
            [f"3-D error of the VJM [mm]: {', '.join(sizes)}.", *self.study.table_notes],
        )

    def _ratio(self, group: str, model: str) -> Quantity | None:
        """Return mean and deviation over a group's data sets; None without a result."""
        ratios = self.ratios[group].T[model].dropna().tolist()
        if not ratios:
            return None
        return mean_over(ratios) if len(self.study.groups[group]) > 1 else Quantity(ratios[0])

    def agreement(self) -> Table:
        """Return Kendall's tau between the orders of the models on every two compared groups."""
        taus = self.orders.corr(method="kendall")
        names = list(map(str, taus))
        return Table(
            title=f"Kendall's tau between the orders of {len(self.orders)} models",
            columns=[Column("twin", "text"), *(Column(name, format=".2f") for name in names)],
            rows=[[name, *row] for name, row in zip(names, taus.to_numpy().tolist(), strict=True)],
            notes=["1: the same order; 0: unrelated; -1: the other way round."],
        )

    def figure(self) -> Prepared:
        """Return the picture of `table`: mean ratios as a heat table."""
        title = "3-D error relative to the VJM's"
        return Prepared(title, self.study.caption, partial(heat_table, self._sorted))


def heat_table(ratios: pd.DataFrame) -> Figure:
    """Draw ratios to the VJM's error, a row per model and a column per group, coloured around 1."""
    figure = style.new_figure(style.PAGE_INCH, FRAME_INCH + ROW_INCH * len(ratios))
    axes, logarithms = figure.subplots(), ratios.map(np.log)
    reach = np.log(MOST_RATIO)
    cells: dict[str, Any] = {"cmap": COLORS, "vmin": -reach, "vmax": reach, "cbar": False}
    seaborn.heatmap(logarithms, ax=axes, annot=ratios, fmt=".2f", linewidths=1.0, **cells)
    cell_colors = to_rgba_array(axes.collections[0].get_facecolor())[
        ratios.notna().to_numpy().ravel()
    ]
    for number, color in zip(axes.texts, cell_colors, strict=True):
        is_light = relative_luminance(color) > LIGHT
        number.set_color("black" if is_light else "white")
    names = [style.short(str(name)) for name in ratios.index]
    axes.set_yticks(np.arange(len(names)) + 0.5, names, rotation=0)
    axes.set(xlabel="", ylabel="")
    axes.tick_params(length=0.0, labelrotation=0, labeltop=True, labelbottom=False)
    bar = figure.colorbar(axes.collections[0], ax=axes, extend="both", aspect=25, pad=0.02)
    bar.set_label("3-D error / VJM's")
    bar.set_ticks([*np.log(STEPS)], labels=[f"{step:g}" for step in STEPS])
    return figure
