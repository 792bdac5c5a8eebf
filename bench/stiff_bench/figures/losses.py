"""Loss curves: how a network's training went."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import FigureSource
from stiff_bench.figures.style import (
    COLUMN_INCH,
    PAGE_INCH,
    REFERENCE_COLOR,
    Look,
    looks,
    name_panels,
    new_figure,
    powers,
    short,
)
from stiff_bench.store.names import grouped
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_MODELS = 4
MOST_PHASES = 3
PANEL_INCH, LEGEND_LINE_INCH = 2.3, 0.16
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


def losses_figure(curves: Sequence[LossCurve]) -> Figure:
    """Draw a panel for each phase; models are colours, training solid, validation dashed."""
    phases = grouped(sorted(curves, key=_order), lambda curve: curve.phase)
    names = list(dict.fromkeys(curve.name for curve in curves))
    look = dict(zip(names, looks(len(names)), strict=True))
    n_columns = min(len(phases), MOST_PHASES)
    n_rows = -(-len(phases) // n_columns)
    width = COLUMN_INCH if n_columns == 1 else PAGE_INCH
    height = PANEL_INCH * n_rows + LEGEND_LINE_INCH * (len(names) + 3)
    figure = new_figure(width, height)
    panels = list(figure.subplots(n_rows, n_columns, squeeze=False).flat)
    for axes, (phase, members) in zip(panels, phases.items(), strict=False):
        places = np.linspace(0.0, 1.0, len(members) + 2)[1:-1]
        for curve, place in zip(members, places, strict=True):
            _draw(axes, curve, look[curve.name], place)
        frame(axes)
        axes.set_title(phase, loc="left")
    for axes in panels[len(phases) :]:
        axes.set_axis_off()
    if len(phases) > 1:
        name_panels(panels[: len(phases)])
    _legend(figure, look, judged=any(_is_judged(curve.points) for curve in curves))
    return figure


def _order(curve: LossCurve) -> tuple[int, str]:
    """Return a sort key: pre-trainings first, fine-tunings last."""
    return (curve.phase.startswith("fine") - curve.phase.startswith("pre"), curve.phase)


def _draw(axes: Axes, curve: LossCurve, look: Look, place: float) -> None:
    """Draw a curve; `place` says where along it the mark of one without validation is."""
    step, train, validation = curve.points.T
    axes.plot(step, train, color=look.color, linewidth=1.0)
    if _is_judged(curve.points):
        best = least_at(validation)
        axes.plot(step, validation, color=look.color, linestyle=(0, (3, 1.2)), linewidth=1.0)
        axes.plot(
            *(step[best], validation[best]),
            **look.points() | {"markersize": 5.0, "markeredgecolor": "black"},
            markeredgewidth=0.6,
            zorder=4.0,
        )
    else:  # the marker tells the lines apart without colour
        at = int(place * (len(step) - 1))
        axes.plot(step[at], train[at], **look.points() | {"markersize": 4.0})


def draw_losses(axes: Axes, curves: Sequence[LossCurve]) -> None:
    """Draw curves of one phase into a panel, named for a legend."""
    places = np.linspace(0.0, 1.0, len(curves) + 2)[1:-1]
    for curve, look, place in zip(curves, looks(len(curves)), places, strict=True):
        _draw(axes, curve, look, place)
        axes.plot([], [], color=look.color, marker=look.marker, label=short(curve.name))
    frame(axes)


def frame(axes: Axes) -> None:
    """Make both axes logarithmic and name them."""
    axes.set(xscale="log", yscale="log", xlabel="iterations", ylabel="loss [standardised]")
    powers(axes.xaxis)
    powers(axes.yaxis)


def _is_judged(points: FloatArray) -> bool:
    return bool(has_place(points[:, 2]).any())


def has_place(losses: FloatArray) -> NDArray[np.bool_]:
    """Return which of (n,) losses have a place on a logarithmic axis."""
    return np.isfinite(losses) & (losses > 0.0)


def least_at(losses: FloatArray) -> int:
    """Return where the least of the losses is that have a place."""
    return int(np.argmin(np.where(has_place(losses), losses, np.inf)))


def _legend(figure: Figure, look: dict[str, Look], *, judged: bool) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=one.color, marker=one.marker, label=short(name))
        for name, one in look.items()
    ]
    grey = REFERENCE_COLOR
    if judged:
        handles += [
            Line2D([], [], color=grey, label="training part"),
            Line2D([], [], color=grey, linestyle=(0, (3, 1.2)), label="validation part"),
            Line2D(
                [], [], color="white", marker="o", markeredgecolor="black", label="least stored"
            ),
        ]
    wide = figure.get_size_inches()[0] > COLUMN_INCH
    figure.legend(handles=handles, loc="outside lower center", ncols=4 if wide else 2)


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


def gather(source: FigureSource) -> Content:
    """Take the curves of one split of the models to compare.

    Raises:
        StoreError: there is no split on which all of them have one.
    """
    contest = source.contest(has_curves, needs=_NEEDS)
    compared = source.compared(contest, MOST_MODELS, has_curves)
    done = {name: contest.competitors[name].done for name in compared.models}
    shared = [slot for slot in compared.slots if all(has_curves(of[slot]) for of in done.values())]
    if not shared:
        raise StoreError(
            f"--results {source.folder}: {contest.name.text}: {', '.join(done)}: no split on which "
            "all have a training curve; choose fewer with --model"
        )
    curves = [curve for name, of in done.items() for curve in curves_of(of[shared[0]], name)]
    caption = (
        "Loss against iterations of the optimizer, of the first split on which all have a curve; "
        "solid: the rows that are learned from, dashed: those that choose the epoch, ringed mark: "
        "least of the stored points (every tenth step, or fewer). Losses are in the network's own "
        "units, so that they tell nothing across models whose targets are scaled otherwise. "
        f"{compared.setting} {compared.choice}"
    )
    return Content(caption.strip(), partial(losses_figure, curves))
