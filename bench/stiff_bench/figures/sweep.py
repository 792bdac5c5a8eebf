"""Depth and width of a network: its error on the source domain over both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import FigureSource, setting, variants_of
from stiff_bench.figures.style import (
    PAGE_INCH,
    REFERENCE_COLOR,
    looks,
    name_panels,
    new_figure,
    plain_numbers,
)
from stiff_bench.store.names import grouped
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRAIN, TEST = "training", "test"
FEWEST = 4  # networks of one kind that make a sweep
HEIGHT_INCH = 2.5
MOST_NUMBERS = 10  # widths beyond which the map's fields have no room for numbers
_NEEDS = (
    "a network of several widths and depths; `bench reproduce`, or `bench run --model "
    "mlp-pretrained@width=40 --model mlp-pretrained@width=160 ...`, makes them"
)


@dataclass(frozen=True, eq=False)
class Sweep:
    """Errors of networks on the source domain.

    Attributes:
        values: (depth, width) -> (n_splits,) error, m.
    """

    values: Mapping[tuple[int, int], FloatArray]

    @property
    def depths(self) -> list[int]:
        """Hidden layers, ascending."""
        return sorted({depth for depth, _ in self.values})

    @property
    def widths(self) -> list[int]:
        """Nodes a layer, ascending."""
        return sorted({width for _, width in self.values})

    def line(self, depth: int) -> tuple[list[int], FloatArray, FloatArray, FloatArray]:
        """Return the widths of a depth, and mean, least and largest over the splits, m."""
        widths = [width for width in self.widths if (depth, width) in self.values]
        found = [self.values[depth, width] for width in widths]
        means, least, largest = (
            np.array([f(one) for one in found]) for f in (np.mean, np.min, np.max)
        )
        return widths, means, least, largest

    def grid(self) -> FloatArray:
        """Return the (n_depths, n_widths) mean errors, m; NaN where there is none."""
        table = np.full((len(self.depths), len(self.widths)), np.nan)
        for (depth, width), found in self.values.items():
            table[self.depths.index(depth), self.widths.index(width)] = found.mean()
        return table


def draw_lines(axes: Axes, sweep: Sweep, quantity: str, *, dashed: Sweep | None = None) -> None:
    """Draw error against width, one line a depth, with the span over the splits.

    Args:
        axes: an empty panel.
        sweep: errors on the test part.
        quantity: the errors' name, such as "MAE".
        dashed: errors on the training part.
    """
    for depth, look in zip(sweep.depths, looks(len(sweep.depths)), strict=True):
        widths, means, least, largest = sweep.line(depth)
        axes.plot(
            *(widths, means * MM),
            color=look.color,
            marker=look.marker,
            label=f"{depth} hidden layers",
        )
        axes.fill_between(widths, least * MM, largest * MM, color=look.color, alpha=0.2, lw=0.0)
        if dashed is not None and depth in dashed.depths:
            inner, errors, *_ = dashed.line(depth)
            axes.plot(
                *(inner, errors * MM), color=look.color, linestyle=(0, (3, 1.2)), linewidth=0.8
            )
    if dashed is not None:
        axes.plot(
            *([], []), color=REFERENCE_COLOR, linestyle=(0, (3, 1.2)), lw=0.8, label="training part"
        )
    axes.set(xlabel="nodes a layer", ylabel=f"{quantity} on the source [mm]", yscale="log")
    plain_numbers(axes.yaxis)


def sweep_figure(sweep: Sweep, quantity: str = "MAE") -> Figure:
    """Draw error against width, and the map of both."""
    figure = new_figure(PAGE_INCH, HEIGHT_INCH)
    lines, heat = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    draw_lines(lines, sweep, quantity)
    lines.legend()
    draw_map(heat, sweep, f"{quantity} on the source's test part [mm]")
    name_panels([lines, heat])
    return figure


def draw_map(axes: Axes, sweep: Sweep, label: str) -> None:
    """Draw the map of mean errors over widths and depths."""
    import seaborn
    from matplotlib.colors import LogNorm

    table = sweep.grid() * MM
    n_widths = len(sweep.widths)
    seaborn.heatmap(
        table,
        ax=axes,
        cmap="viridis_r",
        norm=LogNorm(np.nanmin(table), np.nanmax(table)),
        annot=n_widths <= MOST_NUMBERS,
        fmt=".2g",
        annot_kws={"size": 6.5 if n_widths < 7 else 5.5},
        linewidths=0.5,
        xticklabels=sweep.widths,
        yticklabels=sweep.depths,
        cbar_kws={"label": label},
    )
    axes.grid(visible=False)
    axes.set(xlabel="nodes a layer", ylabel="hidden layers")
    axes.tick_params(axis="x", labelrotation=0 if n_widths <= MOST_NUMBERS else 90)
    axes.tick_params(axis="y", labelrotation=0)
    axes.invert_yaxis()
    bar = axes.collections[0].colorbar
    if bar is not None:  # always there; matplotlib's types do not say so
        plain_numbers(bar.ax.yaxis)


def source_error(part: str, quantity: str) -> str:
    """Return the diagnostic that has a network's error on a part of the source domain, mm."""
    return f"source {part} {quantity} [mm]"


def is_swept(result: CellResult) -> bool:
    """Say whether a result is of a network with depth and width and an error on the source."""
    options = result.cell.model_params
    return all(isinstance(options.get(name), int) for name in ("layers", "width")) and (
        source_error(TEST, "MAE") in result.diagnostics
    )


def sweep_of(results: Sequence[CellResult], part: str, quantity: str) -> Sweep:
    """Return the errors of networks on a part of the source domain, by depth and width."""
    name = source_error(part, quantity)
    of_size = grouped(
        [one for one in results if name in one.diagnostics],
        lambda one: (one.cell.model_params["layers"], one.cell.model_params["width"]),
    )
    return Sweep(
        {size: np.array([one.diagnostics[name] for one in of]) / MM for size, of in of_size.items()}
    )


def gather(source: FigureSource) -> Content:
    """Take the networks that differ in depth and width alone."""
    contest = source.contest(is_swept, needs=_NEEDS, most_first=True)
    swept = [
        one for name in source.names([contest]) for one in contest.results(name) if is_swept(one)
    ]
    model, results = variants_of(swept, "layers", "width")
    sweep = sweep_of(results, TEST, "MAE")
    if len(sweep.values) < FEWEST:
        raise StoreError(f"--results {source.folder}: no result has {_NEEDS}")
    names = list(dict.fromkeys(one.shown.model for one in results))
    n_splits = [len(found) for found in sweep.values.values()]
    caption = (
        f"Mean absolute error of {model} on the test part (30 %) of the simulated source domain, "
        "all axes together, against nodes a hidden layer and hidden layers. Bands: least to "
        f"largest of a network's splits. {setting(contest, names, n_splits)}"
    )
    return Content(caption, partial(sweep_figure, sweep))
