"""Loss curves: how a network's training went."""

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
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import BoolArray, FloatArray
from stiff_protocols.springs.identification import SPRING_CURVE

MOST_MODELS = 4
PANEL_INCH, LEGEND_LINE_INCH = 2.3, 0.16
DASHED = (0, (3, 1.2))


class LossCurve(NamedTuple):
    """One training of a model: its phase, such as "fine-tuning", and losses.

    `points` are (n, 3): step, training loss, validation loss (NaN: none); `number` says which of
    the model's trainings it is, from 0.
    """

    name: str
    phase: str
    points: FloatArray
    number: int

    @property
    def is_judged(self) -> bool:
        """Whether it has a validation loss."""
        return bool(has_place(self.points[:, 2]).any())


def losses_figure(curves: Sequence[LossCurve]) -> Figure:
    """Draw a panel for each phase; models are colours, training solid, validation dashed."""
    in_order = sorted(curves, key=lambda curve: (curve.number, curve.phase))
    phases = grouped(in_order, lambda curve: curve.phase)
    look = style.looks_of(curve.name for curve in curves)
    legend = LEGEND_LINE_INCH * (len(look) + 3)
    figure, panels = style.new_panels(len(phases), PANEL_INCH, legend)
    for axes, (phase, members) in zip(panels, phases.items(), strict=True):
        draw_losses(axes, members, look)
        axes.set_title(phase, loc="left")
    if any(curve.is_judged for curve in curves):
        for line, part in (("-", "training"), (DASHED, "validation")):
            panels[0].plot([], [], color=style.REFERENCE_COLOR, ls=line, label=f"{part} part")
    style.name_panels(panels)
    style.share_legend(figure, panels, ncols=4 if len(panels) > 1 else 2)
    return figure


def draw_losses(axes: Axes, curves: Sequence[LossCurve], look: Mapping[str, style.Look]) -> None:
    """Draw curves of one phase; ringed: the least validation loss that is stored."""
    for curve in curves:
        step, train, validation = curve.points.T
        drawn = look[curve.name]
        shown: dict[str, Any] = {"color": drawn.color, "marker": drawn.marker, "linewidth": 1.0}
        axes.plot(step, train, **shown, markevery=0.3, label=style.short(curve.name))
        if curve.is_judged:
            ring: dict[str, Any] = {"markevery": [least_at(validation)], "markersize": 5.0}
            axes.plot(step, validation, **shown, ls=DASHED, **ring, markeredgecolor="black")
    axes.set(xscale="log", yscale="log", xlabel="iterations", ylabel="loss [standardised]")
    for axis in (axes.xaxis, axes.yaxis):
        style.plain_numbers(axis, (1.0,))


def has_place(losses: FloatArray) -> BoolArray:
    """Return which of (n,) losses have a place on a logarithmic axis."""
    return np.isfinite(losses) & (losses > 0.0)


def least_at(losses: FloatArray) -> int:
    """Return where the least of the losses is that have a place."""
    return int(np.argmin(np.where(has_place(losses), losses, np.inf)))


def curves_of(result: CellResult, name: str) -> list[LossCurve]:
    """Return the curves of a result that can be drawn."""
    return [
        LossCurve(name, phase, points, number)
        for number, (phase, points) in enumerate(result.curves.items())
        if not phase.startswith(SPRING_CURVE) and has_place(points[:, 1]).any()
    ]


def loss_curves(source: FigureSource) -> Prepared:
    """Show training and validation loss per step, on the first split that all models have."""
    made_by = "`bench run --model ft-mlp` makes one"
    compared = source.compared(
        MOST_MODELS, lambda one: curves_of(one, ""), "a training curve", made_by
    )
    of_models = compared.case.competitors
    curves = [
        curve
        for name in compared.models
        for curve in curves_of(of_models[name].done[compared.slots[0]], name)
    ]
    caption = (
        "Loss on standardised outputs, first split with curves of all models; ring: least "
        f"validation loss. {compared.setting}"
    )
    return Prepared("Loss curves", caption, partial(losses_figure, curves), compared.subtitle)
