"""Error of every test sample, axis by axis: which samples a model fails on, and how often."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import FigureSource
from stiff_bench.figures.style import PAGE_INCH, Look, looks, name_panels, new_figure, short
from stiff_bench.tables.units import MM
from stiff_protocols.contract.types import AXES, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_MODELS = 3
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
            _draw(by_sample, distribution, one, axis, look)
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
    handles, names = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=4)
    return figure


def _draw(by_sample: Axes, distribution: Axes, one: SampleErrors, axis: int, look: Look) -> None:
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


def gather(source: FigureSource) -> Content:
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
