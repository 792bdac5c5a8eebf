"""What models cost, beside a leaderboard's ranks: medians over the cells that it shows."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence

from stiff_bench.analysis.leaderboard import Section
from stiff_bench.tables.table import Column, Name, Quantity, Table
from stiff_bench.tables.units import PRINTED, counted
from stiff_protocols.contract.record import Cost
from stiff_protocols.scoring.metrics import METRICS


def cost_table(section: Section) -> Table:
    """Return the costs of the models in the ranks' order; one without any is not there."""
    found = {
        name: Name(name, mark)
        for name, mark in section.marks.items()
        if any(_known(key, _costs(section, name)) for key in _HEADINGS)
    }
    costs = {name: _costs(section, name) for name in found}
    return Table(
        title=(
            f"Costs, {counted(sum(map(len, costs.values())), 'cell')} | median (lowest to "
            "highest), not ranked"
        ),
        columns=[
            Column("model", "text"),
            *(
                Column(
                    heading,
                    unit=PRINTED[METRICS[key].unit][0],
                    format=written,
                    about={"metric": key},
                )
                for key, (heading, written) in _HEADINGS.items()
            ),
            Column("cells"),
        ],
        rows=[
            [name, *(_spread(key, costs[model]) for key in _HEADINGS), len(costs[model])]
            for model, name in found.items()
        ],
        notes=(
            "wall times and memory of the machines that computed the cells, over all data sets and "
            "protocols of the ranks above: see `bench leaderboard --metric fit-time` for one each. "
            "A pre-training from the cache costs nothing in fit time, and the first fit of a run "
            "loads libraries.",
        ),
        about={"table": "costs", "selects_on_test": section.selects_on_test},
    )


def _costs(section: Section, model: str) -> list[Cost]:
    return [
        result.cost
        for field in section.fields
        if model in field.scores
        for result in field.results[model]
        if result.cost is not None
    ]


def _known(key: str, costs: Sequence[Cost]) -> list[float]:
    """Return a cost of the cells that know it, in its metric's unit."""
    of_cost = METRICS[key].of_cost
    values = [of_cost(cost) for cost in costs] if of_cost is not None else []
    return [value for value in values if value is not None]


def _spread(key: str, costs: Sequence[Cost]) -> Quantity | None:
    """Return median and range, as printed."""
    values = _known(key, costs)
    if not values:
        return None
    _, factor = PRINTED[METRICS[key].unit]
    median, low, high = statistics.median(values), min(values), max(values)
    return Quantity(median * factor, low=low * factor, high=high * factor)


def _range(found: Quantity, unit: str, number: Callable[[float], str]) -> str:
    """Return "2 ms (1 to 3)", or "2 ms" where all are alike."""
    median, low, high = (number(value or 0.0) for value in (found.value, found.low, found.high))
    shown = f"{median} {unit}".rstrip()
    return shown if low == high else f"{shown} ({low} to {high})"


def _time(found: Quantity) -> str:
    """Return a time [ms] in the unit that suits its size."""
    units = (("us", 1e3), ("ms", 1.0), ("s", 1e-3))
    median = found.value or 0.0
    unit, factor = next((one for one in units if median * one[1] < 999.5), units[-1])
    return _range(found, unit, lambda value: _three_digits(value * factor))


def _three_digits(value: float) -> str:
    """Return a positive number with three digits that count: 0.0123, 1.23, 12,300."""
    return f"{float(f'{value:.3g}'):,.15g}"


_HEADINGS: dict[str, tuple[str, Callable[[Quantity], str]]] = {
    "fit-time": ("fit time", _time),
    "throughput": ("predictions a second", lambda found: _range(found, "", _three_digits)),
    "latency": ("latency of one", _time),
    "memory": ("memory [MiB]", lambda found: _range(found, "", lambda size: f"{size:.1f}")),
}
"""Metric of a column -> its heading, and how its quantities are written."""
