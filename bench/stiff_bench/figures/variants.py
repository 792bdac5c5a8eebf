"""Variants of one model: which layers move when a network is fine-tuned; its depth and width."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from stiff_bench.analysis.collected import Contest
from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import FigureSource, pooled, setting
from stiff_bench.figures.style import (
    COLUMN_INCH,
    PAGE_INCH,
    REFERENCE_COLOR,
    looks,
    name_panels,
    new_figure,
    plain_numbers,
    share_legend,
    short,
)
from stiff_bench.store.names import grouped
from stiff_bench.store.newest import Slot, slot_of
from stiff_bench.tables.units import MM
from stiff_models.catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.contract.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def variants_of(results: Sequence[CellResult], *options: str) -> tuple[str, list[CellResult]]:
    """Return the model with most values of some options, and its results.

    They differ in nothing else than these options, and in their splits.

    Args:
        results: at least one.
        options: names of the model's options.
    """
    families = grouped(results, lambda one: _others(one, options)).values()
    largest = max(families, key=lambda members: len({_values(one, options) for one in members}))
    return largest[0].cell.model, largest


def _values(result: CellResult, options: Sequence[str]) -> tuple[str, ...]:
    return tuple(str(result.cell.model_params.get(name)) for name in options)


def _others(result: CellResult, options: Sequence[str]) -> tuple[str, ...]:
    given = result.cell.model_params
    return (result.cell.model, *(f"{k}={given[k]}" for k in sorted(given) if k not in options))


FEWEST_STRATEGIES = 2
LAYERS = "layers:"
KINDS = ("one layer", "two layers", "others")
LINE_INCH, FRAME_INCH = 0.19, 0.85
_STRATEGIES = (
    "two freeze strategies; `bench reproduce`, or `bench run --model ft-mlp@freeze=layers:1 "
    "--model ft-mlp@freeze=layers:2 ...`, makes them"
)


@dataclass(frozen=True, eq=False)
class Strategy:
    """A freeze strategy and its errors.

    Attributes:
        freeze: the option's value, such as "layers:1,2".
        error: (n_splits,) mean absolute error of the test samples, all axes together, m.
    """

    freeze: str
    error: FloatArray

    @property
    def layers(self) -> tuple[str, ...]:
        """The layers that move, where the strategy names them."""
        named = self.freeze.startswith(LAYERS)
        return tuple(self.freeze.removeprefix(LAYERS).split(",")) if named else ()

    @property
    def kind(self) -> str:
        """One of `KINDS`."""
        return KINDS[len(self.layers) - 1] if len(self.layers) in (1, 2) else KINDS[2]

    @property
    def label(self) -> str:
        """Its layers, or its name, for people."""
        return " + ".join(self.layers) if self.layers else short(self.freeze)


def freezing_figure(strategies: Sequence[Strategy], linear: float | None, quantity: str) -> Figure:
    """Draw the error of each strategy: mean, splits, and the linear model's beside them.

    Args:
        strategies: at least one.
        linear: error of the linear model, m; None: not known.
        quantity: what the error is, for the axis.
    """
    ordered = in_order(strategies)
    figure = new_figure(COLUMN_INCH, FRAME_INCH + LINE_INCH * len(ordered))
    axes = figure.subplots()
    draw_strategies(axes, ordered)
    if linear is not None:
        axes.axvline(linear * MM, color=REFERENCE_COLOR, linestyle="--", label=REFERENCE_MODEL)
    axes.set_xlabel(quantity)
    axes.set_ylabel("layers that move")
    share_legend(figure, [axes], columnspacing=1.0, handletextpad=0.4)
    return figure


def in_order(strategies: Sequence[Strategy]) -> list[Strategy]:
    """Return single layers, then pairs, then others, each in the order of their layers."""
    return sorted(strategies, key=lambda one: (KINDS.index(one.kind), one.freeze))


def draw_strategies(axes: Axes, strategies: Sequence[Strategy]) -> None:
    """Draw a line of points a strategy, from the top to the bottom."""
    colors = dict(zip(KINDS, looks(len(KINDS)), strict=True))
    for place, one in enumerate(strategies):
        look, splits = colors[one.kind], one.error * MM
        axes.plot([splits.min(), splits.max()], [place, place], color=look.color, linewidth=0.8)
        if len(splits) > 1:
            axes.plot(splits, np.full(len(splits), place), "|", color=look.color, markersize=4.0)
        axes.plot(splits.mean(), place, **look.points() | {"markersize": 4.5}, label=one.kind)
    axes.set_yticks(range(len(strategies)), [one.label for one in strategies])
    axes.set_ylim(len(strategies) - 0.5, -0.5)
    axes.grid(visible=True, axis="x")
    axes.grid(visible=False, axis="y")


def freeze_of(result: CellResult) -> str:
    """Return a result's freeze strategy; "" where its model has none."""
    return str(result.cell.model_params.get("freeze") or "")


def mean_error(result: CellResult) -> float:
    """Return the mean absolute error of the test samples over all axes, m."""
    return float(pooled([result]).error.mean())


def freezing(source: FigureSource) -> Content:
    """Take the variants of one model that differ in the freeze strategy alone."""
    contest = source.contest(lambda one: bool(freeze_of(one)), needs=_STRATEGIES, most_first=True)
    frozen = [
        one for name in source.names([contest]) for one in contest.results(name) if freeze_of(one)
    ]
    model, results = variants_of(frozen, "freeze")
    of_strategy = grouped(results, freeze_of)
    if len(of_strategy) < FEWEST_STRATEGIES:
        raise StoreError(f"--results {source.folder}: no model has results of {_STRATEGIES}")
    each = [set(map(slot_of, of)) for of in of_strategy.values()]
    slots, n_all = set.intersection(*each), len(set.union(*each))
    if not slots:
        raise StoreError(
            f"--results {source.folder}: the freeze strategies of {model} have no split in common; "
            "`bench run` with the same --splits makes them"
        )
    strategies = [
        Strategy(freeze, np.array([mean_error(one) for one in of if slot_of(one) in slots]))
        for freeze, of in of_strategy.items()
    ]
    linear = linear_error(contest, slots)
    dashed = "; dashed: the linear model" * (linear is not None)
    fewer = " Splits that only some strategies have are left out." * (len(slots) < n_all)
    names = list(dict.fromkeys(one.shown.model for one in results))
    caption = (
        f"Mean absolute error of {model}, all axes together, on the test samples, by the layers "
        "that fine-tuning moves (numbered from the input; out: the output layer). Symbol: mean "
        f"over the splits; bars and line: single splits and their span{dashed}. "
        f"{setting(contest, names, [len(slots)])}{fewer}"
    )
    quantity = "MAE on the test samples [mm]"
    return Content(caption, partial(freezing_figure, strategies, linear, quantity))


def linear_error(contest: Contest, slots: Collection[Slot]) -> float | None:
    """Return the linear model's mean absolute error over splits and axes, m; None: it lacks one."""
    linear = contest.competitors.get(REFERENCE_MODEL)
    if linear is None or not all(slot in linear.done for slot in slots):
        return None
    return float(np.mean([mean_error(linear.done[slot]) for slot in sorted(slots)]))


TRAIN, TEST = "training", "test"
FEWEST_NETWORKS = 4  # networks of one kind that make a sweep
HEIGHT_INCH = 2.5
MOST_NUMBERS = 10  # widths beyond which the map's fields have no room for numbers
_NETWORKS = (
    "a network of several widths and depths; `bench reproduce`, or `bench run --model "
    "mlp-pretrained@width=40 --model mlp-pretrained@width=160 ...`, makes them"
)


@dataclass(frozen=True, eq=False)
class Sweep:
    """Errors of networks on the source domain.

    Attributes:
        values: (depth, width) -> (n_splits,) error, m.
    """

    values: Mapping[tuple[int, int], FloatArray]

    @property
    def depths(self) -> list[int]:
        """Hidden layers, ascending."""
        return sorted({depth for depth, _ in self.values})

    @property
    def widths(self) -> list[int]:
        """Nodes a layer, ascending."""
        return sorted({width for _, width in self.values})

    def line(self, depth: int) -> tuple[list[int], FloatArray, FloatArray, FloatArray]:
        """Return the widths of a depth, and mean, least and largest over the splits, m."""
        widths = [width for width in self.widths if (depth, width) in self.values]
        found = [self.values[depth, width] for width in widths]
        means, least, largest = (
            np.array([f(one) for one in found]) for f in (np.mean, np.min, np.max)
        )
        return widths, means, least, largest

    def grid(self) -> FloatArray:
        """Return the (n_depths, n_widths) mean errors, m; NaN where there is none."""
        table = np.full((len(self.depths), len(self.widths)), np.nan)
        for (depth, width), found in self.values.items():
            table[self.depths.index(depth), self.widths.index(width)] = found.mean()
        return table


def draw_lines(axes: Axes, sweep: Sweep, quantity: str, *, dashed: Sweep | None = None) -> None:
    """Draw error against width, one line a depth, with the span over the splits.

    Args:
        axes: an empty panel.
        sweep: errors on the test part.
        quantity: the errors' name, such as "MAE".
        dashed: errors on the training part.
    """
    for depth, look in zip(sweep.depths, looks(len(sweep.depths)), strict=True):
        widths, means, least, largest = sweep.line(depth)
        axes.plot(
            *(widths, means * MM),
            color=look.color,
            marker=look.marker,
            label=f"{depth} hidden layers",
        )
        axes.fill_between(widths, least * MM, largest * MM, color=look.color, alpha=0.2, lw=0.0)
        if dashed is not None and depth in dashed.depths:
            inner, errors, *_ = dashed.line(depth)
            axes.plot(
                *(inner, errors * MM), color=look.color, linestyle=(0, (3, 1.2)), linewidth=0.8
            )
    if dashed is not None:
        axes.plot(
            *([], []), color=REFERENCE_COLOR, linestyle=(0, (3, 1.2)), lw=0.8, label="training part"
        )
    axes.set(xlabel="nodes a layer", ylabel=f"{quantity} on the source [mm]", yscale="log")
    plain_numbers(axes.yaxis)


def sweep_figure(sweep: Sweep, quantity: str = "MAE") -> Figure:
    """Draw error against width, and the map of both."""
    figure = new_figure(PAGE_INCH, HEIGHT_INCH)
    lines, heat = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    draw_lines(lines, sweep, quantity)
    lines.legend()
    draw_map(heat, sweep, f"{quantity} on the source's test part [mm]")
    name_panels([lines, heat])
    return figure


def draw_map(axes: Axes, sweep: Sweep, label: str) -> None:
    """Draw the map of mean errors over widths and depths."""
    import seaborn
    from matplotlib.colors import LogNorm

    table = sweep.grid() * MM
    n_widths = len(sweep.widths)
    seaborn.heatmap(
        table,
        ax=axes,
        cmap="viridis_r",
        norm=LogNorm(np.nanmin(table), np.nanmax(table)),
        annot=n_widths <= MOST_NUMBERS,
        fmt=".2g",
        annot_kws={"size": 6.5 if n_widths < 7 else 5.5},
        linewidths=0.5,
        xticklabels=sweep.widths,
        yticklabels=sweep.depths,
        cbar_kws={"label": label},
    )
    axes.grid(visible=False)
    axes.set(xlabel="nodes a layer", ylabel="hidden layers")
    axes.tick_params(axis="x", labelrotation=0 if n_widths <= MOST_NUMBERS else 90)
    axes.tick_params(axis="y", labelrotation=0)
    axes.invert_yaxis()
    bar = axes.collections[0].colorbar
    if bar is not None:  # always there; matplotlib's types do not say so
        plain_numbers(bar.ax.yaxis)


def source_error(part: str, quantity: str) -> str:
    """Return the diagnostic that has a network's error on a part of the source domain, mm."""
    return f"source {part} {quantity} [mm]"


def is_swept(result: CellResult) -> bool:
    """Say whether a result is of a network with depth and width and an error on the source."""
    options = result.cell.model_params
    return all(isinstance(options.get(name), int) for name in ("layers", "width")) and (
        source_error(TEST, "MAE") in result.diagnostics
    )


def sweep_of(results: Sequence[CellResult], part: str, quantity: str) -> Sweep:
    """Return the errors of networks on a part of the source domain, by depth and width."""
    name = source_error(part, quantity)
    of_size = grouped(
        [one for one in results if name in one.diagnostics],
        lambda one: (one.cell.model_params["layers"], one.cell.model_params["width"]),
    )
    return Sweep(
        {size: np.array([one.diagnostics[name] for one in of]) / MM for size, of in of_size.items()}
    )


def sweep(source: FigureSource) -> Content:
    """Take the networks that differ in depth and width alone."""
    contest = source.contest(is_swept, needs=_NETWORKS, most_first=True)
    swept = [
        one for name in source.names([contest]) for one in contest.results(name) if is_swept(one)
    ]
    model, results = variants_of(swept, "layers", "width")
    found = sweep_of(results, TEST, "MAE")
    if len(found.values) < FEWEST_NETWORKS:
        raise StoreError(f"--results {source.folder}: no result has {_NETWORKS}")
    names = list(dict.fromkeys(one.shown.model for one in results))
    n_splits = [len(errors) for errors in found.values.values()]
    caption = (
        f"Mean absolute error of {model} on the test part (30 %) of the simulated source domain, "
        "all axes together, against nodes a hidden layer and hidden layers. Bands: least to "
        f"largest of a network's splits. {setting(contest, names, n_splits)}"
    )
    return Content(caption, partial(sweep_figure, found))
