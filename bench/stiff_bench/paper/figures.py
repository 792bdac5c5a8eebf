"""The paper's figures beside ours.

Figures 4, 8 and 9: measured against predicted. Figure 5: depth and width of the network, and its
pre-training; the paper's (a) and (b) show errors on the source domain over the nodes a layer, ours
has the mean absolute error in (a) and its standard deviation in (b). Figure 6: which layers move.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stiff_bench.figures.figure import Content
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
from stiff_bench.paper.names import (
    ACTIVATIONS,
    ADJACENT_PAIRS,
    BASE_LAYERS,
    BASE_WIDTH,
    DT_CNN,
    EARLY_STEPS,
    FT_MLP,
    SINGLE_LAYERS,
    VJM,
    pretrained,
    unfrozen,
)
from stiff_bench.paper.results import (
    FULL,
    PaperResults,
    SharedSplits,
    TriedModels,
    shared_splits,
    tried_models,
)
from stiff_bench.paper.study import DATASET, DEPTH_WIDTH, PAPER_PROTOCOL, SEED, WIDTH_DEPTHS, WIDTHS
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import build_registry
from stiff_bench.plan.request import loaded
from stiff_bench.tables.published import published_lines, published_rows
from stiff_bench.tables.units import MM
from stiff_protocols.contract.errors import StiffBenchWarning, StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import AXES, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


DATA = f"{DATASET}, simulated: the paper's measurements are not public"


def paper_setting(results: Mapping[str, Sequence[CellResult]], each: str = "") -> str:
    """Return data, protocol, splits and seed in a sentence, and what must be read with them.

    Args:
        results: model -> its results that are shown.
        each: of what there are so many splits, where the numbers may differ, such as "a network".
    """
    n_splits = " ".join(filter(None, (between(list(map(len, results.values())), "split"), each)))
    said = marks(found[0].shown for found in results.values())
    return f"Data: {DATA}; protocol: {PAPER_PROTOCOL}; {n_splits}, seed {SEED}.{said}"


HEIGHT_INCH = 2.7
FEWEST = 1  # of each kind
"""Single layers and pairs that must be there to be held against each other."""


def figure_6(results: PaperResults) -> Content:
    """Take the fine-tunings that move one hidden layer, or two adjacent ones.

    Raises:
        StoreError: there is none of one kind.
    """
    names = [unfrozen(layers).name for layers in (*SINGLE_LAYERS, *ADJACENT_PAIRS)]
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


Quantity = Literal["MAE", "STDE"]
_STOPPED_EARLY = (
    *(pretrained(layers=d, width=DEPTH_WIDTH, stopped_early=True).name for d in WIDTH_DEPTHS),
    pretrained(stopped_early=True).name,
)
FEWEST_WIDTHS = 2
PANEL_INCH = 2.7
_LETTERS: Mapping[Quantity, str] = {"MAE": "a", "STDE": "b"}
_LINES = (
    "Solid: the source's test part (30 %), with a band from the least to the largest of a "
    "network's splits; dashed: its training part. Hollow, in the depths' colours, on the test "
    "part: stars, the paper's values (its Tables 6 and 7); circles, where they were computed, "
    f"our networks stopped after {EARLY_STEPS} steps of plain Adam"
)
_LOSS = (
    f"loss of the pre-training of a network of {BASE_LAYERS} x {BASE_WIDTH} nodes against "
    "iterations (Huber loss of standardised targets; the paper's is the mean square)"
)


@dataclass(frozen=True, eq=False)
class Pretrainings:
    """What (c) shows.

    Attributes:
        curves: one a network, named after its activation.
        results: network -> the one result that its curve is of.
        absent: what is not there, in sentences; "" for nothing.
    """

    curves: Sequence[LossCurve]
    results: Mapping[str, Sequence[CellResult]]
    absent: str

    @property
    def setting(self) -> str:
        """What must be read with the curves."""
        which = "Of the first split that all have."
        return " ".join(filter(None, (which, paper_setting(self.results), self.absent)))


@dataclass(frozen=True, eq=False)
class Widths:
    """What (a) or (b) shows.

    Attributes:
        quantity: "MAE" or "STDE".
        test, train: ours.
        marks: name -> (depth, nodes a layer) -> a value on the test part to hold it against, m.
        results: network -> the results that the lines are of.
        absent: what is not there, in sentences; "" for nothing.
    """

    quantity: Quantity
    test: Sweep
    train: Sweep
    marks: Mapping[str, Mapping[tuple[int, int], float]]
    results: Mapping[str, Sequence[CellResult]]
    absent: str

    @property
    def setting(self) -> str:
        """What must be read with the lines."""
        return " ".join(filter(None, (paper_setting(self.results, "a network"), self.absent)))


def figure_5a(results: PaperResults) -> Content:
    """Take the mean absolute errors over widths."""
    return _widths_content(results, "MAE")


def figure_5b(results: PaperResults) -> Content:
    """Take the standard deviations of the absolute error over widths."""
    return _widths_content(results, "STDE")


def figure_5c(results: PaperResults) -> Content:
    """Take the losses of the pre-training."""
    shown = _pretrainings(results)
    caption = (
        f"The paper's Figure 5c: {_LOSS}, by activation; the paper's is ReLU, of 100,000 "
        f"iterations. {shown.setting}"
    )
    return Content(caption, partial(losses_figure, shown.curves))


def figure_5(results: PaperResults) -> Content:
    """Take all three."""
    mae, stde, shown = _widths(results, "MAE"), _widths(results, "STDE"), _pretrainings(results)
    caption = (
        f"The paper's Figure 5: (a) MAE and (b) STDE of pre-trained networks on the simulated "
        f"source domain, all axes together, against nodes a hidden layer. {_LINES}. "
        f"{mae.setting} (c): {_LOSS}, of the first split that all have. {shown.absent}"
    )
    return Content(caption.strip(), partial(_three_panels, (mae, stde), shown.curves))


def _widths_content(results: PaperResults, quantity: Quantity) -> Content:
    found = _widths(results, quantity)
    caption = (
        f"The paper's Figure 5{_LETTERS[quantity]}: {quantity} of pre-trained networks on the "
        f"simulated source domain, all axes together, against nodes a hidden layer. {_LINES}. "
        f"{found.setting}"
    )
    return Content(caption, partial(_one_panel, found))


def _widths(results: PaperResults, quantity: Quantity) -> Widths:
    """Return the errors of the networks of Figure 5 that the folder has.

    Raises:
        StoreError: a depth has fewer than two widths.
    """
    names = [pretrained(layers=d, width=width).name for width in WIDTHS for d in WIDTH_DEPTHS]
    tried = tried_models(results, names, PAPER_PROTOCOL)
    test = sweep_of(_all(tried), TEST, quantity)
    short = [d for d in WIDTH_DEPTHS if sum(d == of for of, _ in test.values) < FEWEST_WIDTHS]
    if short:
        depths = ", ".join(map(str, short))
        reasons = "".join(f"; {reason}" for reason in tried.failures.values())
        raise StoreError(
            f"--results {results.folder}: fewer than {FEWEST_WIDTHS} widths of {depths} hidden "
            f"layers have results under {PAPER_PROTOCOL}; `bench reproduce` makes them{reasons}"
        )
    early = tried_models(results, _STOPPED_EARLY, PAPER_PROTOCOL)
    at_100_steps = sweep_of(_all(early), TEST, quantity).values
    return Widths(
        quantity,
        test,
        sweep_of(_all(tried), TRAIN, quantity),
        {
            "paper": _published(quantity),
            "stopped early": {size: float(of.mean()) for size, of in at_100_steps.items()},
        },
        tried.results,
        _absent(tried.missing, len(names), {**tried.failures, **early.failures}),
    )


def _all(tried: TriedModels) -> list[CellResult]:
    return [one for found in tried.results.values() for one in found]


def _absent(missing: Sequence[str], n_all: int, failures: Mapping[str, str]) -> str:
    """Say which networks have no numbers."""
    not_run = f"Not run: {len(missing)} of {n_all} networks; {FULL} makes them." if missing else ""
    return " ".join(filter(None, [not_run, *(f"No numbers: {why}." for why in failures.values())]))


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


def _pretrainings(results: PaperResults) -> Pretrainings:
    """Return the pre-trainings of the first split that all activations have.

    Raises:
        StoreError: there is none.
    """
    names = {pretrained(activation=kind).name: kind for kind in reversed(ACTIVATIONS)}
    shared = shared_splits(results, names, PAPER_PROTOCOL)
    first = {name: found[:1] for name, found in shared.results.items()}
    curves = [
        curve for name, (result,) in first.items() for curve in curves_of(result, names[name])
    ]
    if not curves:
        raise StoreError(
            f"--results {results.folder}: {', '.join(first)}: no training curve; `bench reproduce` "
            "in another folder makes one"
        )
    return Pretrainings(curves, first, _absent(shared.missing, len(names), shared.failures))


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
    share_legend(figure, [axes], below=True, ncols=2, columnspacing=1.2)
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
    share_legend(figure, panels[:1], below=True, ncols=6)
    return figure


_IDENTITY = (
    f"Grey: identity; coloured lines: identity ± the error that {SHARE:.0%} of the samples keep."
)
_PAPERS = "Beside our MAE: the paper's (its Table 10, of its own measurements)."
_METHODS = {VJM: "VJM", FT_MLP: "FT-MLP", DT_CNN: "DT-CNN"}
"""Names in the published tables."""


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
        f"{_IDENTITY} Beside our MAE: the paper's (its Table 2)."
    )
    series = [Series(VJM, tested, _published_mae("table_2", VJM))]
    return Content(caption, partial(regression_figure, series))


def figure_8(results: PaperResults) -> Content:
    """Take DT-CNN's test samples."""
    series, shared = _tested(results, (DT_CNN,))
    caption = (
        f"The paper's Figure 8: measured deflection against that of {DT_CNN}, of the test samples "
        f"of all splits together. {_with_gaps(shared)} {_IDENTITY} {_PAPERS}"
    )
    return Content(caption, partial(regression_figure, series))


def figure_9(results: PaperResults) -> Content:
    """Take the test samples of FT-MLP and the VJM."""
    series, shared = _tested(results, (FT_MLP, VJM))
    caption = (
        f"The paper's Figure 9: measured deflection against that of {FT_MLP} and of {VJM}, of the "
        f"test samples of all splits together. {_with_gaps(shared)} {_IDENTITY} {_PAPERS}"
    )
    return Content(caption, partial(regression_figure, series, overlaid=True))


def _tested(results: PaperResults, models: tuple[str, ...]) -> tuple[list[Series], SharedSplits]:
    """Return the models' test samples on the splits that all have, and their results.

    Raises:
        StoreError: a model has no result.
    """
    shared = shared_splits(results, models, PAPER_PROTOCOL)
    lacking = [*shared.missing, *shared.failures]
    if lacking:
        why = "; ".join(shared.failures.values()) or "not run"
        raise StoreError(
            f"--results {results.folder}: no result of {', '.join(lacking)} on {DATASET} under "
            f"{PAPER_PROTOCOL}: {why}; `bench reproduce` makes it"
        )
    series = [
        Series(name, pooled(found), _published_mae("table_10", name))
        for name, found in shared.results.items()
    ]
    return series, shared


def _with_gaps(shared: SharedSplits) -> str:
    return " ".join([paper_setting(shared.results), *shared.absences()])


def _published_mae(table: str, model: str) -> tuple[float, ...]:
    """Return a method's published mean absolute errors along x, y and z, m."""
    row = next(row for row in published_rows(table) if row.method == _METHODS[model])
    return tuple(row.values_mm["mae", axis] / MM for axis in AXES)
