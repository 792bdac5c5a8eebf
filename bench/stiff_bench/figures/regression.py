"""Regression diagrams: what was measured against what is predicted, axis by axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import FigureSource, Predicted
from stiff_bench.figures.style import (
    PAGE_INCH,
    PANEL_LETTERS,
    REFERENCE_COLOR,
    Look,
    looks,
    name_panels,
    new_figure,
    short,
)
from stiff_bench.tables.units import MM
from stiff_protocols.contract.types import AXES, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHARE = 0.95
MOST_MODELS = 3
SQUARE_INCH, FRAME_INCH, LINE_INCH = 2.05, 0.45, 0.13
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
    height = len(rows) * (SQUARE_INCH + FRAME_INCH + LINE_INCH * n_lines)
    figure = new_figure(PAGE_INCH, height)
    grid = figure.subplots(len(rows), 3, squeeze=False)
    limits = [_limits(series, axis) for axis in range(3)]
    for shown, panels in zip(rows, grid, strict=True):
        for axis, axes in enumerate(panels):
            for one in shown:
                _draw(axes, one, axis, colors[one])
            _frame(axes, AXES[axis], limits[axis])
            axes.set_title("\n".join(_heading(shown, axis)), loc="left")
    name_panels(list(grid.flat))
    if overlaid:
        handles, names = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=4)
    return figure


def _draw(axes: Axes, one: Series, axis: int, look: Look) -> None:
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


def gather(source: FigureSource) -> Content:
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
