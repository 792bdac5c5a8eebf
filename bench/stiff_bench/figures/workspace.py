"""Errors over the workspace: how large they are where the TCP is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.robot_picture import arm_points
from stiff_bench.store.database import read_data
from stiff_bench.tables.metric_table import pooled_prediction
from stiff_bench.tables.units import MM, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.metrics import norm_errors

MOST_MODELS = 2
VIEWS_INCH = 4.6
_MANY = 400  # points beyond which they are drawn smaller, and as pixels
TOP_SHARE = 0.95
"""Of all errors lie below the end of the colours: one outlier would leave the others one colour."""


ARM_COLOR = "0.5"
DIFFERENCES = LinearSegmentedColormap.from_list(
    "better to worse", [style.COLORS[0], "0.93", style.COLORS[1]]
)


def workspace_figure(
    place: FloatArray,
    errors: Mapping[str, FloatArray],
    reference: FloatArray | None,
    arm: FloatArray,
) -> Figure:
    """Draw errors of models, and their differences to the VJM's, from the side and from above.

    Args:
        place: (n, 3) unloaded TCP of each pose, m, base frame.
        errors: model -> (n,) length of its error, m.
        reference: (n,) the VJM's, m; None: without differences.
        arm: (n_joints + 2, 3) base, joints and TCP of the arm at one of the poses, m.
    """
    everything = MM * np.concatenate([*errors.values()])
    top = float(np.quantile(everything, TOP_SHARE)) or 1e-6
    columns = [(name, MM * error, False) for name, error in errors.items()]
    if reference is not None:
        columns += [
            (f"{name} − {REFERENCE_MODEL}", MM * (error - reference), True)  # noqa: RUF001
            for name, error in errors.items()
            if name != REFERENCE_MODEL
        ]
    differences = [np.abs(values) for _, values, is_difference in columns if is_difference]
    most = float(np.quantile(np.concatenate(differences), TOP_SHARE)) if differences else 0.0
    scales = {False: Normalize(0.0, top), True: Normalize(-(most or 1e-6), most or 1e-6)}
    width = style.COLUMN_INCH if len(columns) == 1 else style.PAGE_INCH * max(1, len(columns) / 4)
    figure = style.new_figure(width, VIEWS_INCH)
    grid = figure.subplots(2, len(columns), squeeze=False)
    drawn: dict[bool, tuple[Any, list[Axes]]] = {}
    for (name, values, is_difference), panels in zip(columns, grid.T, strict=True):
        colors: dict[str, Any] = {"norm": scales[is_difference]}
        colors["cmap"] = DIFFERENCES if is_difference else "viridis_r"
        points = _draw_views(panels, place, values, arm, colors)
        drawn.setdefault(is_difference, (points, []))[1].extend(panels)
        panels[0].set_title(f"{style.short(name, style.PANEL_LETTERS)}\nfrom the side", loc="left")
        panels[1].set_title("from above", loc="left")
        panels[0].set_xlabel("distance from z axis [m]")
        panels[1].set_xlabel("x [m]")
    for axes in grid[:, 1:].flat:  # the same poses, and so the same limits as on the left
        axes.tick_params(labelleft=False)
    grid[0, 0].set_ylabel("z [m]")
    grid[1, 0].set_ylabel("y [m]")
    style.name_panels(list(grid.flat))
    labels = {False: "3-D error [mm]", True: f"difference to {REFERENCE_MODEL} [mm], blue: better"}
    for is_difference, (points, panels) in drawn.items():
        extend: Any = "both" if is_difference else "max"
        look: dict[str, Any] = {"location": "bottom", "shrink": 0.9, "aspect": 30, "pad": 0.02}
        bar = figure.colorbar(points, ax=panels, extend=extend, **look)
        bar.set_label(labels[is_difference])
        bar.outline.set_visible(False)
        bar.ax.locator_params(nbins=5)
    return figure


def _draw_views(
    panels: Sequence[Axes],
    place: FloatArray,
    values: FloatArray,
    arm: FloatArray,
    colors: Mapping[str, Any],
) -> Any:
    """Draw the arm, and (n,) values at (n, 3) places, from the side and from above."""
    order = np.argsort(np.abs(values), kind="stable")  # the largest are drawn last, on top
    is_dense = len(values) > _MANY
    look: dict[str, Any] = {"s": 4.0 if is_dense else 11.0, "edgecolors": "0.3"}
    look |= {"linewidths": 0.0 if is_dense else 0.25, "rasterized": is_dense, "zorder": 3.0}
    for axes, (x, y), joints in zip(panels, _views(place[order]), _views(arm), strict=True):
        line: dict[str, Any] = {"color": ARM_COLOR, "linewidth": 2.0, "solid_capstyle": "round"}
        axes.plot(*joints, "-", **line, marker="o", ms=3.0, mfc="white", zorder=2.0)
        drawn = axes.scatter(x, y, c=values[order], **colors, **look)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.1)
        axes.locator_params(nbins=5)
    return drawn


def _views(points: FloatArray) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return across and up of (n, 3) points, m, from the side and from above."""
    x, y, z = points.T
    return (np.hypot(x, y), z), (x, y)


def workspace(source: FigureSource) -> Prepared:
    """Show the 3-D error of each model at the TCP positions, and its difference to the VJM's."""
    compared = source.compared(MOST_MODELS)
    stored = read_data(source.folder, compared.case.name.data_sha256)
    _, pose = np.unique(stored.samples.pose_id, return_inverse=True)
    if compared.case.has_paths:
        pose = np.arange(len(pose))  # a path is many places
    tested = compared.tested
    case, slots = compared.case, compared.slots
    linear = case.competitors.get(REFERENCE_MODEL)
    if REFERENCE_MODEL not in tested and linear and set(slots) <= linear.done.keys():
        tested[REFERENCE_MODEL] = pooled_prediction(case.results(REFERENCE_MODEL, slots))
    by_row = {
        name: pd.Series(norm_errors(one)).groupby(one.rows).mean() for name, one in tested.items()
    }
    rows = by_row[compared.models[0]].index.to_numpy()
    errors = {name: one.groupby(pose[rows]).mean().to_numpy() for name, one in by_row.items()}
    first = rows[np.unique(pose[rows], return_index=True)[1]]
    q = stored.samples.q[first]
    middle = int(np.linalg.norm(q - np.median(q, axis=0), axis=1).argmin())
    (arm,) = arm_points(stored.robot, q[[middle]])
    reference = errors.get(REFERENCE_MODEL)
    about = f" Difference: its error less that of {REFERENCE_MODEL}; blue is better, orange worse."
    caption = (
        "3-D error, mean over loads and splits, at the TCP positions of the "
        f"{len(first)} tested poses, base frame; the colour scale ends at the "
        f"{percent(TOP_SHARE)} quantile.{about * (reference is not None)} Grey: the arm at the "
        f"tested pose nearest to their median. {compared.setting}"
    )
    shown = {name: errors[name] for name in compared.models}
    paint = partial(workspace_figure, stored.tcp[first], shown, reference, arm)
    return Prepared("Error over the workspace", caption, paint, compared.subtitle)
