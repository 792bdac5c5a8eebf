"""Variants of one model: freeze strategies, and depth and width."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
import pandas as pd
import seaborn
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiff_bench.figures import style
from stiff_bench.figures.figure_source import MOST_PANELS, Compared, FigureSource, Panels
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.results.fit_values import pooled_prediction
from stiff_bench.results.load import Task, split_of
from stiff_bench.store.names import grouped
from stiff_bench.tables.units import MM
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_models.transfer.freeze_strategies import named_layers
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import FitResult
from stiff_protocols.scoring.metrics import absolute_errors

LEAST_TO_MOST = ("pi", 100)
"""Seaborn's error bar from the least to the largest."""


def variants_of(results: Sequence[FitResult], *options: str) -> tuple[str, list[FitResult]]:
    """Return the model with most values of some options, and its results.

    The results differ only in these options and in their splits.
    """

    def other_options(result: FitResult) -> tuple[str, ...]:
        given = result.fit.model_params
        return (result.fit.model, *(f"{k}={given[k]}" for k in sorted(given) if k not in options))

    def n_values(members: list[FitResult]) -> int:
        params = [result.fit.model_params for result in members]
        return len({tuple(str(given.get(option)) for option in options) for given in params})

    largest = max(grouped(results, other_options).values(), key=n_values)
    return largest[0].fit.model, largest


FEWEST_STRATEGIES = 2
KINDS = SINGLE, PAIR, OTHER_KIND = "one layer", "two layers", "others"
LINE_INCH, FRAME_INCH, LEGEND_INCH = 0.19, 0.65, 0.2
_STRATEGIES = (
    "two freeze strategies; create them with `bench reproduce paper`, or with "
    "`bench run --model ft-mlp@freeze=layers:1 --model ft-mlp@freeze=layers:2 ...`"
)


def freeze_of(result: FitResult) -> str:
    """Return a result's freeze strategy; "" if its model has none."""
    return str(result.fit.model_params.get("freeze") or "")


def layers_of(result: FitResult) -> str:
    """Return the trained layers, such as "1 + 2", or the strategy's name."""
    freeze = freeze_of(result)
    return style.short(" + ".join(named_layers(freeze)) or freeze)


def mean_absolute_error_mm(result: FitResult) -> float:
    """Return the mean absolute error of the test samples over all axes, mm."""
    return float(absolute_errors(pooled_prediction([result])).mean()) * MM


def strategies(results: Iterable[FitResult]) -> pd.DataFrame:
    """Return the layers that move, one of `KINDS`, and the error [mm], a row per result.

    Single layers come first, then pairs, then others, each in the order of their layers.
    """

    def kind(result: FitResult) -> int:
        return {1: 0, 2: 1}.get(len(named_layers(freeze_of(result))), 2)

    ordered = sorted(results, key=lambda result: (kind(result), freeze_of(result)))
    rows = [
        (layers_of(result), KINDS[kind(result)], mean_absolute_error_mm(result))
        for result in ordered
    ]
    return pd.DataFrame(rows, columns=["layers", "kind", "error"])


class Strategies(NamedTuple):
    """Freeze strategies on a data set: `strategies`, and the linear model's error per split, mm."""

    errors: pd.DataFrame
    linear: Sequence[float]


def freezing_figure(data: Sequence[tuple[str, Strategies]]) -> Figure:
    """Draw the error of each strategy, a panel per data set."""
    n_lines = max(errors["layers"].nunique() for _, (errors, _) in data)
    figure, panels = style.new_panels(len(data), FRAME_INCH + LINE_INCH * n_lines, LEGEND_INCH)
    for axes, (title, (errors, linear)) in zip(panels, data, strict=True):
        draw_strategies(axes, errors, linear)
        axes.locator_params(axis="x", nbins=5)
        axes.set_title(title, loc="left")
    if len({tuple(errors["layers"].unique()) for _, (errors, _) in data}) == 1:
        style.label_left(panels, panels[0].get_ylabel())
    style.name_panels(panels)
    style.share_legend(figure, panels, columnspacing=1.0, handletextpad=0.4)
    return figure


def draw_strategies(axes: Axes, errors: pd.DataFrame, linear: Sequence[float]) -> None:
    """Draw mean and splits of each of `strategies`, and the mean of the linear model's [mm]."""
    look = style.looks_of(KINDS)
    for kind in KINDS:
        label = kind if (errors["kind"] == kind).any() else None
        axes.plot([], [], **look[kind].points(), label=label)
    labels = errors["layers"].unique()
    for place, layers in enumerate(labels):
        of_strategy = errors[errors["layers"] == layers]
        kind, splits = of_strategy["kind"].iloc[0], of_strategy["error"].sort_values()
        axes.plot(splits, [place] * len(splits), "|-", color=look[kind].color, lw=0.8, ms=4.0)
        axes.plot(splits.mean(), place, **look[kind].points(), ms=4.5)
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set(xlabel="MAE on the test samples [mm]", ylabel="trained layers")
    if linear:
        mean = float(np.mean(linear))
        axes.axvline(mean, color=style.REFERENCE_COLOR, ls="--", label=REFERENCE_MODEL)


def freezing(source: FigureSource) -> Prepared:
    """Show the error of one model by its freeze strategy."""
    tasks = source.tasks_with(freeze_of, _STRATEGIES, most_first=True)
    panels, data, model = _gather(source, tasks, _strategies_of)
    caption = (
        f"Mean absolute error of {model}, all axes together, by the layers that fine-tuning trains "
        "(numbered from the input; out: the output layer). Symbol: mean over splits; ticks: "
        f"splits. {panels.setting}"
    )
    return Prepared("Freeze strategies", caption, partial(freezing_figure, data), panels.subtitle)


def _strategies_of(source: FigureSource, task: Task) -> tuple[str, Compared, Strategies]:
    """Return the model with most strategies, and its errors on shared splits."""
    model, results = variants_of(source.results(task, freeze_of), "freeze")
    splits_of_each = [set(map(split_of, of)) for of in grouped(results, freeze_of).values()]
    if len(splits_of_each) < FEWEST_STRATEGIES:
        raise StoreError(f"{source.folder}: no model has results of {_STRATEGIES}", "results")
    splits = set.intersection(*splits_of_each)
    if not splits:
        raise StoreError(
            f"{source.folder}: the freeze strategies of {model} share no split; "
            "run each strategy on the same splits",
            "results",
        )
    is_part = len(splits) < len(set.union(*splits_of_each))
    notes = "Splits that only some strategies have are left out." * is_part
    names = dict.fromkeys(result.presentation.model for result in results)
    errors = strategies(result for result in results if split_of(result) in splits)
    linear = task.models[REFERENCE_MODEL].done if REFERENCE_MODEL in task.models else {}
    of_linear = [
        mean_absolute_error_mm(linear[split]) for split in sorted(splits) if splits <= linear.keys()
    ]
    compared = Compared(task, tuple(names), tuple(sorted(splits)), notes)
    return model, compared, Strategies(errors, of_linear)


Numbers = TypeVar("Numbers")


def _gather(
    source: FigureSource,
    tasks: Sequence[Task],
    gather: Callable[[FigureSource, Task], tuple[str, Compared, Numbers]],
) -> tuple[Panels, list[tuple[str, Numbers]], str]:
    """Gather the numbers of each task that has enough of them.

    Returns:
        The panels, their titles with the numbers, and the names of the models.

    Raises:
        StoreError: no task has enough; it names the first task's reason.
    """
    gathered, reasons = [], []
    for task in tasks:
        try:
            gathered.append(gather(source, task))
        except StoreError as error:
            reasons.append(error)
    if not gathered:
        raise reasons[0]
    models, compared, numbers = zip(*gathered[:MOST_PANELS], strict=True)
    notes = list(dict.fromkeys(panel.notes for panel in compared))
    hidden = [panel.task.name.dataset for _, panel, _ in gathered[MOST_PANELS:]]
    if hidden:
        notes.append(f"Not shown: {', '.join(hidden)}.")
    names = dict.fromkeys(name for panel in compared for name in panel.models)
    panels = Panels(compared, tuple(names), " ".join(filter(None, notes)))
    return panels, list(zip(panels.titles, numbers, strict=True)), ", ".join(dict.fromkeys(models))


FEWEST_NETWORKS = 4  # networks of one kind that make a sweep
HEIGHT_INCH = 2.5
SOURCE_MAE = "source test MAE [mm]"
_NETWORKS = (
    "networks of several widths and depths; create them with `bench reproduce paper`, or with "
    "`bench run --model mlp-pretrained@width=40 --model mlp-pretrained@width=160 ...`"
)


def is_swept(result: FitResult) -> bool:
    """Return true if a result has depth, width and an error on the source."""
    options = result.fit.model_params
    sized = all(isinstance(options.get(name), int) for name in ("layers", "width"))
    return sized and SOURCE_MAE in result.diagnostics


def errors_on_source(results: Iterable[FitResult], error: str = SOURCE_MAE) -> pd.DataFrame:
    """Return depth, width and error on the source domain [mm] per result."""
    rows = [
        (
            result.fit.model_params["layers"],
            result.fit.model_params["width"],
            result.diagnostics[error],
        )
        for result in results
        if error in result.diagnostics
    ]
    return pd.DataFrame(rows, columns=["depth", "width", "error"])


LABELS = {"width": "nodes per layer", "depth": "hidden layers"}
LINES = {"width": "depth", "depth": "width"}
"""Size across -> size that the lines differ in."""


def draw_lines(axes: Axes, errors: pd.DataFrame, across: str = "width", /, **words: object) -> None:
    """Draw `errors_on_source` over width, with a line per depth, or reversed.

    `words` replace the default keywords of seaborn.
    """
    by = LINES[across]
    usual = {"errorbar": LEAST_TO_MOST, "err_kws": {"alpha": 0.2, "linewidth": 0.0}}
    look = style.seaborn_looks(sorted(errors[by].unique()))
    axes.set(yscale="log")
    about = {"x": across, "y": "error", "hue": by, "style": by}
    seaborn.lineplot(errors, ax=axes, **{**about, **usual, **look, **words})
    axes.set(xlabel=LABELS[across], ylabel="pre-training test MAE [mm]")
    style.plain_numbers(axes.yaxis)


def sweep_figure(data: Sequence[tuple[str, pd.DataFrame]]) -> Figure:
    """Draw `errors_on_source` over width and depth, a panel per data set."""
    n_columns = 2 if len(data) == 1 else 4
    figure, panels = style.new_panels(len(data), HEIGHT_INCH, LEGEND_INCH)
    every = pd.concat([errors for _, errors in data])
    across = max(LINES, key=lambda size: every[size].nunique())
    sizes = sorted(every[LINES[across]].unique())
    for size, look in style.looks_of(sizes).items():
        label = f"{size} {LABELS[LINES[across]]}"
        panels[0].plot([], [], color=look.color, marker=look.marker, label=label)
    for axes, (title, errors) in zip(panels, data, strict=True):
        axes.sharey(panels[0])
        draw_lines(axes, errors, across, legend=False, **style.seaborn_looks(sizes))
        axes.set_title(title, loc="left")
    style.label_left(panels, panels[0].get_ylabel())
    style.name_panels(panels)
    style.share_legend(figure, panels[:1], ncols=n_columns)
    return figure


def sweep(source: FigureSource) -> Prepared:
    """Show the error on the simulated pre-training data over width and depth of a network."""
    tasks = source.tasks_with(is_swept, _NETWORKS, most_first=True)
    panels, data, model = _gather(source, tasks, _networks_of)
    caption = (
        f"Mean absolute error of {model} on the test part (30 %) of the simulated pre-training "
        f"data, all axes together. Bands: range over the splits. {panels.setting}"
    )
    title = "Error over depth and width of a network"
    return Prepared(title, caption, partial(sweep_figure, data), panels.subtitle)


def _networks_of(source: FigureSource, task: Task) -> tuple[str, Compared, pd.DataFrame]:
    """Return the model with most widths and depths, and its `errors_on_source`."""
    model, results = variants_of(source.results(task, is_swept), "layers", "width")
    errors = errors_on_source(results)
    if len(errors.groupby(["depth", "width"])) < FEWEST_NETWORKS:
        raise StoreError(f"{source.folder}: no result has {_NETWORKS}", "results")
    names = dict.fromkeys(result.presentation.model for result in results)
    splits = sorted(set(map(split_of, results)))
    return model, Compared(task, tuple(names), tuple(splits)), errors
