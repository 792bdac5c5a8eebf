"""Errors of models relative to the VJM's: table, picture, and how far the models' orders agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.leaderboard import of_newest_data
from stiff_bench.figures import style
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.paper.study_file import Study
from stiff_bench.tables.metric_table import mean_over
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import MM
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.types import KNOWN

_LOWER_BOUNDS = list(KNOWN.values())
"""Rows of what a simulation knows of its own data: no models."""


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

    def table(self) -> Table:
        """Return a row per model and a column per group, the best on one group first."""
        sort_by, of_vjm, models = self.study.sort_by, self.errors.T[REFERENCE_MODEL], self.means
        if sort_by in models:
            models = models.sort_values(sort_by, kind="stable")
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
            models.index,
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
        """Return the picture of `table`.

        Raises:
            ConfigError: the study has no `steps` or no `orders`.
        """
        if not self.study.steps or not self.study.orders:
            raise ConfigError("the figure needs steps and orders in the study's file")
        title = "3-D error relative to the VJM's"
        return Prepared(title, self.study.caption, partial(_draw, self))


def _draw(errors: RelativeErrors) -> Figure:
    """Draw the groups that are steps, with lines between them, and those whose orders compare."""
    study, means = errors.study, errors.means
    steps = [group for group in study.steps if group in means]
    orders = {group: name for group, name in study.orders.items() if group in means}
    figure = style.new_figure(style.PAGE_INCH, 3.6)
    widths = [len(study.steps), len(study.orders)]
    panels = figure.subplots(1, 2, sharey=True, width_ratios=widths)
    _draw_groups(panels[0], errors, steps, joined=True)
    _draw_groups(panels[1], errors, [*orders], joined=False)
    panels[1].set_xticks(range(len(orders)), orders.values())
    panels[0].set_ylabel("3-D error / VJM's")
    style.name_panels(panels)
    style.share_legend(figure, reversed(panels), ncols=4)
    return figure


def _draw_groups(
    axes: Axes, errors: RelativeErrors, groups: Sequence[str], *, joined: bool
) -> None:
    """Draw the mean of each group of each model, with its deviation over the data sets."""
    looks = style.looks_of(name for name in errors.means.index if name not in _LOWER_BOUNDS)
    for model in errors.means.index:
        mean = errors.means.loc[model, groups].dropna()
        x = [groups.index(group) for group in mean.index]
        if model in _LOWER_BOUNDS:
            line = ":" if model == KNOWN["noise"] else "--"
            axes.plot(x, mean, line if joined else "_", color=style.REFERENCE_COLOR, label=model)
            continue
        look = looks[model]
        drawn = look.connected() | {"marker": look.marker} if joined else look.points()
        spread = [errors.ratios[group].loc[model].std() for group in mean.index]
        axes.errorbar(x, mean, np.nan_to_num(spread), capsize=1.5, label=model, **drawn)
    axes.set_xticks(range(len(groups)), groups)
    axes.set_yscale("log")
    style.plain_numbers(axes.yaxis)
