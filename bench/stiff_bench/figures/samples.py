"""Predictions and errors of the test samples: their means, and one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.store.database import read_data
from stiff_bench.tables.units import MM, percent
from stiff_protocols.contract.types import AXES, Prediction
from stiff_protocols.scoring.bootstrap import pose_errors, resampled_means
from stiff_protocols.scoring.metrics import absolute_errors, norm_errors
from stiff_protocols.scoring.paired import LEVEL

MOST_MODELS = 3
SHARE = 0.95
LINES_NOTE = (
    f"Grey: identity; coloured: identity ± {percent(SHARE)} quantile of the absolute error."
)
ROW_INCH, ERRORS_INCH = 2.8, 4.95
MARGIN = 0.05  # of the span, at each end
_MANY = 400  # points beyond which they are drawn smaller, and as pixels


def regression_figure(
    models: Mapping[str, Prediction], published: Mapping[str, Sequence[float]] | None = None
) -> Figure:
    """Draw a row of three panels a model; at least one model, of at least one sample.

    `published` has mean absolute errors along x, y and z that the paper gives of models, m.
    """
    figure = style.new_figure(style.PAGE_INCH, ROW_INCH * len(models))
    grid = figure.subplots(len(models), 3, squeeze=False)
    values = np.concatenate([(one.measured, one.predicted) for one in models.values()], axis=1)
    low, high = MM * values.min(axis=(0, 1)), MM * values.max(axis=(0, 1))
    margin = MARGIN * (high - low) + 1e-9
    limits = np.stack([low - margin, high + margin], axis=1)  # (3, 2)
    for name, look, row in zip(models, style.looks(len(models)), grid, strict=True):
        of_paper = (published or {}).get(name, ())
        for axis, axes in enumerate(row):
            heading = f"d{AXES[axis]}, {style.short(name, style.PANEL_LETTERS)}"
            mae = _draw_axis(axes, models[name], axis, look)
            paper = f" (paper {of_paper[axis] * MM:.3f})" if of_paper else ""
            axes.set_title(f"{heading}\nMAE {mae:.3f} mm{paper}", loc="left")
            axes.set(xlim=limits[axis], ylim=limits[axis], aspect="equal")
            axes.locator_params(nbins=5)
    style.name_panels(list(grid.flat))
    return figure


def _draw_axis(axes: Axes, tested: Prediction, axis: int, look: style.Look) -> float:
    """Draw predicted against true deflection along an axis; return the MAE, mm."""
    x, y = tested.measured[:, axis] * MM, tested.predicted[:, axis] * MM
    error = absolute_errors(tested)[:, axis] * MM
    half = float(np.quantile(error, SHARE))
    axes.axline((0.0, 0.0), slope=1.0, color=style.REFERENCE_COLOR, linewidth=0.8, zorder=1.5)
    for offset in (half, -half):
        axes.axline((0.0, offset), slope=1.0, **look.connected(), linewidth=0.7)
    size, dense = 3.4 if len(x) < _MANY else 2.4, len(x) > 10 * _MANY
    axes.plot(x, y, **look.points(), ms=size, alpha=0.65, mew=0.0, rasterized=dense)
    name = AXES[axis]
    axes.set(xlabel=f"deflection d{name} [mm]", ylabel=f"predicted d{name} [mm]")
    return float(error.mean())


def regression(source: FigureSource) -> Prepared:
    """Show predicted against true deflection, one panel per axis."""
    compared = source.compared(MOST_MODELS)
    tested = compared.tested
    n_rows = len(tested[compared.models[0]].rows)
    caption = (
        "Predicted against true deflection of the TCP, base frame, of the "
        f"{n_rows} test samples of all splits together. {compared.setting} {LINES_NOTE}"
    )
    title = "Predicted against true deflection"
    return Prepared(title, caption, partial(regression_figure, tested), compared.subtitle)


def errors_by_row(tested: Prediction) -> pd.DataFrame:
    """Return the mean absolute error [m] of each row of the data set, a column an axis."""
    return pd.DataFrame(absolute_errors(tested), columns=AXES).groupby(tested.rows).mean()


def errors_figure(models: Mapping[str, pd.DataFrame]) -> Figure:
    """Draw, for each axis, each model's `errors_by_row`, their mean, and their distribution."""
    figure = style.new_figure(style.PAGE_INCH, ERRORS_INCH)
    grid = figure.subplots(3, 2, width_ratios=(2.4, 1.0))
    last = max(1, *(int(errors.index.max()) for errors in models.values()))
    for axis, (by_sample, distribution) in zip(AXES, grid, strict=True):
        for (name, errors), look in zip(models.items(), style.looks(len(models)), strict=True):
            error, dense = errors[axis] * MM, len(errors) > _MANY
            points = look.points() | {"ms": 1.5 if dense else 3.0, "mew": 0.0, "alpha": 0.7}
            label = style.short(name)
            by_sample.plot(errors.index, error, **points, rasterized=dense, label=label)
            by_sample.axhline(float(error.mean()), **look.connected(), linewidth=0.9)
            distribution.ecdf(error, **look.connected())
        by_sample.set(ylabel=f"|error of d{axis}| [mm]", ylim=(0.0, None))
        by_sample.set_xlim(-0.02 * last, 1.02 * last)
        distribution.set(ylabel="share of samples", ylim=(0.0, 1.03), xlim=(0.0, None))
        for axes in (by_sample, distribution):
            axes.set_title(f"d{axis}", loc="left")
        distribution.locator_params(axis="x", nbins=5)
    grid[-1, 0].set_xlabel("sample number")
    grid[-1, 1].set_xlabel("|error| [mm]")
    style.name_panels(list(grid.flat))
    style.share_legend(figure, [grid[0, 0]])
    return figure


def sample_errors(source: FigureSource) -> Prepared:
    """Show the error of every test sample, the mean over the splits that test it."""
    compared = source.compared(MOST_MODELS)
    models = {name: errors_by_row(tested) for name, tested in compared.tested.items()}
    caption = (
        f"Absolute error of each of the {len(models[compared.models[0]])} tested samples, mean "
        "over the splits that test it (left; lines: means), and its cumulative distribution "
        f"(right). {compared.setting}"
    )
    paint = partial(errors_figure, models)
    return Prepared("Error of every test sample", caption, paint, compared.subtitle)


MOST_SCORES = 12
HEAD_INCH, SCORE_INCH = 0.55, 0.17


def scores_figure(errors: pd.DataFrame) -> Figure:
    """Draw a row a model: columns "mean", "low" and "high", m, the best model first."""
    figure = style.new_figure(style.COLUMN_INCH, HEAD_INCH + SCORE_INCH * len(errors))
    axes, found = figure.subplots(), errors * MM
    reach = [found["mean"] - found["low"], found["high"] - found["mean"]]
    look: dict[str, Any] = {"fmt": "o", "color": "black", "capsize": 2.0, "elinewidth": 0.8}
    axes.errorbar(found["mean"], range(len(found)), xerr=reach, **look)
    axes.set_yticks(range(len(found)), [style.short(name) for name in found.index])
    axes.invert_yaxis()
    axes.set(xlabel="mean 3-D error [mm]", xlim=(0.0, None))
    return figure


def mean_errors(source: FigureSource) -> Prepared:
    """Show the mean 3-D error of each model, with 95 % intervals over poses."""
    compared = source.compared(MOST_SCORES)
    pose_id = read_data(source.folder, compared.case.name.data_sha256).samples.pose_id
    tested = compared.tested
    errors_of = np.column_stack([norm_errors(one) for one in tested.values()])  # (n, m) m
    by_pose = pose_errors(pose_id[next(iter(tested.values())).rows], errors_of)
    low, high = np.quantile(resampled_means(by_pose), [LEVEL / 2, 1 - LEVEL / 2], axis=0)
    errors = pd.DataFrame({"mean": by_pose.mean, "low": low, "high": high}, index=[*tested])
    caption = (
        "Mean 3-D error of the test samples of all splits, the best model first; bars: "
        f"{percent(1 - LEVEL)} bootstrap intervals over poses, with the fitted models held fixed. "
        f"{compared.setting}"
    )
    paint = partial(scores_figure, errors.sort_values("mean", kind="stable"))
    return Prepared("Mean error by model", caption, paint, compared.subtitle)
