"""The paper's Figure 5: depth and width of the network, and its pre-training.

The paper's (a) and (b) show errors on the source domain over the nodes a layer; ours has the mean
absolute error in (a) and its standard deviation in (b).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from stiff_bench.figures.figure_line import Content
from stiff_bench.figures.journal_style import (
    COLUMN_INCH,
    PAGE_INCH,
    REFERENCE_COLOR,
    looks,
    name_panels,
    new_figure,
)
from stiff_bench.figures.losses import LossCurve, curves_of, draw_losses, losses_figure
from stiff_bench.figures.sweep import TEST, TRAIN, Sweep, draw_lines, sweep_of
from stiff_bench.paper.figure_captions import setting
from stiff_bench.paper.model_words import (
    ACTIVATIONS,
    BASE_LAYERS,
    BASE_WIDTH,
    EARLY_STEPS,
    pretrained,
)
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.study import DEPTH_WIDTH, PAPER_PROTOCOL, WIDTH_DEPTHS, WIDTHS
from stiff_bench.published import published_lines
from stiff_bench.units import MM
from stiff_protocols.errors import StoreError
from stiff_protocols.record import CellResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Quantity = Literal["MAE", "STDE"]
FEWEST_WIDTHS = 2
PANEL_INCH = 2.7
_LETTERS: Mapping[Quantity, str] = {"MAE": "a", "STDE": "b"}
_LINES = (
    "Solid: test part (30 %), with a band from the least to the largest of the splits; dashed: "
    "training part. Hollow, in the depths' colours, on the test part: stars, the paper's values "
    "(its Tables 6 and 7); circles, where they were computed, our networks stopped after "
    f"{EARLY_STEPS} steps of plain Adam"
)


@dataclass(frozen=True, eq=False)
class Widths:
    """What (a) or (b) shows.

    Attributes:
        quantity: "MAE" or "STDE".
        test, train: ours.
        marks: name -> (depth, nodes a layer) -> a value on the test part to hold it against, m.
        n_splits: the most that a network was trained on.
    """

    quantity: Quantity
    test: Sweep
    train: Sweep
    marks: Mapping[str, Mapping[tuple[int, int], float]]
    n_splits: int


def figure_5a(results: PaperResults) -> Content:
    """Take the mean absolute errors over widths."""
    return _widths_content(results, "MAE")


def figure_5b(results: PaperResults) -> Content:
    """Take the standard deviations of the absolute error over widths."""
    return _widths_content(results, "STDE")


def figure_5c(results: PaperResults) -> Content:
    """Take the losses of the pre-training."""
    curves = _pretrainings(results)
    return Content(_loss_caption("5c"), partial(losses_figure, curves))


def figure_5(results: PaperResults) -> Content:
    """Take all three."""
    mae, stde, curves = _widths(results, "MAE"), _widths(results, "STDE"), _pretrainings(results)
    caption = (
        f"The paper's Figure 5: (a) MAE and (b) STDE of pre-trained networks on the simulated "
        f"source domain, all axes together, against nodes a hidden layer. {_LINES}. (c) Loss of "
        f"the pre-training (mean square, standardised) of {BASE_LAYERS} x {BASE_WIDTH} nodes "
        f"against iterations, first split. {setting(mae.n_splits)}"
    )
    return Content(caption, partial(_three_panels, (mae, stde), curves))


def _widths_content(results: PaperResults, quantity: Quantity) -> Content:
    found = _widths(results, quantity)
    caption = (
        f"The paper's Figure 5{_LETTERS[quantity]}: {quantity} of pre-trained networks on the "
        f"simulated source domain, all axes together, against nodes a hidden layer. {_LINES}. "
        f"{setting(found.n_splits)}"
    )
    return Content(caption, partial(_one_panel, found))


def _widths(results: PaperResults, quantity: Quantity) -> Widths:
    """Return the errors of the networks of Figure 5 that the folder has.

    Raises:
        StoreError: a depth has fewer than two widths.
    """
    found = [
        result
        for width in WIDTHS
        for depth in WIDTH_DEPTHS
        if results.has(name := pretrained(layers=depth, width=width))
        for result in results.splits(name)
    ]
    test = sweep_of(found, TEST, quantity)
    short = [d for d in WIDTH_DEPTHS if sum(d == of for of, _ in test.values) < FEWEST_WIDTHS]
    if short:
        depths = ", ".join(map(str, short))
        raise StoreError(
            f"--results {results.folder}: fewer than {FEWEST_WIDTHS} widths of {depths} hidden "
            f"layers have results under {PAPER_PROTOCOL}; `bench reproduce` makes them"
        )
    return Widths(
        quantity,
        test,
        sweep_of(found, TRAIN, quantity),
        {"paper": _published(quantity), "stopped early": _stopped_early(results, quantity)},
        max(len(errors) for errors in test.values.values()),
    )


def _published(quantity: Quantity) -> dict[tuple[int, int], float]:
    """Return what the paper's Tables 6 and 7 say of networks of these depths, m."""
    column = f"test_{quantity.lower()}_mm"
    of_depth = {
        (int(line["layers"]), DEPTH_WIDTH): float(line[column]) / MM
        for line in published_lines("table_6")
        if int(line["layers"]) in WIDTH_DEPTHS
    }
    by_activation = {line["activation"]: line for line in published_lines("table_7")}
    return of_depth | {(BASE_LAYERS, BASE_WIDTH): float(by_activation["relu"][column]) / MM}


def _stopped_early(results: PaperResults, quantity: Quantity) -> dict[tuple[int, int], float]:
    """Return what our networks have that were stopped early, m, where there are some."""
    names = [pretrained(layers=d, width=DEPTH_WIDTH, stopped_early=True) for d in WIDTH_DEPTHS]
    names.append(pretrained(stopped_early=True))
    found = [one for name in names if results.has(name) for one in results.splits(name)]
    return {size: float(of.mean()) for size, of in sweep_of(found, TEST, quantity).values.items()}


def _pretrainings(results: PaperResults) -> list[LossCurve]:
    """Return the pre-trainings of the first split, of each activation that has one.

    Raises:
        StoreError: the paper's own has none.
    """
    first: dict[str, CellResult] = {
        activation: results.splits(name)[0]
        for activation in reversed(ACTIVATIONS)
        if results.has(name := pretrained(activation=activation)) or activation == "relu"
    }
    curves = [curve for name, result in first.items() for curve in curves_of(result, name)]
    if not curves:
        raise StoreError(
            f"--results {results.folder}: {pretrained()} has no training curve; `bench reproduce` "
            "in another folder makes one"
        )
    return curves


def _loss_caption(name: str) -> str:
    return (
        f"The paper's Figure {name}: loss of the pre-training (mean square, standardised targets) "
        f"of a network of {BASE_LAYERS} x {BASE_WIDTH} nodes against iterations, by activation; "
        f"the paper's is ReLU, of 100,000 iterations. Of the first split. {setting(1)}"
    )


def _draw_widths(axes: Axes, found: Widths) -> None:
    draw_lines(axes, found.test, found.quantity, dashed=found.train)
    colors = dict(zip(WIDTH_DEPTHS, looks(len(WIDTH_DEPTHS)), strict=True))
    for (name, values), shape in zip(found.marks.items(), ("*", "o"), strict=True):
        hollow: dict[str, Any] = {
            "marker": shape,
            "linestyle": "none",
            "markersize": 6.0 if shape == "*" else 4.0,
            "markerfacecolor": "white",
            "markeredgewidth": 0.8,
        }
        for (depth, width), error in values.items():
            axes.plot(width, error * MM, **hollow, markeredgecolor=colors[depth].color)
        if values:
            axes.plot([], [], **hollow, markeredgecolor=REFERENCE_COLOR, label=name)


def _one_panel(found: Widths) -> Figure:
    figure = new_figure(COLUMN_INCH, PANEL_INCH)
    axes = figure.subplots()
    _draw_widths(axes, found)
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, columnspacing=1.2
    )
    return figure


def _three_panels(both: Sequence[Widths], curves: Sequence[LossCurve]) -> Figure:
    figure = new_figure(PAGE_INCH, PANEL_INCH)
    panels = figure.subplots(1, 3)
    for axes, found in zip(panels[:2], both, strict=True):
        _draw_widths(axes, found)
        axes.set_title(found.quantity, loc="left")
    draw_losses(panels[2], curves)
    panels[2].set_title("pre-training", loc="left")
    panels[2].legend()
    name_panels(list(panels))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    return figure
