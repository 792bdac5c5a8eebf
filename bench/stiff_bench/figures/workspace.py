"""Errors over the workspace: error by TCP position, and difference to the VJM."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.robot_picture import arm_points
from stiff_bench.store.database import read_data
from stiff_bench.tables.units import MM, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.types import FloatArray, Prediction
from stiff_protocols.scoring.metrics import norm_errors

MOST_MODELS = 2
VIEWS_INCH = 4.3
_MANY = 400  # larger numbers of points are drawn smaller and rasterised
TOP_SHARE = 0.95
"""Share of errors below the end of the colour scale, so that outliers do not dominate it."""
ARM_COLOR = "0.55"
DIFFERENCES = "RdBu_r"
"""Colours of differences: blue below zero, red above."""


@dataclass(frozen=True, eq=False)
class WorkspaceErrors:
    """One model's errors by pose.

    Attributes:
        place: (n, 3) unloaded TCP, m, base frame.
        error: (n,) length of the error, m.
        gain: (n,) error minus the VJM's error, m; None: the model is the VJM, or unknown.
    """

    place: FloatArray
    error: FloatArray
    gain: FloatArray | None


def workspace_figure(models: Mapping[str, WorkspaceErrors], arm: FloatArray) -> Figure:
    """Draw errors as colours at the poses, from the side and from above.

    Columns on the right show the difference to the VJM, on a scale with zero in the middle.

    Args:
        models: name -> errors; at least one.
        arm: (n, 3) base, joints and TCP at one of the poses, m, base frame.
    """
    gains = {
        name: model_errors.gain * MM
        for name, model_errors in models.items()
        if model_errors.gain is not None
    }
    everything = np.concatenate([model_errors.error for model_errors in models.values()]) * MM
    scale = Normalize(0.0, float(np.quantile(everything, TOP_SHARE)) or 1e-6)
    n_columns = len(models) + len(gains)
    width = style.COLUMN_INCH if n_columns == 1 else style.PAGE_INCH
    figure = style.new_figure(width, VIEWS_INCH)
    grid = figure.subplots(2, n_columns, squeeze=False)
    errors, differences = grid[:, : len(models)], grid[:, len(models) :]
    for (name, model_errors), views in zip(models.items(), errors.T, strict=True):
        points = _draw(
            views, model_errors.place, model_errors.error * MM, arm, cmap="viridis_r", norm=scale
        )
        _title(views, style.short(name, style.PANEL_LETTERS))
    _color_bar(figure, points, errors, "3-D error [mm]", "max")
    if gains:
        reach = float(np.quantile(np.abs(np.concatenate([*gains.values()])), TOP_SHARE)) or 1e-6
        for (name, gain), views in zip(gains.items(), differences.T, strict=True):
            norm = Normalize(-reach, reach)
            points = _draw(views, models[name].place, gain, arm, cmap=DIFFERENCES, norm=norm)
            _title(views, f"{style.short(name, style.PANEL_LETTERS - 6)} − VJM")  # noqa: RUF001
        _color_bar(figure, points, differences, "difference [mm]; blue: better", "both")
    for axes in grid[:, 1:].flat:  # the same poses, and so the same limits as on the left
        axes.tick_params(labelleft=False)
    grid[0, 0].set_ylabel("z [m]")
    grid[1, 0].set_ylabel("y [m]")
    style.name_panels(list(grid.flat))
    return figure


def _draw(
    views: Sequence[Axes], place: FloatArray, value: FloatArray, arm: FloatArray, **colors: Any
) -> Any:
    """Draw (n,) values at (n, 3) places, with the arm, in two views."""
    order = np.argsort(np.abs(value), kind="stable")  # the largest are drawn last, on top
    many = len(value) > _MANY
    size, edge = (4.0, 0.0) if many else (11.0, 0.25)
    look: dict[str, Any] = {"s": size, "edgecolors": "0.3", "linewidths": edge, **colors}
    link: dict[str, Any] = {"color": ARM_COLOR, "linewidth": 2.5, "zorder": 1.0}
    for axes, view in zip(views, (_from_the_side, _from_above), strict=True):
        axes.plot(*view(arm), **link, solid_capstyle="round", solid_joinstyle="round")
        points = axes.scatter(*view(place[order]), c=value[order], **look, rasterized=many)
        axes.set_aspect("equal", adjustable="datalim")
        axes.locator_params(nbins=5)
    return points


def _from_the_side(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    x, y, z = points.T
    return np.hypot(x, y), z


def _from_above(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    x, y, _ = points.T
    return x, y


def _title(views: Sequence[Axes], name: str) -> None:
    side, above = views
    side.set_title(f"{name}\nfrom the side", loc="left")
    side.set_xlabel("distance from z axis [m]")
    above.set_title("from above", loc="left")
    above.set_xlabel("x [m]")


def _color_bar(figure: Figure, points: Any, panels: Any, label: str, extend: Any) -> None:
    place: dict[str, Any] = {"location": "bottom", "shrink": 0.7, "aspect": 30}
    bar = figure.colorbar(points, ax=list(panels.flat), extend=extend, **place)
    bar.set_label(label)
    bar.outline.set_visible(False)


def workspace(source: FigureSource) -> Prepared:
    """Show the 3-D error of each model at the TCP positions, and its difference to the VJM."""
    compared = source.compared(MOST_MODELS)
    stored = read_data(source.folder, compared.task.name.data_sha256)
    _, pose = np.unique(stored.samples.pose_id, return_inverse=True)
    if compared.task.has_paths:
        pose = np.arange(len(pose))  # a path is many places
    models: dict[str, WorkspaceErrors] = {}
    for name, tested in compared.tested.items():
        columns = {"error": norm_errors(tested)}
        if name != REFERENCE_MODEL and tested.reference is not None:
            columns["gain"] = columns["error"] - _reference_errors(tested)
        by_row = pd.DataFrame(columns).groupby(tested.rows).mean()
        rows = by_row.index.to_numpy()
        by_pose = by_row.groupby(pose[rows]).mean()
        _, first = np.unique(pose[rows], return_index=True)
        gain = by_pose["gain"].to_numpy() if "gain" in by_pose else None
        models[name] = WorkspaceErrors(stored.tcp[rows[first]], by_pose["error"].to_numpy(), gain)
    place = next(iter(models.values())).place
    middle = np.linalg.norm(stored.tcp - np.median(place, axis=0), axis=1).argmin()
    arm = arm_points(stored.robot, stored.samples.q[middle : middle + 1])[0]
    caption = (
        f"3-D error, mean over loads and splits, at the TCP positions of the {len(place)} tested "
        f"poses, base frame, and its difference to the VJM's. The colour scales end at the "
        f"{percent(TOP_SHARE)} quantile. Grey: the arm at one of the poses. {compared.setting}"
    )
    paint = partial(workspace_figure, models, arm)
    return Prepared("Error over the workspace", caption, paint, compared.subtitle)


def _reference_errors(tested: Prediction) -> FloatArray:
    """Return the (n,) length of the VJM's error, m."""
    return np.asarray(np.linalg.norm(np.asarray(tested.reference) - tested.measured, axis=1))
