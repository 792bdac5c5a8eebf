"""Loss curves: training and validation loss of networks per step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import FigureSource
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.store.names import grouped
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.types import BoolArray, FloatArray
from stiff_protocols.springs.identification import SPRING_CURVE

MOST_MODELS = 4
PANEL_INCH, ROW_INCH, LEGEND_LINE_INCH = 2.3, 1.6, 0.16
STEPS = {6.0: style.FINE_STEPS, 200.0: (1.0, 2.0, 5.0), np.inf: (1.0,)}
"""Ratio of an axis's ends -> numbers of a decade on an axis of a smaller ratio."""
DASHED = (0, (3, 1.2))


class LossCurve(NamedTuple):
    """One training of a model: its phase, such as "fine-tuning", and losses.

    `points` are (n, 3): step, training loss, validation loss (NaN: none). `number` counts the
    trainings of the model from 0.
    """

    name: str
    phase: str
    points: FloatArray
    number: int

    @property
    def is_judged(self) -> bool:
        """True if the curve has a validation loss."""
        return bool(has_place(self.points[:, 2]).any())


def losses_figure(data: Sequence[tuple[str, Sequence[LossCurve]]]) -> Figure:
    """Draw relative losses, a row per data set and a panel per phase.

    Models are colours; training is solid, validation dashed. `data` are titles with curves.
    """
    in_order = [curve for _, curves in data for curve in curves]
    look = style.looks_of(curve.name for curve in in_order)
    every = sorted(in_order, key=lambda curve: (curve.number, curve.phase))
    phases = grouped(every, lambda curve: curve.phase)
    legend = LEGEND_LINE_INCH * (len(look) + 3)
    width = style.COLUMN_INCH if len(phases) == 1 else style.PAGE_INCH
    row_inch = PANEL_INCH if len(data) == 1 else ROW_INCH
    figure = style.new_figure(width, row_inch * len(data) + legend)
    grid = figure.subplots(len(data), len(phases), squeeze=False, sharex="col", sharey="col")
    for (title, curves), row in zip(data, grid, strict=True):
        by_phase = grouped(map(relative_to_first, curves), lambda curve: curve.phase)
        for axes, phase in zip(row, phases, strict=True):
            members = by_phase.get(phase, [])
            draw_losses(axes, members, look)
            axes.set(xlabel="", ylabel="loss / first loss" if axes is row[0] else "")
            if not members:
                axes.set_axis_off()
            heading = style.short(phase) if members else f"{style.short(phase)}: none"
            axes.set_title(f"{title}\n{heading}".strip() if axes is row[0] else heading, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("iterations")
    panels = list(grid.flat)
    if any(curve.is_judged for curve in every):
        for line, part in (("-", "training"), (DASHED, "validation")):
            panels[0].plot([], [], color=style.REFERENCE_COLOR, ls=line, label=f"{part} part")
    style.name_panels(panels if len(data) == 1 else list(grid[:, 0]))
    style.share_legend(figure, panels, ncols=4 if len(phases) > 1 else 2)
    return figure


def relative_to_first(curve: LossCurve) -> LossCurve:
    """Divide the losses of a curve by the first training and validation loss.

    Units of losses may differ between training, validation and models.
    """
    points = curve.points.copy()
    for column in (1, 2):
        positive = points[has_place(points[:, column]), column]
        points[:, column] /= positive[0] if len(positive) else 1.0
    return curve._replace(points=points)


def draw_losses(axes: Axes, curves: Sequence[LossCurve], look: Mapping[str, style.Look]) -> None:
    """Draw curves of one phase; ringed: the least validation loss that is stored."""
    labels = style.short_names(look)
    for curve in curves:
        step, train, validation = curve.points.T
        drawn = look[curve.name]
        line_style: dict[str, Any] = {
            "color": drawn.color,
            "marker": drawn.marker,
            "linewidth": 1.0,
        }
        axes.plot(
            step,
            train,
            **line_style,
            markevery=0.3 if len(step) > 1 else 1,
            label=labels[curve.name],
        )
        if curve.is_judged:
            ring: dict[str, Any] = {"markevery": [least_at(validation)], "markersize": 5.0}
            axes.plot(step, validation, **line_style, ls=DASHED, **ring, markeredgecolor="black")
    axes.set(xscale="log", yscale="log", xlabel="iterations", ylabel="loss [standardised]")
    style.plain_numbers(axes.xaxis, (1.0, 3.0))
    low, high = axes.get_ylim()
    steps = next(steps for span, steps in STEPS.items() if high < span * low)
    style.plain_numbers(axes.yaxis, steps)


def has_place(losses: FloatArray) -> BoolArray:
    """Return a mask of the (n,) losses that a logarithmic axis can show."""
    return np.isfinite(losses) & (losses > 0.0)


def least_at(losses: FloatArray) -> int:
    """Return the index of the least loss with a place on the axis."""
    return int(np.argmin(np.where(has_place(losses), losses, np.inf)))


def curves_of(result: FitResult, name: str) -> list[LossCurve]:
    """Return the curves of a result that can be drawn."""
    return [
        LossCurve(name, phase, points, number)
        for number, (phase, points) in enumerate(result.curves.items())
        if not phase.startswith(SPRING_CURVE) and has_place(points[:, 1]).any()
    ]


def loss_curves(source: FigureSource) -> Prepared:
    """Show training and validation loss per step, on the first split that all models have."""
    made_by = "create one with `bench run --model ft-mlp`"
    panels = source.panels(
        MOST_MODELS, lambda result: curves_of(result, ""), "a training curve", made_by
    )
    data = [
        (
            title,
            [
                curve
                for name in compared.models
                for curve in curves_of(compared.task.results(name, compared.splits)[0], name)
            ],
        )
        for title, compared in panels.titled
    ]
    caption = (
        "Losses relative to the first stored one (training and validation have different ones), "
        "first split with curves of all models; ring: least validation loss. "
        f"{panels.setting}"
    )
    return Prepared("Loss curves", caption, partial(losses_figure, data), panels.subtitle)
