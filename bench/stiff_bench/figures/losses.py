"""Loss curves: how a network's training went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.figures.figure import Prepared
from stiff_bench.figures.source import FigureSource
from stiff_bench.figures.style import (
    COLUMN_INCH,
    REFERENCE_COLOR,
    Look,
    looks,
    name_panels,
    new_panels,
    plain_numbers,
    share_legend,
    short,
)
from stiff_bench.store.names import grouped
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_MODELS = 4
PANEL_INCH, LEGEND_LINE_INCH = 2.3, 0.16
DASHED = (0, (3, 1.2))
_NEEDS = "a training curve; `bench run --model ft-mlp` makes one"


@dataclass(frozen=True, eq=False)
class LossCurve:
    """One training.

    Attributes:
        name: of the model.
        phase: of its training, such as "fine-tuning".
        points: (n, 3) step, training loss, validation loss (NaN: none).
    """

    name: str
    phase: str
    points: FloatArray

    @property
    def is_judged(self) -> bool:
        """Whether it has a validation loss."""
        return bool(has_place(self.points[:, 2]).any())


def losses_figure(curves: Sequence[LossCurve]) -> Figure:
    """Draw a panel for each phase; models are colours, training solid, validation dashed."""
    phases = grouped(sorted(curves, key=_order), lambda curve: curve.phase)
    names = list(dict.fromkeys(curve.name for curve in curves))
    look = dict(zip(names, looks(len(names)), strict=True))
    figure, panels = new_panels(len(phases), PANEL_INCH, LEGEND_LINE_INCH * (len(names) + 3))
    for axes, (phase, members) in zip(panels, phases.items(), strict=True):
        draw_losses(axes, members, look)
        axes.set_title(phase, loc="left")
    if any(curve.is_judged for curve in curves):
        panels[0].plot([], [], color=REFERENCE_COLOR, label="training part")
        panels[0].plot([], [], color=REFERENCE_COLOR, linestyle=DASHED, label="validation part")
    name_panels(panels)
    wide = figure.get_size_inches()[0] > COLUMN_INCH
    share_legend(figure, panels, below=True, ncols=4 if wide else 2)
    return figure


def _order(curve: LossCurve) -> tuple[int, str]:
    """Return a sort key: pre-trainings first, fine-tunings last."""
    return (curve.phase.startswith("fine") - curve.phase.startswith("pre"), curve.phase)


def draw_losses(
    axes: Axes, curves: Sequence[LossCurve], look: Mapping[str, Look] | None = None
) -> None:
    """Draw curves of one phase, one a name; ringed: the least validation loss that is stored."""
    look = look or dict(zip([one.name for one in curves], looks(len(curves)), strict=True))
    for curve in curves:
        step, train, validation = curve.points.T
        shown: dict[str, Any] = {"color": look[curve.name].color, "marker": look[curve.name].marker}
        axes.plot(step, train, **shown, markevery=0.3, linewidth=1.0, label=short(curve.name))
        if curve.is_judged:
            axes.plot(
                *(step, validation),
                **shown,
                linestyle=DASHED,
                linewidth=1.0,
                markevery=[least_at(validation)],
                markersize=5.0,
                markeredgecolor="black",
            )
    axes.set(xscale="log", yscale="log", xlabel="iterations", ylabel="loss [standardised]")
    for axis in (axes.xaxis, axes.yaxis):
        plain_numbers(axis, (1.0,))


def has_place(losses: FloatArray) -> BoolArray:
    """Return which of (n,) losses have a place on a logarithmic axis."""
    return np.isfinite(losses) & (losses > 0.0)


def least_at(losses: FloatArray) -> int:
    """Return where the least of the losses is that have a place."""
    return int(np.argmin(np.where(has_place(losses), losses, np.inf)))


def curves_of(result: CellResult, name: str) -> list[LossCurve]:
    """Return the curves of a result that can be drawn."""
    return [
        LossCurve(name, phase, points)
        for phase, points in result.curves.items()
        if has_place(points[:, 1]).any()
    ]


def has_curves(result: CellResult) -> bool:
    """Say whether a result has a curve to draw."""
    return bool(curves_of(result, result.shown.model))


def gather(source: FigureSource) -> Prepared:
    """Take the curves of the first split on which all of the models to compare have one."""
    case = source.case(has_curves, needs=_NEEDS)
    compared = source.compared(case, MOST_MODELS, has_curves, "a training curve")
    curves = [
        curve
        for name in compared.models
        for curve in curves_of(case.competitors[name].done[compared.slots[0]], name)
    ]
    caption = (
        "Loss on standardised outputs, first split with curves of all models; ring: least "
        f"validation loss. {compared.setting}"
    )
    return Prepared("Loss curves", caption, partial(losses_figure, curves))
