"""Learning curves: how a model's error falls with the number of measured poses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import stats

from stiff_bench.analysis.collected import Contest
from stiff_bench.analysis.leaderboard import presentation
from stiff_bench.analysis.same_robot import family_of
from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import FigureSource, between, marks_in, mean_length, with_linear
from stiff_bench.figures.style import (
    COLUMN_INCH,
    PAGE_INCH,
    Look,
    looks,
    name_panels,
    new_figure,
    plain_numbers,
    share_legend,
    short,
)
from stiff_bench.store.names import grouped
from stiff_bench.tables.units import MM, counted
from stiff_models.catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.splits.sample_efficiency import condition_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEVEL = 0.95
FEWEST_FOR_INTERVAL = 3
LEAST = 1e-12  # m: an error of nothing has no place on a logarithmic axis
MOST_MODELS = 5
N_COLUMNS = 3
PANEL_INCH, LEGEND_LINE_INCH = 2.2, 0.17
_NEEDS = (
    "learning curves; `bench run --protocol sample-efficiency --model "
    f"{REFERENCE_MODEL} ...` makes them"
)


@dataclass(frozen=True, eq=False)
class LearningCurve:
    """One model on the data sets of one robot type.

    Attributes:
        name: of the model.
        sizes: (m,) measured poses, ascending.
        errors: (m, n_datasets) mean length of the error, m.
    """

    name: str
    sizes: FloatArray
    errors: FloatArray

    def interval(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return centre, low and high over the data sets, each (m,) m.

        The centre is the geometric mean, the interval Student's of the errors' logarithms: it
        stays above zero, and is as wide upwards as downwards on a logarithmic axis. With fewer
        than three data sets it is NaN.
        """
        logs = np.log(np.maximum(self.errors, LEAST))
        centre, n = logs.mean(axis=1), logs.shape[1]
        reach = np.full_like(centre, np.nan)
        if n >= FEWEST_FOR_INTERVAL:
            quantile = stats.t.ppf((1.0 + LEVEL) / 2.0, n - 1)
            reach = quantile * logs.std(axis=1, ddof=1) / np.sqrt(n)
        return np.exp(centre), np.exp(centre - reach), np.exp(centre + reach)


def learning_figure(panels: Mapping[str, Sequence[LearningCurve]]) -> Figure:
    """Draw a panel for each kind of data: error against measured poses, both logarithmic."""
    names = list(dict.fromkeys(curve.name for curves in panels.values() for curve in curves))
    look = dict(zip(names, looks(len(names)), strict=True))
    wide = len(panels) > 1
    n_columns = N_COLUMNS if wide else 2
    n_rows = -(-len(panels) // N_COLUMNS)
    height = PANEL_INCH * n_rows + LEGEND_LINE_INCH * -(-len(names) // n_columns)
    figure = new_figure(PAGE_INCH if wide else COLUMN_INCH, height)
    cells = list(figure.subplots(n_rows, min(len(panels), N_COLUMNS), squeeze=False).flat)
    grid = cells[: len(panels)]
    for axes in cells[len(panels) :]:
        axes.set_axis_off()
    for axes, (title, curves) in zip(grid, panels.items(), strict=True):
        for curve in curves:
            _draw(axes, curve, look[curve.name])
        _frame(axes, curves, short(title))
    for axes in grid[::N_COLUMNS]:
        axes.set_ylabel("mean error length [mm]")
    if wide:
        name_panels(grid)
    share_legend(figure, grid, below=True, ncols=n_columns)
    return figure


def _draw(axes: Axes, curve: LearningCurve, look: Look) -> None:
    centre, low, high = curve.interval()
    axes.fill_between(curve.sizes, low * MM, high * MM, color=look.color, alpha=0.15, linewidth=0)
    axes.plot(
        *(curve.sizes, centre * MM),
        **look.connected(),
        marker=look.marker,
        label=short(curve.name),
    )


def _frame(axes: Axes, curves: Sequence[LearningCurve], title: str) -> None:
    from matplotlib.ticker import NullLocator

    sizes = sorted({int(size) for curve in curves for size in curve.sizes})
    axes.set(xscale="log", yscale="log", xlabel="measured poses")
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.xaxis.set_minor_locator(NullLocator())
    plain_numbers(axes.yaxis)
    axes.set_title(title, loc="left")


def size_of(contest: Contest) -> int:
    """Return how many measured poses a contest's condition gives; 0: it varies another thing."""
    results = [one for name in contest.competitors for one in contest.results(name)]
    n_most = max((one.n_train for one in results), default=0)
    sizes = range(1, n_most + 1)  # no pose has less than one row
    return next((size for size in sizes if condition_of(size) == contest.name.condition), 0)


def errors_of(names: Sequence[str], contests: Sequence[Contest]) -> pd.DataFrame:
    """Return the mean error lengths [m] of models on the data sets of one robot type.

    Returns:
        A row for each model and data set (its name, with seed and hash) on which it has every draw
        of every size, a column for each size.
    """
    found = [
        (name, replace(contest.name, condition=""), size_of(contest), mean_length(results))
        for contest in contests
        for name in names
        if (results := contest.results_of_all_slots(name))
    ]
    table = pd.DataFrame(found, columns=["model", "data set", "size", "error"])
    sizes = sorted({size_of(one) for one in contests})
    by_size = table.pivot(index=["model", "data set"], columns="size", values="error")
    return by_size.reindex(columns=sizes).dropna()


def curves_of(errors: pd.DataFrame, models: Sequence[str]) -> list[LearningCurve]:
    """Return the models' curves, over the data sets that all have that have any."""
    of_model = {name: errors.xs(name) for name in models if name in errors.index.unique("model")}
    shared = set.intersection(*(set(of.index) for of in of_model.values())) if of_model else set()
    return [
        LearningCurve(name, of.columns.to_numpy(), of.loc[sorted(shared)].to_numpy().T)
        for name, of in of_model.items()
        if shared
    ]


def gather(source: FigureSource) -> Content:
    """Take the models that have every draw of every size on the data sets of a robot type."""
    contests = [one for one in source.newest if size_of(one) and _n_done(one)]
    if not contests:
        raise StoreError(f"--results {source.folder}: no result of {_NEEDS}")
    protocol = max(contests, key=lambda one: one.newest_run).name.protocol
    of_protocol = [one for one in contests if one.name.protocol == protocol]
    names = source.names(of_protocol)
    families = {
        f"{family} ({presentation(members[0]).kind})": errors_of(names, members)
        for family, members in sorted(grouped(of_protocol, lambda one: family_of(one.name)).items())
    }
    models = names if source.models else _best(families.values())
    panels = {
        title: curves for title, one in families.items() if (curves := curves_of(one, models))
    }
    if not panels:
        raise StoreError(
            f"--results {source.folder}: no data set on which {', '.join(models) or 'any model'} "
            f"has every draw of every size of {protocol}; the `bench run` that made them goes on"
        )
    caption = f"{_caption(panels, of_protocol)} {_choice(panels, names, asked=bool(source.models))}"
    return Content(caption.strip(), partial(learning_figure, panels))


def _n_done(contest: Contest) -> int:
    return sum(bool(one.done) for one in contest.competitors.values())


def _best(families: Iterable[pd.DataFrame]) -> list[str]:
    """Return the best at the largest sizes, of the models with most data sets, and the linear."""
    found = [errors for errors in families if len(errors)]
    if not found:
        return []
    last = [np.log(errors.iloc[:, -1].clip(lower=LEAST)).groupby("model") for errors in found]
    n_sets = pd.concat([of.size() for of in last], axis=1).sum(axis=1)
    mean = pd.concat([of.mean() for of in last], axis=1).mean(axis=1)
    return with_linear(list(mean[n_sets == n_sets.max()].sort_values().index), MOST_MODELS)


def _choice(
    panels: Mapping[str, Sequence[LearningCurve]], names: Sequence[str], *, asked: bool
) -> str:
    """Say which models are shown, where there are more."""
    shown = {curve.name for curves in panels.values() for curve in curves}
    others = [name for name in names if name not in shown]
    if not others:
        return ""
    if asked:
        return f"Without every draw of every size: {', '.join(others)}."
    linear = f", {REFERENCE_MODEL} in any case" * (REFERENCE_MODEL in shown)
    return (
        f"Shown: {len(shown)} of {len(names)} models: of those with most data sets, the best at "
        f"the largest size{linear}."
    )


def _caption(panels: Mapping[str, Sequence[LearningCurve]], contests: Sequence[Contest]) -> str:
    n_sets = ", ".join(
        f"{title}: {counted(curves[0].errors.shape[1], 'data set')}"
        for title, curves in panels.items()
    )
    shown = {curve.name for curves in panels.values() for curve in curves}
    said = marks_in(contests, shown)
    n_draws = between([len(one.slots) for one in contests], "draw")
    seeds = ", ".join(str(seed) for seed in sorted({one.name.seed for one in contests}))
    return (
        "Mean length of the error on the same test poses against the number of measured poses that "
        f"a model is given, poses that choose an epoch included ({contests[0].name.protocol}, "
        f"{n_draws} a size and data set, seed {seeds}). Lines: geometric mean over the data sets "
        f"of a robot type ({n_sets}); bands: {LEVEL:.0%} interval of that mean (Student's t, of "
        f"logarithms), where there are at least {FEWEST_FOR_INTERVAL}.{said}"
    )
