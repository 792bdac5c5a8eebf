"""Draw the source paper's figures from our results, with the paper's own numbers.

Figures 4, 8 and 9 are regression diagrams, 5 has depth, width and pre-training of the network, 6
one unfrozen layer against two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiff_bench.figures import losses, style, variants
from stiff_bench.figures.losses import DASHED
from stiff_bench.figures.prepared_figure import Figures, Prepared
from stiff_bench.figures.samples import LINES_NOTE, regression_figure
from stiff_bench.paper import paper_models as models
from stiff_bench.paper.paper_models import DATASET, PAPER_PROTOCOL, WIDTH_DEPTHS, pretrained
from stiff_bench.paper.paper_results import PaperResults, ProtocolResults, named_results
from stiff_bench.paper.paper_tables import METHODS, NEW, OLD, ON_SOURCE, fitted_vjm
from stiff_bench.results.fit_values import pooled_prediction
from stiff_bench.results.load import split_of
from stiff_bench.tables.published import published_errors, published_lines
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import FitResult
from stiff_protocols.contract.types import AXES, Prediction

DATA = f"Data: {DATASET}, simulated: the paper's measurements are not public"
SUBTITLE = f"{DATASET} (simulated)"
PANEL_INCH = 2.7
QUANTITIES = ("MAE", "STDE")


def _setting(*plotted: ProtocolResults) -> str:
    """Return the setting of the first results, and what is missing in all of them."""
    absences = "".join(f" {note}" for results in plotted for note in results.absences())
    return f"{DATA}; {plotted[0].setting}{absences}"


def figure_4(_: PaperResults) -> Prepared:
    """Show errors over true deflection of the VJM, fitted to the same samples."""
    tested = fitted_vjm()[0]
    n_samples = f"the same {len(tested.rows)} samples that are shown"
    about = f"the linear VJM (vjm), fitted to {n_samples} (no split). {DATA}."
    return _regression(4, "VJM fitted to them", about, {"vjm": tested}, table=2)


def figure_8(results: PaperResults) -> Prepared:
    """Show errors over true deflection of DT-CNN."""
    return _tested(8, ("DT-CNN",), results)


def figure_9(results: PaperResults) -> Prepared:
    """Show errors over true deflection of FT-MLP and the VJM."""
    return _tested(9, (NEW, OLD), results)


def _tested(number: int, methods: Sequence[str], results: PaperResults) -> Prepared:
    """Draw the test samples of the methods on their shared splits.

    Raises:
        StoreError: a method failed or has no result.
    """
    compared = results.on_shared_splits([METHODS[method] for method in methods], PAPER_PROTOCOL)
    if compared.failures or compared.missing:
        reason = " ".join(compared.absences())
        raise StoreError(f"{results.folder}: {reason.removesuffix('.')}", "results")
    tested = {
        method: pooled_prediction(compared.results[METHODS[method].name]) for method in methods
    }
    names = " and ".join(f"{method} ({METHODS[method].name})" for method in methods)
    about = f"{names} on the test samples of all splits. {_setting(compared)}"
    return _regression(number, " and ".join(methods), about, tested, table=10)


def _regression(
    number: int, title: str, about: str, tested: Mapping[str, Prediction], *, table: int
) -> Prepared:
    """Draw predictions of methods, with their mean absolute errors in a table of the paper."""
    errors = published_errors(f"table_{table}")
    # m; the paper has its methods in capitals
    published = {name: [errors[name.upper()]["mae", at] / MM for at in AXES] for name in tested}
    caption = (
        f"The paper's Figure {number}: {about} {LINES_NOTE} In brackets: the paper's MAE "
        f"(its Table {table})."
    )
    paint = partial(regression_figure, tested, published)
    return Prepared(
        f"Error over true deflection, {title}", caption, paint, f"{DATASET} (simulated)"
    )


def figure_6(results: PaperResults) -> Prepared:
    """Show fine-tunings that move one hidden layer, or two adjacent ones."""
    moving = map(models.unfrozen, (*models.SINGLE_LAYERS, *models.ADJACENT_PAIRS))
    strategies = results.on_shared_splits(moving, PAPER_PROTOCOL)
    fits = strategies.all_fits
    splits = {split_of(fit) for fit in fits}
    vjm_fits = results.of_models([models.VJM], PAPER_PROTOCOL).all_fits
    errors = variants.strategies(fits)
    first = {variants.layers_of(fit): fit for fit in reversed(fits)}
    curves = {layers: first[layers] for layers in errors["layers"].unique()}
    caption = (
        "The paper's Figure 6: ft-mlp with one hidden layer unfrozen (dashed) or two. (a) "
        "Validation loss of the fine-tuning, first split; mark: least of the stored epochs. (b) "
        "MAE of the test part at the epoch that was kept, all axes together; symbol: mean over the "
        f"splits, ticks: splits, dashed line: the VJM. {_setting(strategies)}"
    )
    linear = [variants.mean_absolute_error_mm(fit) for fit in vjm_fits if split_of(fit) in splits]
    paint = partial(_draw_strategies, curves, errors, linear)
    return Prepared("One unfrozen layer against two", caption, paint, SUBTITLE)


def _draw_strategies(
    first: Mapping[str, FitResult], errors: pd.DataFrame, linear: Sequence[float]
) -> Figure:
    figure, (loss_axes, error_axes) = style.new_panels(2, PANEL_INCH, 0.0)
    kinds = dict(zip(errors["layers"], errors["kind"], strict=True))
    looks = style.looks_of(first)
    for layers, result in first.items():
        step, _, loss = result.curves.get("fine-tuning", np.full((1, 3), np.nan)).T
        if losses.has_place(loss).any():
            pair, best = kinds[layers] == variants.PAIR, losses.least_at(loss)
            points = looks[layers].points() | {"markersize": 4.5}
            line = points | {"linestyle": "-" if pair else DASHED, "markevery": [best]}
            loss_axes.plot(step, loss, **line, label=f"layer{'s' * pair} {layers}")
            loss_axes.plot(step[best], loss[best], **points, zorder=4.0)
    loss_axes.set(
        xscale="log", yscale="log", xlabel="epochs", ylabel="validation loss [standardised]"
    )
    style.plain_numbers(loss_axes.xaxis)
    style.plain_numbers(loss_axes.yaxis, style.FINE_STEPS)
    variants.draw_strategies(error_axes, errors, linear)
    loss_axes.set_title("fine-tuning, first split", loc="left")
    error_axes.set_title("errors of the splits", loc="left")
    style.name_panels([loss_axes, error_axes])
    style.share_legend(figure, [loss_axes, error_axes], ncols=6)
    return figure


def figure_5(results: PaperResults) -> Prepared:
    """Show errors of pre-trained networks by depth and width, and losses by activation."""
    swept = [pretrained(layers=d, width=width) for width in models.WIDTHS for d in WIDTH_DEPTHS]
    sweep = results.on_shared_splits(swept, PAPER_PROTOCOL)
    width = models.DEPTH_WIDTH
    stopped = [pretrained(layers=d, width=width, stopped_early=True) for d in WIDTH_DEPTHS]
    early = results.of_models([*stopped, pretrained(stopped_early=True)], PAPER_PROTOCOL)
    networks = {
        kind: pretrained(**options) for kind, options in reversed(models.BY_ACTIVATION.items())
    }
    trained = results.of_models(networks.values(), PAPER_PROTOCOL)
    curves = [
        curve
        for kind, network in networks.items()
        for first in trained.results.get(network.name, ())[:1]
        for curve in losses.curves_of(first, kind)
    ]
    caption = (
        "The paper's Figure 5: (a) MAE and (b) STDE of pre-trained networks on the simulated "
        "pre-training data, all axes together. Solid: test part (30 %), with a band over the "
        "splits; dashed: training part. Hollow stars: the paper's test part (its Tables 6 and 7); "
        f"hollow circles: ours stopped after {models.EARLY_STEPS} steps of plain Adam. (c) "
        f"Pre-training loss of {models.BASE_LAYERS} x {models.BASE_WIDTH} nodes by activation, "
        "first split (Huber loss of standardised targets; the paper's is the mean square). "
        f"{_setting(sweep, early, trained)}"
    )
    paint = partial(_draw_networks, sweep.all_fits, early.all_fits, curves)
    return Prepared("Depth, width and pre-training of the network", caption, paint, SUBTITLE)


def _published_on_source(quantity: str) -> pd.DataFrame:
    """Return the errors of the paper's Tables 6 and 7 by depth and width."""
    column = f"test_{quantity.lower()}_mm"
    by_depth = {line["layers"]: float(line[column]) for line in published_lines("table_6")}
    by_activation = {line["activation"]: float(line[column]) for line in published_lines("table_7")}
    rows = [(depth, models.DEPTH_WIDTH, by_depth[str(depth)]) for depth in WIDTH_DEPTHS]
    rows.append((models.BASE_LAYERS, models.BASE_WIDTH, by_activation["relu"]))
    return pd.DataFrame(rows, columns=["depth", "width", "error"])


def _draw_networks(
    networks: list[FitResult], early: list[FitResult], curves: list[losses.LossCurve]
) -> Figure:
    figure, panels = style.new_panels(3, PANEL_INCH, 0.0)
    thin = {"errorbar": None, "markers": False, "linestyle": DASHED, "linewidth": 0.8}
    for axes, quantity in zip(panels, QUANTITIES, strict=False):
        test, training = ON_SOURCE[f"test {quantity}"], ON_SOURCE[f"train {quantity}"]
        errors_on = variants.errors_on_source
        variants.draw_lines(axes, errors_on(networks, test), legend=False)
        variants.draw_lines(axes, errors_on(networks, training), legend=False, **thin)
        _mark(axes, _published_on_source(quantity), "*", 6.0)
        _mark(axes, errors_on(early, test).groupby(["depth", "width"], as_index=False).mean(), "o")
        axes.set_ylabel(f"pre-training {quantity} [mm]")
    legend = panels[0]
    for depth, look in style.looks_of(WIDTH_DEPTHS).items():
        legend.plot([], [], color=look.color, marker=look.marker, label=f"{depth} hidden layers")
    legend.plot([], [], color=style.REFERENCE_COLOR, linestyle=DASHED, label="training part")
    for marker, size, label in (("*", 6.0, "paper"), ("o", 4.0, "stopped early")):
        legend.plot([], [], marker, ms=size, color=style.REFERENCE_COLOR, mfc="white", label=label)
    losses.draw_losses(panels[2], curves, style.looks_of(curve.name for curve in curves))
    panels[2].legend()
    for axes, title in zip(panels, (*QUANTITIES, "pre-training"), strict=True):
        axes.set_title(title, loc="left")
    style.name_panels(panels)
    style.share_legend(figure, [legend], ncols=6)
    return figure


def _mark(axes: Axes, errors: pd.DataFrame, marker: str, size: float = 4.0) -> None:
    """Draw errors for comparison as hollow markers in the depths' colours."""
    for depth, look in style.looks_of(WIDTH_DEPTHS).items():
        rows = errors[errors["depth"] == depth]
        hollow: dict[str, Any] = {"color": look.color, "ms": size, "mfc": "white", "mew": 0.8}
        axes.plot(rows["width"], rows["error"], marker, **hollow)


FIGURES: Figures[PaperResults] = {
    "4": figure_4,
    "5": figure_5,
    "6": figure_6,
    "8": figure_8,
    "9": figure_9,
}


def prepare_figure(name: str, folder: Path | None) -> Prepared:
    """Return one of the paper's figures; folder and errors as in `named_results`."""
    made_of = "is fitted here" if name == "4" else ""
    return FIGURES[name](named_results(folder, f"figure {name}", made_of=made_of))
