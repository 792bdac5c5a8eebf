"""The paper's Figure 6: one unfrozen layer against two adjacent ones."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.figures.figure_line import Content
from stiff_bench.figures.freezing import (
    KINDS,
    Strategy,
    draw_strategies,
    freeze_of,
    in_order,
    mean_error,
)
from stiff_bench.figures.journal_style import (
    PAGE_INCH,
    REFERENCE_COLOR,
    looks,
    name_panels,
    new_figure,
)
from stiff_bench.figures.log_axes import plain_numbers
from stiff_bench.figures.losses import has_place, least_at
from stiff_bench.paper.figure_captions import paper_setting
from stiff_bench.paper.model_words import ADJACENT_PAIRS, FT_MLP, SINGLE_LAYERS, VJM, unfrozen
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.shared_splits import shared_splits
from stiff_bench.paper.study import PAPER_PROTOCOL
from stiff_bench.units import MM
from stiff_protocols.errors import StoreError
from stiff_protocols.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT_INCH = 2.7
FEWEST = 1  # of each kind
"""Single layers and pairs that must be there to be held against each other."""


def figure_6(results: PaperResults) -> Content:
    """Take the fine-tunings that move one hidden layer, or two adjacent ones.

    Raises:
        StoreError: there is none of one kind.
    """
    names = [unfrozen(layers) for layers in (*SINGLE_LAYERS, *ADJACENT_PAIRS)]
    shared = shared_splits(results, (*names, VJM), PAPER_PROTOCOL)
    tuned = {name: found for name, found in shared.results.items() if name != VJM}
    strategies = in_order(
        [Strategy(freeze_of(of[0]), np.array(list(map(mean_error, of)))) for of in tuned.values()]
    )
    for kind in KINDS[:2]:
        if sum(one.kind == kind for one in strategies) < FEWEST:
            raise StoreError(
                f"--results {results.folder}: no result of {FT_MLP} under {PAPER_PROTOCOL} that "
                f"moves {kind}; `bench reproduce` makes it"
            )
    curves = {freeze_of(of[0]): of[0].curves.get("fine-tuning") for of in tuned.values()}
    linear = (
        float(np.mean([mean_error(one) for one in shared.results[VJM]]))
        if VJM in shared.results
        else None
    )
    dashed = f"; dashed: {VJM}" * (linear is not None)
    caption = (
        f"The paper's Figure 6: {FT_MLP} with one hidden layer unfrozen against two adjacent ones "
        "(numbered from the input). (a) Mean absolute error of the validation part, standardised, "
        "against epochs of the fine-tuning, first split; mark: least of the stored points (every "
        "tenth epoch). (b) Mean absolute error of the test part at the epoch that was kept, all "
        "axes together; symbol: mean over the splits, bars and line: single splits and their "
        f"span{dashed}. {' '.join([paper_setting(shared.results), *shared.absences()])}"
    )
    return Content(caption, partial(_draw, strategies, curves, linear))


def _draw(
    strategies: Sequence[Strategy],
    curves: dict[str, FloatArray | None],
    linear: float | None,
) -> Figure:
    figure = new_figure(PAGE_INCH, HEIGHT_INCH)
    left, right = figure.subplots(1, 2)
    _draw_curves(left, strategies, curves)
    draw_strategies(right, strategies)
    if linear is not None:
        right.axvline(linear * MM, color=REFERENCE_COLOR, linestyle="--")
    right.set(xlabel="MAE on the test part [mm]", ylabel="hidden layers that move")
    name_panels([left, right])
    return figure


def _draw_curves(
    axes: Axes, strategies: Sequence[Strategy], curves: dict[str, FloatArray | None]
) -> None:
    """Draw the validation loss of each strategy, its name at the line's end."""
    looked = looks(len(strategies))
    for strategy, look in zip(strategies, looked, strict=True):
        points = curves[strategy.freeze]
        if points is None or not has_place(points[:, 2]).any():
            continue
        step, _, loss = points.T
        best = least_at(loss)
        pair = strategy.kind == KINDS[1]
        line: dict[str, Any] = {"color": look.color, "linestyle": "-" if pair else (0, (3, 1.2))}
        mark: dict[str, Any] = {"marker": look.marker, "markersize": 4.5}
        axes.plot(step, loss, **line)
        axes.plot(step[best], loss[best], color=look.color, **mark, zorder=4.0)
        axes.plot([], [], **line, **mark, label=f"layer{'s' * pair} {strategy.label}")
    axes.set(xscale="log", yscale="log", xlabel="epochs", ylabel="validation loss [standardised]")
    plain_numbers(axes.xaxis)
    plain_numbers(axes.yaxis)
    if axes.lines:
        axes.legend(ncols=2, loc="best")
