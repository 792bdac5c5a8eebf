"""Freeze strategies: which layers to move when a network is fine-tuned."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from stiff_bench.analysis.collected import Contest
from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import FigureSource, pooled, setting, variants_of
from stiff_bench.figures.style import COLUMN_INCH, REFERENCE_COLOR, looks, new_figure, short
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

FEWEST = 2
LAYERS = "layers:"
KINDS = ("one layer", "two layers", "others")
LINE_INCH, FRAME_INCH = 0.19, 0.85
_NEEDS = (
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
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))  # each name once
    figure.legend(
        *(list(handles.values()), list(handles)),
        loc="outside upper center",
        ncols=4,
        columnspacing=1.0,
        handletextpad=0.4,
    )
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


def gather(source: FigureSource) -> Content:
    """Take the variants of one model that differ in the freeze strategy alone."""
    contest = source.contest(lambda one: bool(freeze_of(one)), needs=_NEEDS, most_first=True)
    frozen = [
        one for name in source.names([contest]) for one in contest.results(name) if freeze_of(one)
    ]
    model, results = variants_of(frozen, "freeze")
    of_strategy = grouped(results, freeze_of)
    if len(of_strategy) < FEWEST:
        raise StoreError(f"--results {source.folder}: no model has results of {_NEEDS}")
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
