"""What models cost, beside a leaderboard's ranks: medians over the cells that it shows."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stiff_bench.analysis.leaderboard import Section
from stiff_bench.tables.render import TextTable
from stiff_bench.tables.units import counted, marked
from stiff_protocols.scoring.metrics import METRICS

COSTS = ("fit-time", "throughput", "latency", "memory")
"""Metrics of the table's columns."""

_HEADINGS = ("fit time", "predictions a second", "latency of one", "memory [MiB]")


@dataclass(frozen=True)
class Spread:
    """A cost over several cells, in its metric's unit.

    Attributes:
        median, low, high: of the cells that know it; low and high are its range.
    """

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class ModelCost:
    """What a model cost.

    Attributes:
        name, mark: of it, and what must stand beside it.
        n_cells: how many cells count.
        costs: metric -> its values; one that no cell knows is not there.
    """

    name: str
    mark: str
    n_cells: int
    costs: Mapping[str, Spread]


def model_costs(section: Section) -> list[ModelCost]:
    """Return the costs of the models in the ranks' order; one without any is not there."""
    found = (_cost(section, name, mark) for name, mark in section.marks.items())
    return [model for model in found if model.costs]


def cost_table(section: Section) -> TextTable:
    """Return the costs as a table of text."""
    models = model_costs(section)
    n_cells = sum(model.n_cells for model in models)
    return TextTable(
        title=f"Costs, {counted(n_cells, 'cell')} | median (lowest to highest), not ranked",
        header=("model", *_HEADINGS, "cells"),
        rows=[
            [
                marked(model.name, model.mark),
                *(_text(key, model.costs.get(key)) for key in COSTS),
                str(model.n_cells),
            ]
            for model in models
        ],
        notes=(
            "wall times and memory of the machines that computed the cells, over all data sets and "
            "protocols of the ranks above: see `bench leaderboard --metric fit-time` for one each. "
            "A pre-training from the cache costs nothing in fit time, and the first fit of a run "
            "loads libraries.",
        ),
    )


def _cost(section: Section, name: str, mark: str) -> ModelCost:
    costs = [
        result.cost
        for field in section.fields
        if name in field.scores
        for result in field.results[name]
        if result.cost is not None
    ]
    values: dict[str, list[float]] = {}
    for key in COSTS:
        of_cost = METRICS[key].of_cost
        known = [of_cost(cost) for cost in costs] if of_cost is not None else []
        values[key] = [value for value in known if value is not None]
    spreads = {key: _spread(each) for key, each in values.items() if each}
    return ModelCost(name, mark, len(costs), spreads)


def _spread(values: Sequence[float]) -> Spread:
    return Spread(statistics.median(values), min(values), max(values))


def _text(key: str, spread: Spread | None) -> str:
    if spread is None:
        return "-"
    unit, factor = "", 1.0
    if METRICS[key].unit == "s":
        unit, factor = _time_unit(spread.median)
    number = _mebibytes if METRICS[key].unit == "B" else _three_digits
    median, low, high = (number(v * factor) for v in (spread.median, spread.low, spread.high))
    shown = f"{median} {unit}".rstrip()
    return shown if low == high else f"{shown} ({low} to {high})"


def _time_unit(seconds: float) -> tuple[str, float]:
    """Return the unit that a time is printed in, and how many of it a second has."""
    for unit, factor in (("us", 1e6), ("ms", 1e3)):
        if seconds * factor < 999.5:
            return unit, factor
    return "s", 1.0


def _three_digits(value: float) -> str:
    """Return a positive number with three digits that count: 0.0123, 1.23, 12,300."""
    return f"{float(f'{value:.3g}'):,.15g}"


def _mebibytes(size: float) -> str:
    return f"{size * 2.0**-20:.1f}"
