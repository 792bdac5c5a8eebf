"""Variants of one model: which layers move when a network is fine-tuned; its depth and width."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stiff_bench.analysis.collected import Case
from stiff_bench.figures.figure import Prepared
from stiff_bench.figures.source import FigureSource, setting
from stiff_bench.figures.style import (
    COLUMN_INCH,
    PAGE_INCH,
    REFERENCE_COLOR,
    looks,
    name_panels,
    new_figure,
    plain_numbers,
    seaborn_looks,
    share_legend,
    short,
)
from stiff_bench.store.names import grouped
from stiff_bench.store.newest import Slot, slot_of
from stiff_bench.tables.metric_table import pooled_prediction
from stiff_bench.tables.units import MM
from stiff_models.catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.scoring.metrics import absolute_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_TO_MOST = ("pi", 100)
"""Seaborn's error bar from the least to the largest."""


def variants_of(results: Sequence[CellResult], *options: str) -> tuple[str, list[CellResult]]:
    """Return the model with most values of some options, and its results.

    They differ in nothing else than these options, and in their splits.
    """

    def others(one: CellResult) -> tuple[str, ...]:
        given = one.cell.model_params
        return (one.cell.model, *(f"{k}={given[k]}" for k in sorted(given) if k not in options))

    def n_values(members: list[CellResult]) -> int:
        return len({tuple(str(one.cell.model_params.get(k)) for k in options) for one in members})

    largest = max(grouped(results, others).values(), key=n_values)
    return largest[0].cell.model, largest


FEWEST_STRATEGIES = 2
LAYERS = "layers:"
KINDS = ("one layer", "two layers", "others")
LINE_INCH, FRAME_INCH = 0.19, 0.85
_STRATEGIES = (
    "two freeze strategies; `bench reproduce`, or `bench run --model ft-mlp@freeze=layers:1 "
    "--model ft-mlp@freeze=layers:2 ...`, makes them"
)


def freeze_of(result: CellResult) -> str:
    """Return a result's freeze strategy; "" where its model has none."""
    return str(result.cell.model_params.get("freeze") or "")


def is_frozen(result: CellResult) -> bool:
    """Say whether a result is of a model with a freeze strategy."""
    return bool(freeze_of(result))


def layers_of(result: CellResult) -> str:
    """Return the layers that a strategy moves, such as "1 + 2", or its name."""
    return short(freeze_of(result).removeprefix(LAYERS).replace(",", " + "))


def mean_error(result: CellResult) -> float:
    """Return the mean absolute error of the test samples over all axes, m."""
    return float(absolute_errors(pooled_prediction([result])).mean())


def strategies(results: Iterable[CellResult]) -> pd.DataFrame:
    """Return the layers that move, one of `KINDS`, and the error [mm], a row a result.

    Single layers come first, then pairs, then others, each in the order of their layers.
    """

    def kind(result: CellResult) -> int:
        commas = freeze_of(result).count(",")
        return commas if freeze_of(result).startswith(LAYERS) and commas < 2 else 2

    ordered = sorted(results, key=lambda one: (kind(one), freeze_of(one)))
    rows = [(layers_of(one), KINDS[kind(one)], mean_error(one) * MM) for one in ordered]
    return pd.DataFrame(rows, columns=["layers", "kind", "error"])


def freezing_figure(errors: pd.DataFrame, linear: float | None) -> Figure:
    """Draw the error of each strategy; arguments as in `draw_strategies`."""
    figure = new_figure(COLUMN_INCH, FRAME_INCH + LINE_INCH * errors["layers"].nunique())
    axes = figure.subplots()
    draw_strategies(axes, errors, linear)
    share_legend(figure, [axes], columnspacing=1.0, handletextpad=0.4)
    return figure


def draw_strategies(axes: Axes, errors: pd.DataFrame, linear: float | None) -> None:
    """Draw mean and splits of each of `strategies`, and the linear model's error [m]."""
    for kind, look in zip(KINDS, looks(len(KINDS)), strict=True):
        of_kind = errors[errors["kind"] == kind]
        axes.plot([], [], **look.points(), label=kind if len(of_kind) else None)
    for place, (_, of_strategy) in enumerate(errors.groupby("layers", sort=False)):
        look = looks(len(KINDS))[KINDS.index(of_strategy["kind"].iloc[0])]
        splits = of_strategy["error"].sort_values()
        axes.plot(splits, [place] * len(splits), "|-", color=look.color, lw=0.8, markersize=4.0)
        axes.plot(splits.mean(), place, **look.points(), markersize=4.5)
    labels = errors["layers"].unique()
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set(xlabel="MAE on the test samples [mm]", ylabel="trained layers")
    if linear is not None:
        axes.axvline(linear * MM, color=REFERENCE_COLOR, linestyle="--", label=REFERENCE_MODEL)


def freezing(source: FigureSource) -> Prepared:
    """Take the variants of one model that differ in the freeze strategy alone."""
    case = source.case(is_frozen, needs=_STRATEGIES, most_first=True)
    model, results = variants_of(source.results(case, is_frozen), "freeze")
    each = [set(map(slot_of, of)) for of in grouped(results, freeze_of).values()]
    if len(each) < FEWEST_STRATEGIES:
        raise StoreError(f"{source.folder}: no model has results of {_STRATEGIES}", "results")
    slots, n_all = set.intersection(*each), len(set.union(*each))
    if not slots:
        raise StoreError(
            f"{source.folder}: the freeze strategies of {model} have no split in common; "
            "as many splits of each make them",
            "results",
        )
    fewer = " Splits that only some strategies have are left out." * (len(slots) < n_all)
    names = {one.shown.model for one in results}
    caption = (
        f"Mean absolute error of {model}, all axes together, by the layers that fine-tuning trains "
        "(numbered from the input; out: the output layer). Symbol: mean over splits; ticks: "
        f"splits. {setting(case, names, [len(slots)])}{fewer}"
    )
    errors = strategies(one for one in results if slot_of(one) in slots)
    return Prepared(
        "Freeze strategies", caption, partial(freezing_figure, errors, linear_error(case, slots))
    )


def linear_error(case: Case, slots: Collection[Slot]) -> float | None:
    """Return the linear model's mean absolute error over splits and axes, m; None: it lacks one."""
    linear = case.competitors.get(REFERENCE_MODEL)
    if linear is None or not all(slot in linear.done for slot in slots):
        return None
    return float(np.mean([mean_error(linear.done[slot]) for slot in sorted(slots)]))


FEWEST_NETWORKS = 4  # networks of one kind that make a sweep
HEIGHT_INCH = 2.5
MOST_NUMBERS = 10  # widths beyond which the map's fields have no room for numbers
_NETWORKS = (
    "a network of several widths and depths; `bench reproduce`, or `bench run --model "
    "mlp-pretrained@width=40 --model mlp-pretrained@width=160 ...`, makes them"
)


def is_swept(result: CellResult) -> bool:
    """Say whether a result is of a network with depth and width and an error on the source."""
    options = result.cell.model_params
    sized = isinstance(options.get("layers"), int) and isinstance(options.get("width"), int)
    return sized and "source test MAE [mm]" in result.diagnostics


def errors_on_source(
    results: Iterable[CellResult], quantity: str = "MAE", part: str = "test"
) -> pd.DataFrame:
    """Return depth, width and the error on a part of the source domain [mm], a row a result."""
    name = f"source {part} {quantity} [mm]"
    rows = [
        (one.cell.model_params["layers"], one.cell.model_params["width"], one.diagnostics[name])
        for one in results
        if name in one.diagnostics
    ]
    return pd.DataFrame(rows, columns=["depth", "width", "error"])


def draw_lines(axes: Axes, errors: pd.DataFrame, **words: object) -> None:
    """Draw `errors_on_source` over width, a line a depth; words for seaborn replace its usual."""
    import seaborn

    usual = {"errorbar": LEAST_TO_MOST, "err_kws": {"alpha": 0.2, "linewidth": 0.0}}
    axes.set(yscale="log")
    seaborn.lineplot(
        errors,
        x="width",
        y="error",
        hue="depth",
        style="depth",
        ax=axes,
        **{**usual, **seaborn_looks(sorted(errors["depth"].unique())), **words},
    )
    axes.set(xlabel="nodes per layer", ylabel="pre-training test MAE [mm]")
    plain_numbers(axes.yaxis)


def sweep_figure(errors: pd.DataFrame) -> Figure:
    """Draw error against width, and the map of both; of what `errors_on_source` returns."""
    figure = new_figure(PAGE_INCH, HEIGHT_INCH)
    lines, heat = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    draw_lines(lines, errors)
    lines.legend(title="hidden layers")
    _draw_map(figure, heat, errors.pivot_table(index="depth", columns="width", values="error"))
    name_panels([lines, heat])
    return figure


def _draw_map(figure: Figure, axes: Axes, mean: pd.DataFrame) -> None:
    """Draw the mean errors over depths (rows) and widths."""
    import seaborn
    from matplotlib.colors import LogNorm

    n_widths = len(mean.columns)
    seaborn.heatmap(
        mean,
        ax=axes,
        cmap="viridis_r",
        norm=LogNorm(np.nanmin(mean), np.nanmax(mean)),
        annot=n_widths <= MOST_NUMBERS,
        fmt=".2g",
        annot_kws={"size": 6.5 if n_widths < 7 else 5.5},
        linewidths=0.5,
        cbar=False,
    )
    axes.grid(visible=False)
    axes.set(xlabel="nodes per layer", ylabel="hidden layers")
    axes.tick_params(axis="y", labelrotation=0)
    axes.invert_yaxis()
    bar = figure.colorbar(axes.collections[0], ax=axes, label="pre-training test MAE [mm]")
    plain_numbers(bar.ax.yaxis)


def sweep(source: FigureSource) -> Prepared:
    """Take the networks that differ in depth and width alone."""
    case = source.case(is_swept, needs=_NETWORKS, most_first=True)
    model, results = variants_of(source.results(case, is_swept), "layers", "width")
    errors = errors_on_source(results)
    n_splits = errors.groupby(["depth", "width"]).size()
    if len(n_splits) < FEWEST_NETWORKS:
        raise StoreError(f"{source.folder}: no result has {_NETWORKS}", "results")
    names = {one.shown.model for one in results}
    caption = (
        f"Mean absolute error of {model} on the test part (30 %) of the simulated pre-training "
        "data, all axes together. Bands: range over the splits. "
        f"{setting(case, names, n_splits.tolist())}"
    )
    return Prepared(
        "Error over depth and width of a network", caption, partial(sweep_figure, errors)
    )
