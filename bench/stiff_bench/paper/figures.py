"""The source paper's figures, by their numbers: ours, with what the paper prints beside them.

Figures 4, 8 and 9 are regression diagrams, 5 has depth, width and pre-training of the network, 6
one unfrozen layer against two.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stiff_bench.figures.figure import Figures, Prepared
from stiff_bench.figures.losses import (
    DASHED,
    LossCurve,
    curves_of,
    draw_losses,
    has_place,
    least_at,
)
from stiff_bench.figures.samples import LINES_NOTE, Series, regression_figure
from stiff_bench.figures.source import between, marks
from stiff_bench.figures.style import (
    REFERENCE_COLOR,
    looks,
    name_panels,
    new_panels,
    plain_numbers,
    share_legend,
)
from stiff_bench.figures.variants import (
    KINDS,
    draw_lines,
    draw_strategies,
    errors_on_source,
    layers_of,
    mean_error,
    strategies,
)
from stiff_bench.paper.method_tables import METHODS, NEW, OLD
from stiff_bench.paper.results import REPRODUCE, Found, PaperResults, named_results
from stiff_bench.paper.study import (
    ACTIVATIONS,
    ADJACENT_PAIRS,
    BASE_LAYERS,
    BASE_WIDTH,
    DATASET,
    DEPTH_WIDTH,
    EARLY_STEPS,
    FT_MLP,
    PAPER_PROTOCOL,
    SEED,
    SINGLE_LAYERS,
    VJM,
    WIDTH_DEPTHS,
    WIDTHS,
    pretrained,
    unfrozen,
)
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import build_registry
from stiff_bench.plan.request import loaded
from stiff_bench.tables.metric_table import pooled_prediction
from stiff_bench.tables.published import published_errors, published_lines
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StiffBenchWarning, StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import AXES, Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DATA = f"{DATASET}, simulated: the paper's measurements are not public"
_REGRESSION = "Predicted against true deflection"


def _setting(found: Found, of: str = "", *others: Found) -> str:
    """Return data, protocol, splits (`of` what) and seed, and what must be read with them."""
    n_splits = between([len(results) for results in found.results.values()], "split")
    with_them = marks(results[0].shown for results in found.results.values())
    absent = "".join(f" {note}" for one in (found, *others) for note in one.absences())
    protocol = PAPER_PROTOCOL.name
    return f"Data: {DATA}; {protocol}, {n_splits}{of}, seed {SEED}.{with_them}{absent}"


def figure_4(_: PaperResults) -> Prepared:
    """Fit the VJM to all samples and predict them: no stored result is needed."""
    registry = build_registry()
    data = loaded(Choice.of(registry.datasets[DATASET]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)
        model = registry.model(VJM.key).load()().fit(data.samples, robot=data.robot, seed=SEED)
    samples = data.samples
    predicted = model.predict(samples.q, samples.wrench)
    tested = Prediction(np.arange(len(samples)), predicted, samples.deflection)
    caption = (
        f"The paper's Figure 4: the linear VJM ({VJM.key}), fitted to the same {len(samples)} "
        f"samples that are shown (no split). Data: {DATA}. {LINES_NOTE} In brackets: the paper's "
        "MAE (its Table 2)."
    )
    series = [Series(VJM.key, tested, _published_mae("table_2", OLD))]
    return Prepared(
        f"{_REGRESSION}, VJM fitted to them", caption, partial(regression_figure, series)
    )


def _regression(number: int, methods: Sequence[str], results: PaperResults) -> Prepared:
    """Take the methods' test samples on the splits that all have.

    Raises:
        StoreError: a method has no result.
    """
    method_of = {METHODS[method].name: method for method in methods}
    found = results.on_shared_splits(method_of, PAPER_PROTOCOL.name)
    lacking = [*found.missing, *found.failures]
    if lacking:
        why = "; ".join(found.failures.values()) or "not run"
        raise StoreError(
            f"{results.folder}: no result of {', '.join(lacking)} on {DATASET} under "
            f"{PAPER_PROTOCOL.name}: {why}; {REPRODUCE} makes it",
            "results",
        )
    series = [
        Series(
            method_of[name], pooled_prediction(results), _published_mae("table_10", method_of[name])
        )
        for name, results in found.results.items()
    ]
    models = " and ".join(f"{method} ({name})" for name, method in method_of.items())
    caption = (
        f"The paper's Figure {number}: {models} on the test samples of all splits. "
        f"{_setting(found)} {LINES_NOTE} In brackets: the paper's MAE (its Table 10)."
    )
    title = f"{_REGRESSION}, {' and '.join(methods)}"
    return Prepared(title, caption, partial(regression_figure, series))


def _published_mae(table: str, method: str) -> tuple[float, ...]:
    """Return a method's published mean absolute errors along x, y and z, m."""
    values = published_errors(table)[method]
    return tuple(values["mae", axis] / MM for axis in AXES)


PANEL_INCH = 2.7


def figure_6(results: PaperResults) -> Prepared:
    """Take the fine-tunings that move one hidden layer, or two adjacent ones.

    Raises:
        StoreError: there is none of one kind.
    """
    names = [unfrozen(layers).name for layers in (*SINGLE_LAYERS, *ADJACENT_PAIRS)]
    found = results.on_shared_splits((*names, VJM.name), PAPER_PROTOCOL.name)
    tuned = [one for name, of in found.results.items() if name != VJM.name for one in of]
    errors = strategies(tuned)
    for kind in KINDS[:2]:
        if kind not in set(errors["kind"]):
            raise StoreError(
                f"{results.folder}: no result of {FT_MLP.key} under {PAPER_PROTOCOL.name} that "
                f"moves {kind}; {REPRODUCE} makes it",
                "results",
            )
    linear = [mean_error(one) for one in found.results.get(VJM.name, ())]
    caption = (
        f"The paper's Figure 6: {FT_MLP.key} with one hidden layer unfrozen (dashed) or two. (a) "
        "Validation loss of the fine-tuning, first split; mark: least of the stored epochs. (b) "
        "MAE of the test part at the epoch that was kept, all axes together; symbol: mean over the "
        f"splits, bars: splits. {_setting(found)}"
    )
    first = [
        next(one for one in tuned if layers_of(one) == name) for name in errors["layers"].unique()
    ]
    mean_linear = float(np.mean(linear)) if linear else None
    paint = partial(_draw_strategies, first, errors, mean_linear)
    return Prepared("One unfrozen layer against two", caption, paint)


def _draw_strategies(
    first: Sequence[CellResult], errors: pd.DataFrame, linear: float | None
) -> Figure:
    figure, (left, right) = new_panels(2, PANEL_INCH, 0.0)
    for result, look in zip(first, looks(len(first)), strict=True):
        step, _, loss = result.curves.get("fine-tuning", np.full((1, 3), np.nan)).T
        if has_place(loss).any():
            pair, best = "+" in layers_of(result), least_at(loss)
            left.plot(
                *(step, loss),
                **look.points() | {"linestyle": "-" if pair else DASHED},
                markevery=[best],
                markersize=4.5,
                label=f"layer{'s' * pair} {layers_of(result)}",
            )
            left.plot(step[best], loss[best], **look.points(), markersize=4.5, zorder=4.0)
    left.set(xscale="log", yscale="log", xlabel="epochs", ylabel="validation loss [standardised]")
    plain_numbers(left.xaxis)
    plain_numbers(left.yaxis, (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))  # often less than a decade
    if left.lines:
        share_legend(figure, [left], below=True)
    draw_strategies(right, errors, linear)
    name_panels([left, right])
    return figure


FEWEST_WIDTHS = 2
QUANTITIES = ("MAE", "STDE")


def figure_5(results: PaperResults) -> Prepared:
    """Take the networks of Figure 5 that the folder has, and the pre-trainings by activation.

    Raises:
        StoreError: a depth has fewer than two widths, or no activation has a training curve.
    """
    names = [pretrained(layers=d, width=width).name for width in WIDTHS for d in WIDTH_DEPTHS]
    found = results.of_models(names, PAPER_PROTOCOL.name)
    n_widths = errors_on_source(found.each).groupby("depth")["width"].nunique()
    few = [str(depth) for depth in WIDTH_DEPTHS if n_widths.get(depth, 0) < FEWEST_WIDTHS]
    if few:
        raise StoreError(
            f"{results.folder}: fewer than {FEWEST_WIDTHS} widths of {', '.join(few)} "
            f"hidden layers have results under {PAPER_PROTOCOL.name}; {REPRODUCE} makes them"
            + "".join(f"; {reason}" for reason in found.failures.values()),
            "results",
        )
    stopped = [pretrained(layers=d, width=DEPTH_WIDTH, stopped_early=True) for d in WIDTH_DEPTHS]
    stopped.append(pretrained(stopped_early=True))
    early = results.of_models([one.name for one in stopped], PAPER_PROTOCOL.name)
    activations = {pretrained(activation=kind).name: kind for kind in reversed(ACTIVATIONS)}
    trained = results.on_shared_splits(activations, PAPER_PROTOCOL.name)
    curves = [
        curve
        for name, (first, *_) in trained.results.items()
        for curve in curves_of(first, activations[name])
    ]
    if not curves:
        raise StoreError(
            f"{results.folder}: {', '.join(trained.results)}: no training curve; "
            f"{REPRODUCE} in another folder makes one",
            "results",
        )
    caption = (
        "The paper's Figure 5: (a) MAE and (b) STDE of pre-trained networks on the simulated "
        "pre-training data, all axes together. Solid: test part (30 %), with a band over the "
        "splits; dashed: training part. Hollow stars: the paper's test part (its Tables 6 and 7); "
        f"hollow circles: ours stopped after {EARLY_STEPS} steps of plain Adam. (c) Pre-training "
        f"loss of {BASE_LAYERS} x {BASE_WIDTH} nodes by activation, first split (Huber loss of "
        "standardised targets; the paper's is the mean square). "
        f"{_setting(found, ' a network', early, trained)}"
    )
    paint = partial(_draw_networks, found.each, early.each, curves)
    return Prepared("Depth, width and pre-training of the network", caption, paint)


def _published_on_source(quantity: str) -> pd.DataFrame:
    """Return what the paper's Tables 6 and 7 say of networks of our depths: depth, width, error."""
    column = f"test_{quantity.lower()}_mm"
    of_depth = [
        (int(line["layers"]), DEPTH_WIDTH, float(line[column]))
        for line in published_lines("table_6")
        if int(line["layers"]) in WIDTH_DEPTHS
    ]
    by_activation = {line["activation"]: float(line[column]) for line in published_lines("table_7")}
    rows = [*of_depth, (BASE_LAYERS, BASE_WIDTH, by_activation["relu"])]
    return pd.DataFrame(rows, columns=["depth", "width", "error"])


def _draw_networks(
    networks: list[CellResult], early: list[CellResult], curves: list[LossCurve]
) -> Figure:
    figure, panels = new_panels(3, PANEL_INCH, 0.0)
    for axes, quantity in zip(panels, QUANTITIES, strict=False):
        draw_lines(axes, errors_on_source(networks, quantity), legend=False)
        thin = {"errorbar": None, "markers": False, "linestyle": DASHED, "linewidth": 0.8}
        draw_lines(axes, errors_on_source(networks, quantity, "training"), legend=False, **thin)
        _mark(axes, _published_on_source(quantity), "*", 6.0)
        of_early = errors_on_source(early, quantity).groupby(["depth", "width"], as_index=False)
        _mark(axes, of_early.mean(), "o", 4.0)
        axes.set_ylabel(f"pre-training {quantity} [mm]")
    for depth, look in zip(WIDTH_DEPTHS, looks(len(WIDTH_DEPTHS)), strict=True):
        panels[0].plot([], [], color=look.color, marker=look.marker, label=f"{depth} hidden layers")
    panels[0].plot([], [], color=REFERENCE_COLOR, linestyle=DASHED, label="training part")
    for marker, size, label in (("*", 6.0, "paper"), ("o", 4.0, "stopped early")):
        panels[0].plot([], [], marker, ms=size, color=REFERENCE_COLOR, mfc="white", label=label)
    draw_losses(panels[2], curves)
    panels[2].legend()
    for axes, title in zip(panels, (*QUANTITIES, "pre-training"), strict=True):
        axes.set_title(title, loc="left")
    name_panels(panels)
    share_legend(figure, panels[:1], below=True, ncols=6)
    return figure


def _mark(axes: Axes, errors: pd.DataFrame, marker: str, size: float) -> None:
    """Draw errors to hold ours against, hollow, in the depths' colours."""
    for depth, look in zip(WIDTH_DEPTHS, looks(len(WIDTH_DEPTHS)), strict=True):
        of_depth = errors[errors["depth"] == depth]
        axes.plot(
            *(of_depth["width"], of_depth["error"], marker),
            color=look.color,
            markersize=size,
            markerfacecolor="white",
            markeredgewidth=0.8,
        )


FIGURES: Figures[PaperResults] = {
    "4": figure_4,
    "5": figure_5,
    "6": figure_6,
    "8": partial(_regression, 8, ("DT-CNN",)),
    "9": partial(_regression, 9, (NEW, OLD)),
}


def prepare_figure(name: str, folder: Path | None) -> Prepared:
    """Return one of the paper's figures; folder, None and errors are those of `named_results`."""
    made_of = "is fitted here" if name == "4" else ""
    return FIGURES[name](named_results(folder, f"figure {name}", made_of=made_of))
