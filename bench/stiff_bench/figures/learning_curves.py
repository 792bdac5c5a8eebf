"""Learning curves: how a model's error falls with the number of measured poses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from stiff_bench.collected import Contest
from stiff_bench.contest_choice import presentation
from stiff_bench.figures.figure_line import Content
from stiff_bench.figures.figure_source import REFERENCE, FigureSource, mean_length
from stiff_bench.figures.journal_style import (
    COLUMN_INCH,
    PAGE_INCH,
    Look,
    looks,
    name_panels,
    new_figure,
    short,
)
from stiff_bench.figures.log_axes import plain_numbers
from stiff_bench.grouped import grouped
from stiff_bench.same_robot import family_of
from stiff_bench.units import MM
from stiff_bench.words import counted
from stiff_protocols.errors import StoreError
from stiff_protocols.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEVEL = 0.95
FEWEST_FOR_INTERVAL = 3
LEAST = 1e-12  # m: an error of nothing has no place on a logarithmic axis
MOST_MODELS = 5
N_COLUMNS = 3
PANEL_INCH, LEGEND_LINE_INCH = 2.2, 0.17
_SIZE = re.compile(r"n = (\d+)")
_NEEDS = (
    f"learning curves; `bench run --protocol sample-efficiency --model {REFERENCE} ...` makes them"
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
    handles: dict[str, Any] = {}
    for axes in grid:
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=n_columns
    )
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
    found = _SIZE.fullmatch(contest.name.condition)
    return int(found.group(1)) if found else 0


def gather(source: FigureSource) -> Content:
    """Take the models that have every size on every data set of a robot type."""
    contests = [one for one in source.contests if size_of(one) and _n_done(one)]
    if not contests:
        raise StoreError(f"--results {source.folder}: no result of {_NEEDS}")
    protocol = max(contests, key=lambda one: one.newest_run).name.protocol
    of_protocol = [one for one in contests if one.name.protocol == protocol]
    families = grouped(of_protocol, lambda one: family_of(one.name.dataset))
    models = _chosen(source, families)
    panels = {
        f"{family} ({presentation(members[0]).kind})": curves
        for family, members in sorted(families.items())
        if (curves := [curve for name in models for curve in _curve(name, members)])
    }
    if not panels:
        raise StoreError(
            f"--results {source.folder}: no model has a result of every size on a data set"
        )
    n_all = len(source.names(of_protocol))
    shown = "" if len(models) == n_all else f" Shown: {len(models)} of {n_all} models."
    return Content(_caption(panels, of_protocol) + shown, partial(learning_figure, panels))


def _n_done(contest: Contest) -> int:
    return sum(bool(one.done) for one in contest.competitors.values())


def _chosen(source: FigureSource, families: Mapping[str, Sequence[Contest]]) -> list[str]:
    """Return the models asked for, or the best at the largest sizes with the linear one."""
    names = source.names([one for members in families.values() for one in members])
    if source.models:
        return names
    curves = {name: [c for m in families.values() for c in _curve(name, m)] for name in names}
    most = max(map(len, curves.values()), default=0)
    last = {
        name: float(np.mean([np.log(curve.errors[-1]).mean() for curve in found]))
        for name, found in curves.items()
        if found and len(found) == most
    }
    best = sorted(last, key=lambda name: last[name])[:MOST_MODELS]
    if REFERENCE in last and REFERENCE not in best:
        best[-1:] = [REFERENCE]
    return best


def _curve(name: str, contests: Sequence[Contest]) -> list[LearningCurve]:
    """Return a model's curve over the data sets on which it has every size; [] for none."""
    sizes = sorted({size_of(one) for one in contests})
    columns = []
    for of_dataset in grouped(contests, lambda one: one.name.dataset).values():
        done = {
            size_of(one): mean_length(one.results(name))
            for one in of_dataset
            if name in one.competitors and one.competitors[name].done
        }
        if len(done) == len(sizes):
            columns.append([done[size] for size in sizes])
    return [LearningCurve(name, np.array(sizes), np.array(columns).T)] if columns else []


def _caption(panels: Mapping[str, Sequence[LearningCurve]], contests: Sequence[Contest]) -> str:
    n_sets = ", ".join(
        f"{title}: {counted(max(c.errors.shape[1] for c in curves), 'data set')}"
        for title, curves in panels.items()
    )
    n_splits = max(len(one.slots) for one in contests)
    seeds = ", ".join(str(seed) for seed in sorted({one.name.seed for one in contests}))
    name = contests[0].name.protocol
    return (
        "Mean length of the error on the same test poses against the number of measured poses that "
        f"a model is given, poses that choose an epoch included ({name}, "
        f"{counted(n_splits, 'draw')} a size and data set, seed {seeds}). Lines: geometric mean "
        f"over the data sets of a robot type ({n_sets}); bands: {LEVEL:.0%} interval of that mean "
        f"(Student's t, of logarithms), where there are at least {FEWEST_FOR_INTERVAL}."
    )
