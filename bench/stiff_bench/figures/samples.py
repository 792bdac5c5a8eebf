"""Errors of test samples: means, distribution, and over true deflection."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import LEAST, NOISE, Compared, FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.store.database import read_data
from stiff_bench.tables.units import MM, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.types import AXES, BOUND_NAMES, FloatArray, Prediction
from stiff_protocols.scoring.bootstrap import pose_errors, resampled_means
from stiff_protocols.scoring.metrics import absolute_errors, norm_errors
from stiff_protocols.scoring.paired import LEVEL

MOST_MODELS = 3
SHARE = 0.95
LINES_NOTE = (
    f"Error: predicted less true deflection. {percent(SHARE)} of the errors of an axis are between "
    "its two coloured lines."
)
MODEL_INCH, DATA_INCH, FRAME_INCH = 1.35, 1.45, 0.45
_MANY = 400  # larger numbers of points are drawn smaller and rasterised


def regression_figure(
    models: Mapping[str, Prediction], published: Mapping[str, Sequence[float]] | None = None
) -> Figure:
    """Draw error over true deflection, a row of three panels per model, all on one scale.

    `published` has mean absolute errors along x, y and z that the paper gives of models, m.
    """
    figure, grid = _error_grid(len(models), MODEL_INCH, sharex="col", sharey=True)
    looks = style.looks_of(models)
    for (name, tested), row in zip(models.items(), grid, strict=True):
        of_paper = (published or {}).get(name, ())
        for axis, axes in enumerate(row):
            mae = _draw_axis(axes, {name: tested}, axis, looks)[name]
            paper = f" (paper {of_paper[axis] * MM:.3f})" if of_paper else ""
            heading = f"d{AXES[axis]}, {style.short(name, style.PANEL_LETTERS)}"
            axes.set_title(f"{heading}\nMAE {mae:.3f} mm{paper}", loc="left")
    style.name_panels(list(grid.flat))
    return figure


def regression_panels(
    data: Sequence[tuple[str, Mapping[str, Prediction]]], names: Sequence[str]
) -> Figure:
    """Draw error over true deflection, a row of three panels per data set, all models in each.

    `data` are titles with predictions by model; `names` are all models, in the order of colours.
    """
    figure, grid = _error_grid(len(data), DATA_INCH, sharex=False, sharey="row")
    looks = style.looks_of(names)
    for (title, models), row in zip(data, grid, strict=True):
        for axis, axes in enumerate(row):
            _draw_axis(axes, models, axis, looks)
            heading = f"{title}\n" * (axis == 0)
            axes.set_title(f"{heading}d{AXES[axis]}", loc="left")
    style.name_panels(list(grid[:, 0]))
    labels = style.short_names(names)
    for name, look in looks.items():
        grid[0, 0].plot([], [], **look.points(), label=labels[name])
    style.share_legend(figure, [grid[0, 0]])
    return figure


def _error_grid(n_rows: int, row_inch: float, **shared: Any) -> tuple[Figure, Any]:
    """Return a figure with rows of three panels, x, y and z; axes are labelled at the edges."""
    figure = style.new_figure(style.PAGE_INCH, FRAME_INCH + row_inch * n_rows)
    grid = figure.subplots(n_rows, 3, squeeze=False, **shared)
    for axes in grid[:, 0]:
        axes.set_ylabel("error [mm]")
    for name, axes in zip(AXES, grid[-1], strict=True):
        axes.set_xlabel(f"true deflection d{name} [mm]")
    for axes in grid.flat:
        axes.axhline(0.0, color=style.REFERENCE_COLOR, linewidth=0.8, zorder=1.5)
        axes.locator_params(nbins=5)
    return figure, grid


def _draw_axis(
    axes: Axes, models: Mapping[str, Prediction], axis: int, looks: Mapping[str, style.Look]
) -> dict[str, float]:
    """Draw the errors of models along an axis, the best on top; return each MAE, mm."""
    mae = {
        name: MM * float(absolute_errors(tested)[:, axis].mean()) for name, tested in models.items()
    }
    for name in sorted(models, key=lambda name: -mae[name]):
        tested, look = models[name], looks[name]
        true = MM * tested.measured[:, axis]
        error = MM * tested.predicted[:, axis] - true
        half = float(np.quantile(np.abs(error), SHARE))
        for height in (half, -half):
            axes.axhline(height, **look.connected(), linewidth=0.8)
        size, is_dense = 3.0 if len(true) < _MANY else 2.0, len(true) > 10 * _MANY
        points = look.points() | {"mec": "white", "mew": 0.25}  # an edge separates close points
        axes.plot(true, error, **points, ms=size, rasterized=is_dense)
    return mae


def regression(source: FigureSource) -> Prepared:
    """Show the error of each sample over its true deflection, a panel per axis."""
    panels = source.panels(MOST_MODELS)
    data = [(title, compared.tested) for title, compared in panels.titled]
    paint = partial(regression_panels, data, panels.models)
    if len(data) == 1:
        paint = partial(regression_figure, data[0][1])
    caption = (
        "Error of each test sample of all splits over the true deflection of the TCP, base frame. "
        f"{LINES_NOTE} {panels.setting}"
    )
    return Prepared("Error over true deflection", caption, paint, panels.subtitle)


MOST_CURVES = 5
PANEL_INCH = 2.1


class ErrorPanel(NamedTuple):
    """A panel of cumulative curves.

    `errors` has each model's (n,) 3-D errors of the tested samples, m, and `noise_floor` their mean
    from the instruments' noise, m; None: not known.
    """

    title: str
    errors: Mapping[str, FloatArray]
    noise_floor: float | None


def errors_by_row(tested: Prediction) -> pd.Series:
    """Return the mean 3-D error [m] of each tested row of the data set."""
    return pd.Series(norm_errors(tested)).groupby(tested.rows).mean()


def errors_figure(panels: Sequence[ErrorPanel], names: Sequence[str]) -> Figure:
    """Draw the share of samples whose 3-D error is below a value, a curve per model."""
    looks, labels = style.looks_of(names), style.short_names(names)
    n_columns, legend = style.legend_layout(labels.values(), len(panels), most=4, n_others=1)
    figure, grid = style.new_panels(len(panels), PANEL_INCH, legend)
    for axes, panel in zip(grid, panels, strict=True):
        for name, errors in panel.errors.items():
            axes.ecdf(MM * errors, **looks[name].connected(), label=labels[name])
        draw_noise_floor(axes.axvline, panel.noise_floor)
        axes.set_title(panel.title, loc="left")
        axes.set(xlabel="3-D error [mm]", xlim=(0.0, None), ylim=(0.0, 1.02))
        axes.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25", "50", "75", "100"])
    style.label_left(grid, "samples below [%]")
    style.name_panels(grid)
    style.share_legend(figure, grid, ncols=n_columns)
    return figure


def draw_noise_floor(line: Any, noise_floor: float | None) -> None:
    """Draw the instruments' noise [m] with a method such as `Axes.axvline`, if it is known."""
    if noise_floor is not None:
        line(MM * noise_floor, color=style.REFERENCE_COLOR, linestyle=":", label=BOUND_NAMES[NOISE])


def sample_errors(source: FigureSource) -> Prepared:
    """Show how many test samples have an error below a value, a curve per model."""
    panels = source.panels(MOST_CURVES)
    errors = [
        ErrorPanel(
            title,
            {name: errors_by_row(tested).to_numpy() for name, tested in compared.tested.items()},
            compared.noise_floor,
        )
        for title, compared in panels.titled
    ]
    caption = (
        "Cumulative distribution of the 3-D error of the tested samples, each the mean over the "
        f"splits that test it.{noise_note(panel.noise_floor for panel in errors)} {panels.setting}"
    )
    paint = partial(errors_figure, errors, panels.models)
    return Prepared("Distribution of the error", caption, paint, panels.subtitle)


def noise_note(noise_floors: Iterable[float | None]) -> str:
    """Return the sentence on `draw_noise_floor`; "" if no panel has a noise floor."""
    if all(floor is None for floor in noise_floors):
        return ""
    return f" Dotted: mean 3-D error from the {BOUND_NAMES[NOISE]}."


MOST_SCORES = 12
HEAD_INCH, SCORE_INCH = 0.6, 0.17


class ScorePanel(NamedTuple):
    """A panel of mean errors.

    `errors` has a row per model with columns "mean", "low" and "high", m. The mean errors of the
    linear model and of the instruments' noise are in m, too; None: not known.
    """

    title: str
    errors: pd.DataFrame
    linear_error: float | None
    noise_floor: float | None


def scores_figure(panels: Sequence[ScorePanel]) -> Figure:
    """Draw a row per model, the best first over all panels: mean 3-D errors with intervals."""
    means = pd.concat([panel.errors["mean"] for panel in panels], axis=1)
    logarithms = np.log(means.clip(lower=LEAST))
    order = (logarithms - logarithms.mean()).mean(axis=1).sort_values(kind="stable").index
    row_inch = HEAD_INCH + SCORE_INCH * len(order)
    figure, grid = style.new_panels(len(panels), row_inch, style.LEGEND_LINE_INCH)
    look: dict[str, Any] = {"fmt": "o", "color": "black", "capsize": 2.0, "elinewidth": 0.8}
    linear: dict[str, Any] = {"color": style.REFERENCE_COLOR, "ls": "--", "label": REFERENCE_MODEL}
    for axes, panel in zip(grid, panels, strict=True):
        errors = MM * panel.errors.reindex(order)
        reach = [errors["mean"] - errors["low"], errors["high"] - errors["mean"]]
        axes.errorbar(errors["mean"], range(len(errors)), xerr=reach, **look)
        if panel.linear_error is not None:
            axes.axvline(MM * panel.linear_error, **linear)
        draw_noise_floor(axes.axvline, panel.noise_floor)
        axes.set_yticks(range(len(order)), style.short_names(order).values())
        axes.set_title(panel.title, loc="left")
        axes.set(xlabel="mean 3-D error [mm]", xlim=(0.0, None), ylim=(len(order) - 0.5, -0.5))
        axes.locator_params(axis="x", nbins=5)
    style.label_left(grid)
    style.name_panels(grid)
    style.share_legend(figure, grid)
    return figure


def mean_errors(source: FigureSource) -> Prepared:
    """Show the mean 3-D error of each model, with 95 % intervals over poses."""
    panels = source.panels(MOST_SCORES)
    scores = [
        ScorePanel(
            title, _score_table(source, compared), compared.linear_error, compared.noise_floor
        )
        for title, compared in panels.titled
    ]
    caption = (
        "Mean 3-D error of the test samples of all splits, the best model first; bars: "
        f"{percent(1 - LEVEL)} bootstrap intervals over poses, with the fitted models held fixed. "
        f"Dashed: {REFERENCE_MODEL}.{noise_note(panel.noise_floor for panel in scores)} "
        f"{panels.setting}"
    )
    return Prepared("Mean error by model", caption, partial(scores_figure, scores), panels.subtitle)


def _score_table(source: FigureSource, compared: Compared) -> pd.DataFrame:
    """Return mean error and interval of each model for a `ScorePanel`."""
    pose_id = read_data(source.folder, compared.task.name.data_sha256).samples.pose_id
    tested = compared.tested
    errors_of = np.column_stack(
        [norm_errors(prediction) for prediction in tested.values()]
    )  # (n, m) m
    by_pose = pose_errors(pose_id[next(iter(tested.values())).rows], errors_of)
    low, high = np.quantile(resampled_means(by_pose), [LEVEL / 2, 1 - LEVEL / 2], axis=0)
    return pd.DataFrame({"mean": by_pose.mean, "low": low, "high": high}, index=[*tested])
