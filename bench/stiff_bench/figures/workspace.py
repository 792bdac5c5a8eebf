"""Errors over the workspace: how large they are where the TCP is."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.store.database import read_data
from stiff_bench.tables.units import MM, percent
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.metrics import norm_errors

MOST_MODELS = 3
VIEWS_INCH = 4.3
_MANY = 400  # points beyond which they are drawn smaller, and as pixels
TOP_SHARE = 0.95
"""Of all errors lie below the end of the colours: one outlier would leave the others one colour."""


WorkspaceErrors = tuple[FloatArray, FloatArray]
"""Where the unloaded TCP is, (n, 3) m, base frame; and the (n,) length of the error there, m."""


def workspace_figure(models: Mapping[str, WorkspaceErrors]) -> Figure:
    """Draw each model's poses from the side and from above, colours being errors."""
    everything = np.concatenate([error for _, error in models.values()]) * MM
    scale = Normalize(0.0, float(np.quantile(everything, TOP_SHARE)) or 1e-6)
    width = style.COLUMN_INCH if len(models) == 1 else style.PAGE_INCH
    figure = style.new_figure(width, VIEWS_INCH)
    grid = figure.subplots(2, len(models), squeeze=False)
    for (name, (place, error)), (side, above) in zip(models.items(), grid.T, strict=True):
        order = np.argsort(error, kind="stable")  # the worst are drawn last, on top
        x, y, z = place[order].T
        many = len(error) > _MANY
        size, edge = (4.0, 0.0) if many else (11.0, 0.25)
        colors: dict[str, Any] = {"c": error[order] * MM, "norm": scale, "cmap": "viridis_r"}
        looks: dict[str, Any] = {"s": size, "edgecolors": "0.3", "linewidths": edge}
        for axes, across, up in ((side, np.hypot(x, y), z), (above, x, y)):
            points = axes.scatter(across, up, **colors, **looks, rasterized=many)
            axes.set_aspect("equal", adjustable="datalim")
            axes.locator_params(nbins=5)
        side.set_title(f"{style.short(name, style.PANEL_LETTERS)}\nfrom the side", loc="left")
        side.set_xlabel("distance from the base's z axis [m]")
        above.set_title("from above", loc="left")
        above.set_xlabel("x [m]")
    for axes in grid[:, 1:].flat:  # the same poses, and so the same limits as on the left
        axes.tick_params(labelleft=False)
    grid[0, 0].set_ylabel("z [m]")
    grid[1, 0].set_ylabel("y [m]")
    style.name_panels(list(grid.flat))
    bar = figure.colorbar(points, ax=grid, extend="max", shrink=0.6, aspect=30)
    bar.set_label("3-D error [mm]")
    bar.outline.set_visible(False)
    return figure


def workspace(source: FigureSource) -> Prepared:
    """Show the 3-D error of each model at the TCP positions."""
    compared = source.compared(MOST_MODELS)
    stored = read_data(source.folder, compared.case.name.data_sha256)
    _, pose = np.unique(stored.samples.pose_id, return_inverse=True)
    if compared.case.has_paths:
        pose = np.arange(len(pose))  # a path is many places
    models: dict[str, WorkspaceErrors] = {}
    for name, tested in compared.tested.items():
        by_row = pd.Series(norm_errors(tested)).groupby(tested.rows).mean()
        rows = by_row.index.to_numpy()
        by_pose = by_row.groupby(pose[rows]).mean()
        _, first = np.unique(pose[rows], return_index=True)
        models[name] = stored.tcp[rows[first]], by_pose.to_numpy()
    caption = (
        "3-D error, mean over loads and splits, at the TCP positions of the "
        f"{len(models[compared.models[0]][1])} tested poses, base frame; the colour scale ends "
        f"at the {percent(TOP_SHARE)} quantile. {compared.setting}"
    )
    paint = partial(workspace_figure, models)
    return Prepared("Error over the workspace", caption, paint, compared.subtitle)
