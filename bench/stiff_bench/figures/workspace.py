"""Error over the workspace: where on the robot's poses each model is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import Compared, FigureSource
from stiff_bench.figures.style import (
    COLUMN_INCH,
    PAGE_INCH,
    PANEL_LETTERS,
    name_panels,
    new_figure,
    short,
)
from stiff_bench.store.database import read_data
from stiff_bench.tables.units import MM
from stiff_protocols.contract.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

MOST_MODELS = 3
BAR_INCH, FRAME_INCH = 1.2, 0.55  # what colour bar, and titles and labels, take
LEAST_INCH, MOST_INCH = 0.8, 3.5
TOP_SHARE = 0.95
"""Of all errors lie below the end of the colours: one outlier would leave the others one colour."""
_MANY = 500  # poses


@dataclass(frozen=True, eq=False)
class WorkspaceErrors:
    """One model's errors over the workspace.

    Attributes:
        name: of the model.
        place: (n, 3) where the unloaded TCP is, m, base frame.
        error: (n,) length of the error there, m.
    """

    name: str
    place: FloatArray
    error: FloatArray


def workspace_figure(models: Sequence[WorkspaceErrors]) -> Figure:
    """Draw each model's poses from the side and from above, colours being errors."""
    from matplotlib.colors import Normalize

    everything = np.concatenate([one.error for one in models]) * MM
    top = float(np.quantile(everything, TOP_SHARE)) or 1e-6
    scale = Normalize(0.0, top)
    page = COLUMN_INCH if len(models) == 1 else PAGE_INCH
    heights = _view_heights(models, page)
    figure = new_figure(page, sum(heights))
    grid = figure.subplots(*(2, len(models)), squeeze=False, height_ratios=heights)
    for one, (side, above) in zip(models, grid.T, strict=True):
        points = _draw(side, above, one, scale)
    for axes in grid[:, 1:].flat:  # the same poses, and so the same limits as on the left
        axes.tick_params(labelleft=False)
    grid[0, 0].set_ylabel("z [m]")
    grid[1, 0].set_ylabel("y [m]")
    name_panels(list(grid.flat))
    bar = figure.colorbar(points, ax=grid, extend="max", shrink=0.6, aspect=30)
    bar.set_label("length of the error [mm]")
    bar.outline.set_visible(False)
    return figure


def _view_heights(models: Sequence[WorkspaceErrors], page: float) -> list[float]:
    """Return heights in inches at which both views, true to scale, fill the width of a page."""
    x, y, z = np.concatenate([one.place for one in models]).T
    width = (page - BAR_INCH) / len(models)
    spans = [(np.hypot(x, y), z), (x, y)]
    ratios = [float(np.ptp(up) / max(np.ptp(across), 1e-3)) for across, up in spans]
    return [min(max(width * ratio, LEAST_INCH), MOST_INCH) + FRAME_INCH for ratio in ratios]


def _draw(side: Axes, above: Axes, one: WorkspaceErrors, scale: Normalize) -> PathCollection:
    order = np.argsort(one.error, kind="stable")  # the worst are drawn last, on top
    x, y, z = one.place[order].T
    error = one.error[order] * MM
    for axes, across, up in ((side, np.hypot(x, y), z), (above, x, y)):
        points = axes.scatter(
            *(across, up),
            c=error,
            norm=scale,
            cmap="viridis_r",
            s=4.0 if len(error) > _MANY else 11.0,
            edgecolors="0.3",
            linewidths=0.0 if len(error) > _MANY else 0.25,
            rasterized=len(error) > _MANY,
        )
        axes.set_aspect("equal", adjustable="datalim")
        axes.locator_params(nbins=5)
    side.set_title(f"{short(one.name, PANEL_LETTERS)}\nfrom the side", loc="left")
    side.set_xlabel("distance from the base's z axis [m]")
    above.set_title("from above", loc="left")
    above.set_xlabel("x [m]")
    return points


def gather(source: FigureSource) -> Content:
    """Take the errors by pose of the models to compare."""
    compared = source.compared(source.contest(), MOST_MODELS)
    sha256 = compared.contest.name.data_sha256
    stored = read_data(source.folder, sha256)
    _, pose = np.unique(stored.samples.pose_id, return_inverse=True)
    models = [_of_model(compared, name, stored.tcp, pose) for name in compared.models]
    caption = (
        "Length of the error over the workspace: TCP positions from the side (top) and from above "
        f"(bottom), base frame, of the {len(models[0].error)} poses that were tested; errors of "
        "loads and splits at one pose are averaged. The colours are the same for all models and "
        f"end at the error that {TOP_SHARE:.0%} of all poses keep. "
        f"{compared.setting} {compared.choice}"
    )
    return Content(caption.strip(), partial(workspace_figure, models))


def _of_model(
    compared: Compared, name: str, tcp: FloatArray, pose: NDArray[np.intp]
) -> WorkspaceErrors:
    tested = compared.tested(name)
    rows, lengths = tested.mean_by_row(np.linalg.norm(tested.error, axis=1))
    _, first, where = np.unique(pose[rows], return_index=True, return_inverse=True)
    error = np.bincount(where, lengths) / np.bincount(where)
    return WorkspaceErrors(name, tcp[rows[first]], error)
