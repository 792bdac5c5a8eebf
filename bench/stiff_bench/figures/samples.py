"""What models say of the test samples: predictions, errors sample by sample, and where they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import Compared, FigureSource, Predicted
from stiff_bench.figures.style import (
    COLUMN_INCH,
    PAGE_INCH,
    PANEL_LETTERS,
    REFERENCE_COLOR,
    Look,
    looks,
    name_panels,
    new_figure,
    share_legend,
    short,
)
from stiff_bench.store.database import read_data
from stiff_bench.tables.units import MM
from stiff_protocols.contract.types import AXES, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

MOST_MODELS = 3
SHARE = 0.95
SQUARE_INCH, LABELS_INCH, LINE_INCH = 2.05, 0.45, 0.13
"""Of a panel: its sides, what labels take, and a line of its heading."""
MARGIN = 0.05  # of the span, at each end
_BIG = 400  # points beyond which they are drawn smaller


@dataclass(frozen=True, eq=False)
class Series:
    """One model's samples.

    Attributes:
        name: of the model.
        tested: the samples.
        published: mean absolute errors along x, y and z that the paper has, m; () for none.
    """

    name: str
    tested: Predicted
    published: tuple[float, ...] = ()

    def note(self, axis: int) -> str:
        """Return the mean error along an axis, and the published one."""
        ours = f"{self.tested.error[:, axis].mean() * MM:.3f} mm"
        return f"{ours} (paper {self.published[axis] * MM:.3f})" if self.published else ours


def regression_figure(series: Sequence[Series], *, overlaid: bool = False) -> Figure:
    """Draw a row of three panels a model, or all models in one row.

    Args:
        series: at least one, of at least one sample.
        overlaid: one row.
    """
    rows = [tuple(series)] if overlaid else [(one,) for one in series]
    colors = dict(zip(series, looks(len(series)), strict=True))
    n_lines = len(series) + 3 if overlaid else 2  # a legend is as high as two
    height = len(rows) * (SQUARE_INCH + LABELS_INCH + LINE_INCH * n_lines)
    figure = new_figure(PAGE_INCH, height)
    grid = figure.subplots(len(rows), 3, squeeze=False)
    limits = [_limits(series, axis) for axis in range(3)]
    for shown, panels in zip(rows, grid, strict=True):
        for axis, axes in enumerate(panels):
            for one in shown:
                _draw_series(axes, one, axis, colors[one])
            _frame(axes, AXES[axis], limits[axis])
            axes.set_title("\n".join(_heading(shown, axis)), loc="left")
    name_panels(list(grid.flat))
    if overlaid:
        share_legend(figure, [grid[0, 0]])
    return figure


def _draw_series(axes: Axes, one: Series, axis: int, look: Look) -> None:
    x, y = one.tested.measured[:, axis] * MM, one.tested.predicted[:, axis] * MM
    half = float(np.quantile(one.tested.error[:, axis], SHARE)) * MM
    axes.axline((0.0, half), slope=1.0, color=look.color, linewidth=0.7, linestyle=look.line)
    axes.axline((0.0, -half), slope=1.0, color=look.color, linewidth=0.7, linestyle=look.line)
    size = 3.4 if len(x) < _BIG else 2.4
    axes.plot(
        *(x, y),
        **look.points(),
        markersize=size,
        alpha=0.65,
        markeredgewidth=0.0,
        label=short(one.name),
        rasterized=len(x) > 10 * _BIG,
    )


def _heading(shown: Sequence[Series], axis: int) -> list[str]:
    """Return the lines over a panel: what it is of, and the models' mean errors."""
    name = f"d{AXES[axis]}"
    if len(shown) == 1:
        return [f"{name}, {short(shown[0].name, PANEL_LETTERS)}", f"MAE {shown[0].note(axis)}"]
    return [f"{name}, MAE:", *(f"{short(one.name)} {one.note(axis)}" for one in shown)]


def _limits(series: Sequence[Series], axis: int) -> tuple[float, float]:
    values: FloatArray = np.concatenate(
        [one.tested.measured[:, axis] for one in series]
        + [one.tested.predicted[:, axis] for one in series]
    )
    low, high = float(values.min()) * MM, float(values.max()) * MM
    reach = MARGIN * (high - low) or 1e-3
    return low - reach, high + reach


def _frame(axes: Axes, name: str, limits: tuple[float, float]) -> None:
    axes.axline(
        (0.0, 0.0), slope=1.0, color=REFERENCE_COLOR, linewidth=0.8, zorder=1.5, label="identity"
    )
    axes.set(
        xlim=limits,
        ylim=limits,
        aspect="equal",
        xlabel=f"measured d{name} [mm]",
        ylabel=f"predicted d{name} [mm]",
    )
    axes.locator_params(nbins=5)
    axes.set_xticks([tick for tick in axes.get_yticks() if limits[0] <= tick <= limits[1]])


def regression(source: FigureSource) -> Content:
    """Take the test samples of the models to compare."""
    compared = source.compared(source.contest(), MOST_MODELS)
    series = [Series(name, compared.tested(name)) for name in compared.models]
    n_samples = len(series[0].tested.rows)
    caption = (
        "Measured against predicted deflection of the TCP, base frame, one panel an axis, of the "
        f"{n_samples} test samples of all splits together. {compared.setting} Grey: identity. "
        f"Coloured lines: identity ± the error that {SHARE:.0%} of the samples keep. "
        f"{compared.choice}"
    )
    return Content(caption.strip(), partial(regression_figure, series))


ROW_INCH, HEAD_INCH = 1.55, 0.3
_DENSE = 400  # samples beyond which they are drawn as dots


@dataclass(frozen=True, eq=False)
class SampleErrors:
    """One model's errors.

    Attributes:
        name: of the model.
        rows: (n,) row numbers in the data set, ascending.
        error: (n, 3) absolute error, m.
    """

    name: str
    rows: IntArray
    error: FloatArray


def errors_figure(models: Sequence[SampleErrors]) -> Figure:
    """Draw, for each axis, the errors by sample with their mean, and their distribution."""
    figure = new_figure(PAGE_INCH, 3 * ROW_INCH + HEAD_INCH)
    grid = figure.subplots(3, 2, width_ratios=(2.4, 1.0))
    last = max(1, *(int(one.rows.max()) for one in models))
    for axis, (by_sample, distribution) in enumerate(grid):
        for one, look in zip(models, looks(len(models)), strict=True):
            _draw_errors(by_sample, distribution, one, axis, look)
        name = AXES[axis]
        by_sample.set_xlim(-0.02 * last, 1.02 * last)
        by_sample.set(ylabel=f"|error of d{name}| [mm]", ylim=(0.0, None))
        distribution.set(ylabel="share of samples", ylim=(0.0, 1.03), xlim=(0.0, None))
        by_sample.set_title(f"d{name}", loc="left")
        distribution.set_title(f"d{name}", loc="left")
        distribution.locator_params(axis="x", nbins=5)
    grid[-1, 0].set_xlabel("number of the sample in the data set")
    grid[-1, 1].set_xlabel("|error| [mm]")
    name_panels(list(grid.flat))
    share_legend(figure, [grid[0, 0]])
    return figure


def _draw_errors(
    by_sample: Axes, distribution: Axes, one: SampleErrors, axis: int, look: Look
) -> None:
    error = one.error[:, axis] * MM
    dense = len(error) > _DENSE
    by_sample.plot(
        *(one.rows, error),
        **look.points(),
        markersize=1.5 if dense else 3.0,
        markeredgewidth=0.0,
        alpha=0.7,
        label=short(one.name),
        rasterized=dense,
    )
    by_sample.axhline(float(error.mean()), **look.connected(), linewidth=0.9)
    distribution.ecdf(error, **look.connected())


def sample_errors(source: FigureSource) -> Content:
    """Take the errors of the models to compare, averaged over the splits that test a sample."""
    compared = source.compared(source.contest(), MOST_MODELS)
    models = []
    for name in compared.models:
        tested = compared.tested(name)
        models.append(SampleErrors(name, *tested.mean_by_row(tested.error)))
    n_rows = len(models[0].rows)
    caption = (
        f"Absolute error of each of the {n_rows} samples that were tested, axis by axis (left; "
        "horizontal lines: means), and the share of samples with at most that error (right). A "
        "sample that several splits test has the mean of its errors. "
        f"{compared.setting} {compared.choice}"
    )
    return Content(caption.strip(), partial(errors_figure, models))


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
        points = _draw_views(side, above, one, scale)
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


def _draw_views(side: Axes, above: Axes, one: WorkspaceErrors, scale: Normalize) -> PathCollection:
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


def workspace(source: FigureSource) -> Content:
    """Take the errors by pose of the models to compare."""
    compared = source.compared(source.contest(), MOST_MODELS)
    sha256 = compared.contest.name.data_sha256
    stored = read_data(source.folder, sha256)
    _, pose = np.unique(stored.samples.pose_id, return_inverse=True)
    models = [_at_poses(compared, name, stored.tcp, pose) for name in compared.models]
    caption = (
        "Length of the error over the workspace: TCP positions from the side (top) and from above "
        f"(bottom), base frame, of the {len(models[0].error)} poses that were tested; errors of "
        "loads and splits at one pose are averaged. The colours are the same for all models and "
        f"end at the error that {TOP_SHARE:.0%} of all poses keep. "
        f"{compared.setting} {compared.choice}"
    )
    return Content(caption.strip(), partial(workspace_figure, models))


def _at_poses(
    compared: Compared, name: str, tcp: FloatArray, pose: NDArray[np.intp]
) -> WorkspaceErrors:
    tested = compared.tested(name)
    rows, lengths = tested.mean_by_row(np.linalg.norm(tested.error, axis=1))
    _, first, where = np.unique(pose[rows], return_index=True, return_inverse=True)
    error = np.bincount(where, lengths) / np.bincount(where)
    return WorkspaceErrors(name, tcp[rows[first]], error)
