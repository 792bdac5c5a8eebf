"""The source paper's figures, by their names: ours, with what the paper prints beside them.

Figures 4, 8 and 9 are regression diagrams, 5 has depth, width and pre-training of the network, 6
one unfrozen layer against two. The paper's 5 (a) and (b) show errors on the source domain over the
nodes a layer; ours has the mean absolute error in (a) and its standard deviation in (b).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stiff_bench.figures.figure import Content, FigureLine, Prepared, by_name
from stiff_bench.figures.losses import (
    LossCurve,
    curves_of,
    draw_losses,
    has_place,
    least_at,
    losses_figure,
)
from stiff_bench.figures.samples import SHARE, Series, regression_figure
from stiff_bench.figures.source import Predicted, between, marks, pooled
from stiff_bench.figures.style import (
    COLUMN_INCH,
    PAGE_INCH,
    REFERENCE_COLOR,
    looks,
    name_panels,
    new_figure,
    plain_numbers,
    share_legend,
)
from stiff_bench.figures.variants import (
    KINDS,
    TEST,
    TRAIN,
    Strategy,
    Sweep,
    draw_lines,
    draw_strategies,
    freeze_of,
    in_order,
    mean_error,
    sweep_of,
)
from stiff_bench.paper import PAPER_RESULTS
from stiff_bench.paper.results import FULL, REPRODUCE, Found, PaperResults
from stiff_bench.paper.study import (
    ACTIVATIONS,
    ADJACENT_PAIRS,
    BASE_LAYERS,
    BASE_WIDTH,
    DATASET,
    DEPTH_WIDTH,
    DT_CNN,
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
from stiff_bench.tables.published import published_lines, published_rows
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import ConfigError, StiffBenchWarning, StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import AXES, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DATA = f"{DATASET}, simulated: the paper's measurements are not public"


def _setting(results: Mapping[str, Sequence[CellResult]], each: str = "") -> str:
    """Return data, protocol, splits and seed in a sentence, and what must be read with them.

    Args:
        results: model -> its results that are shown.
        each: of what there are so many splits, where the numbers may differ, such as "a network".
    """
    n_splits = " ".join(filter(None, (between(list(map(len, results.values())), "split"), each)))
    said = marks(found[0].shown for found in results.values())
    return f"Data: {DATA}; protocol: {PAPER_PROTOCOL}; {n_splits}, seed {SEED}.{said}"


_LINES = (
    f"Grey: identity; coloured lines: identity ± the error that {SHARE:.0%} of the samples keep."
)


def figure_4(_: PaperResults) -> Content:
    """Fit the VJM to all samples and predict them: no stored result is needed."""
    registry = build_registry()
    data = loaded(Choice.of(registry.datasets[DATASET]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)
        model = registry.model(VJM).load()().fit(data.samples, robot=data.robot, seed=SEED)
    samples = data.samples
    tested = Predicted(
        rows=np.arange(len(samples)),
        measured=samples.deflection,
        predicted=model.predict(samples.q, samples.wrench),
    )
    caption = (
        f"The paper's Figure 4: measured deflection against that of the linear VJM ({VJM}), fitted "
        f"to the same {len(samples)} samples that are shown (in sample, no split). Data: {DATA}. "
        f"{_LINES} Beside our MAE: the paper's (its Table 2)."
    )
    series = [Series(VJM, tested, _published_mae("table_2", VJM))]
    return Content(caption, partial(regression_figure, series))


def figure_8(results: PaperResults) -> Content:
    """Take DT-CNN's test samples."""
    return _regression(
        results, f"The paper's Figure 8: measured deflection against that of {DT_CNN}", DT_CNN
    )


def figure_9(results: PaperResults) -> Content:
    """Take the test samples of FT-MLP and the VJM."""
    shown = f"The paper's Figure 9: measured deflection against that of {FT_MLP} and of {VJM}"
    return _regression(results, shown, FT_MLP, VJM)


def _regression(results: PaperResults, shown: str, *models: str) -> Content:
    """Take the models' test samples on the splits that all have.

    Raises:
        StoreError: a model has no result.
    """
    found = results.on_shared_splits(models, PAPER_PROTOCOL)
    lacking = [*found.missing, *found.failures]
    if lacking:
        why = "; ".join(found.failures.values()) or "not run"
        raise StoreError(
            f"--results {results.folder}: no result of {', '.join(lacking)} on {DATASET} under "
            f"{PAPER_PROTOCOL}: {why}; {REPRODUCE} makes it"
        )
    series = [
        Series(name, pooled(of_model), _published_mae("table_10", name))
        for name, of_model in found.results.items()
    ]
    setting = " ".join([_setting(found.results), *found.absences()])
    caption = (
        f"{shown}, of the test samples of all splits together. {setting} {_LINES} Beside our MAE: "
        "the paper's (its Table 10, of its own measurements)."
    )
    return Content(caption, partial(regression_figure, series, overlaid=len(models) > 1))


def _published_mae(table: str, model: str) -> tuple[float, ...]:
    """Return a method's published mean absolute errors along x, y and z, m."""
    name = {VJM: "VJM", FT_MLP: "FT-MLP", DT_CNN: "DT-CNN"}[model]
    row = next(row for row in published_rows(table) if row.method == name)
    return tuple(row.values_mm["mae", axis] / MM for axis in AXES)


STRATEGIES_INCH = 2.7


def figure_6(results: PaperResults) -> Content:
    """Take the fine-tunings that move one hidden layer, or two adjacent ones.

    Raises:
        StoreError: there is none of one kind.
    """
    names = [unfrozen(layers).name for layers in (*SINGLE_LAYERS, *ADJACENT_PAIRS)]
    found = results.on_shared_splits((*names, VJM), PAPER_PROTOCOL)
    tuned = [of_model for name, of_model in found.results.items() if name != VJM]
    strategies = in_order(
        [Strategy(freeze_of(of[0]), np.array(list(map(mean_error, of)))) for of in tuned]
    )
    for kind in KINDS[:2]:
        if not any(one.kind == kind for one in strategies):
            raise StoreError(
                f"--results {results.folder}: no result of {FT_MLP} under {PAPER_PROTOCOL} that "
                f"moves {kind}; {REPRODUCE} makes it"
            )
    curves = {freeze_of(of[0]): of[0].curves.get("fine-tuning") for of in tuned}
    of_vjm = [mean_error(one) for one in found.results.get(VJM, ())]
    linear = float(np.mean(of_vjm)) if of_vjm else None
    dashed = f"; dashed: {VJM}" if of_vjm else ""
    caption = (
        f"The paper's Figure 6: {FT_MLP} with one hidden layer unfrozen against two adjacent ones "
        "(numbered from the input). (a) Mean absolute error of the validation part, standardised, "
        "against epochs of the fine-tuning, first split; mark: least of the stored points (every "
        "tenth epoch). (b) Mean absolute error of the test part at the epoch that was kept, all "
        "axes together; symbol: mean over the splits, bars and line: single splits and their "
        f"span{dashed}. {' '.join([_setting(found.results), *found.absences()])}"
    )
    return Content(caption, partial(_draw_strategies, strategies, curves, linear))


def _draw_strategies(
    strategies: Sequence[Strategy],
    curves: dict[str, FloatArray | None],
    linear: float | None,
) -> Figure:
    figure = new_figure(PAGE_INCH, STRATEGIES_INCH)
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


Quantity = Literal["MAE", "STDE"]
FEWEST_WIDTHS = 2
PANEL_INCH = 2.7
_SWEEP = (
    "of pre-trained networks on the simulated source domain, all axes together, against nodes a "
    "hidden layer. Solid: the source's test part (30 %), with a band from the least to the largest "
    "of a network's splits; dashed: its training part. Hollow, in the depths' colours, on the test "
    "part: stars, the paper's values (its Tables 6 and 7); circles, where they were computed, "
    f"our networks stopped after {EARLY_STEPS} steps of plain Adam."
)
_LOSS = (
    f"loss of the pre-training of a network of {BASE_LAYERS} x {BASE_WIDTH} nodes against "
    "iterations (Huber loss of standardised targets; the paper's is the mean square)"
)


@dataclass(frozen=True, eq=False)
class Widths:
    """What (a) or (b) shows.

    Attributes:
        quantity: "MAE" or "STDE".
        test, train: ours.
        marks: name -> (depth, nodes a layer) -> a value on the test part to hold it against, m.
        setting: what must be read with the lines.
    """

    quantity: Quantity
    test: Sweep
    train: Sweep
    marks: Mapping[str, Mapping[tuple[int, int], float]]
    setting: str


def figure_5a(results: PaperResults) -> Content:
    """Take the mean absolute errors over widths."""
    found = _widths(results, "MAE")
    return Content(f"The paper's Figure 5a: MAE {_SWEEP} {found.setting}", partial(_one, found))


def figure_5b(results: PaperResults) -> Content:
    """Take the standard deviations of the absolute error over widths."""
    found = _widths(results, "STDE")
    return Content(f"The paper's Figure 5b: STDE {_SWEEP} {found.setting}", partial(_one, found))


def figure_5c(results: PaperResults) -> Content:
    """Take the losses of the pre-training."""
    found = _pretrainings(results)
    caption = (
        f"The paper's Figure 5c: {_LOSS}, by activation; the paper's is ReLU, of 100,000 "
        f"iterations. Of the first split that all have. {_setting(found.results)} "
        f"{_absent(found, len(ACTIVATIONS))}"
    )
    return Content(caption.strip(), partial(losses_figure, _curves(found)))


def figure_5(results: PaperResults) -> Content:
    """Take all three."""
    mae, stde, shown = _widths(results, "MAE"), _widths(results, "STDE"), _pretrainings(results)
    caption = (
        f"The paper's Figure 5: (a) MAE and (b) STDE {_SWEEP} {mae.setting} (c): {_LOSS}, of the "
        f"first split that all have. {_absent(shown, len(ACTIVATIONS))}"
    )
    return Content(caption.strip(), partial(_all_three, (mae, stde), _curves(shown)))


def _widths(results: PaperResults, quantity: Quantity) -> Widths:
    """Return the errors of the networks of Figure 5 that the folder has.

    Raises:
        StoreError: a depth has fewer than two widths.
    """
    names = [pretrained(layers=d, width=width).name for width in WIDTHS for d in WIDTH_DEPTHS]
    found = results.of_models(names, PAPER_PROTOCOL)
    test, train = (sweep_of(_each(found), part, quantity) for part in (TEST, TRAIN))
    short = [d for d in WIDTH_DEPTHS if sum(d == of for of, _ in test.values) < FEWEST_WIDTHS]
    if short:
        depths = ", ".join(map(str, short))
        reasons = "".join(f"; {reason}" for reason in found.failures.values())
        raise StoreError(
            f"--results {results.folder}: fewer than {FEWEST_WIDTHS} widths of {depths} hidden "
            f"layers have results under {PAPER_PROTOCOL}; {REPRODUCE} makes them{reasons}"
        )
    stopped = [pretrained(layers=d, width=DEPTH_WIDTH, stopped_early=True) for d in WIDTH_DEPTHS]
    stopped.append(pretrained(stopped_early=True))
    early = results.of_models([one.name for one in stopped], PAPER_PROTOCOL)
    stopped_early = sweep_of(_each(early), TEST, quantity).values
    tried = replace(found, failures={**found.failures, **early.failures})
    return Widths(
        quantity,
        test,
        train,
        {
            "paper": _published_on_source(quantity),
            "stopped early": {size: float(of.mean()) for size, of in stopped_early.items()},
        },
        f"{_setting(found.results, 'a network')} {_absent(tried, len(names))}".strip(),
    )


def _each(found: Found) -> list[CellResult]:
    return [one for of_model in found.results.values() for one in of_model]


def _absent(tried: Found, n_all: int) -> str:
    """Say which of `n_all` networks have no numbers; "" where all have."""
    n_missing = len(tried.missing)
    lines = [f"Not run: {n_missing} of {n_all} networks; {FULL} makes them."] if n_missing else []
    return " ".join([*lines, *(f"No numbers: {why}." for why in tried.failures.values())])


def _published_on_source(quantity: Quantity) -> dict[tuple[int, int], float]:
    """Return what the paper's Tables 6 and 7 say of networks of these depths, m."""
    column = f"test_{quantity.lower()}_mm"
    of_depth = {
        (int(line["layers"]), DEPTH_WIDTH): float(line[column]) / MM
        for line in published_lines("table_6")
        if int(line["layers"]) in WIDTH_DEPTHS
    }
    by_activation = {line["activation"]: line for line in published_lines("table_7")}
    return of_depth | {(BASE_LAYERS, BASE_WIDTH): float(by_activation["relu"][column]) / MM}


def _pretrainings(results: PaperResults) -> Found:
    """Return the pre-trainings of the first split that all activations have.

    Raises:
        StoreError: there is none.
    """
    names = [pretrained(activation=kind).name for kind in reversed(ACTIVATIONS)]
    found = results.on_shared_splits(names, PAPER_PROTOCOL)
    first = replace(found, results={name: of[:1] for name, of in found.results.items()})
    if not _curves(first):
        raise StoreError(
            f"--results {results.folder}: {', '.join(first.results)}: no training curve; "
            f"{REPRODUCE} in another folder makes one"
        )
    return first


def _curves(found: Found) -> list[LossCurve]:
    """Return the loss curves of pre-trainings, one a network, named after its activation."""
    names = {pretrained(activation=kind).name: kind for kind in ACTIVATIONS}
    return [
        curve
        for name, (result,) in found.results.items()
        for curve in curves_of(result, names[name])
    ]


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


def _one(found: Widths) -> Figure:
    figure = new_figure(COLUMN_INCH, PANEL_INCH)
    axes = figure.subplots()
    _draw_widths(axes, found)
    share_legend(figure, [axes], below=True, ncols=2, columnspacing=1.2)
    return figure


def _all_three(both: Sequence[Widths], curves: Sequence[LossCurve]) -> Figure:
    figure = new_figure(PAGE_INCH, PANEL_INCH)
    panels = figure.subplots(1, 3)
    for axes, found in zip(panels[:2], both, strict=True):
        _draw_widths(axes, found)
        axes.set_title(found.quantity, loc="left")
    draw_losses(panels[2], curves)
    panels[2].set_title("pre-training", loc="left")
    panels[2].legend()
    name_panels(list(panels))
    share_legend(figure, panels[:1], below=True, ncols=6)
    return figure


FIGURES: Mapping[str, FigureLine[PaperResults]] = by_name(
    (
        FigureLine("4", "Measured against VJM-fitted", figure_4),
        FigureLine("5a", "MAE over nodes a layer", figure_5a),
        FigureLine("5b", "STDE over nodes a layer", figure_5b),
        FigureLine("5c", "Loss of the pre-training", figure_5c),
        FigureLine("5", "Depth, width and pre-training of the network", figure_5),
        FigureLine("6", "One unfrozen layer against two", figure_6),
        FigureLine("8", "Measured against DT-CNN", figure_8),
        FigureLine("9", "Measured against FT-MLP and VJM", figure_9),
    )
)
_FITTED_FIGURE = "4"


def prepare_figure(name: str, folder: Path | None) -> Prepared:
    """Return one of the paper's figures from the results of a folder.

    Args:
        name: of the figure.
        folder: of the results; None: where `bench reproduce` puts them.

    Raises:
        ConfigError: a folder was named that is not read.
        StoreError: the results have nothing of it.
    """
    if name != _FITTED_FIGURE:
        return FIGURES[name].prepare(PaperResults.of(folder or PAPER_RESULTS))
    if folder is not None:
        raise ConfigError(f"--results {folder}: figure {name} is fitted here and reads none")
    return FIGURES[name].prepare(PaperResults(PAPER_RESULTS, ()))
