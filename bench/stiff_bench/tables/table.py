"""Results -> paper-style tables. Here SI becomes mm and per cent.

A table holds one data set under one protocol; rows are models, columns axes x metrics. Rows of
different data or of different splits never meet in one table.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.tables.fit_notes import model_notes, size_notes
from stiff_bench.tables.published import MARK, NOTE, published_rows
from stiff_bench.tables.units import PRINTED, counted, marked, percent
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.plugin import kind_label
from stiff_protocols.contract.record import CellResult, Presentation
from stiff_protocols.contract.types import Interval, Prediction
from stiff_protocols.scoring.metrics import Metric

SELECTION_MARK = "epoch picked on test part"


@dataclass(frozen=True)
class Value:
    """A metric on an axis: its mean over the splits and their standard deviation.

    Attributes:
        mean, std: in `unit`; the deviation is NaN where there is one split, or one value over
            all splits together.
        unit: as printed, one of `PRINTED`.
    """

    mean: float
    std: float
    unit: str


@dataclass(frozen=True)
class Row:
    """A line of a table.

    Attributes:
        name: model with its options, or published method.
        source: "ours" or "published".
        mark: what must stand beside the name; "" for nothing.
        values: (metric key, axis) -> value; a missing one prints as a dash.
    """

    name: str
    source: str
    mark: str
    values: Mapping[tuple[str, str], Value]

    @property
    def label(self) -> str:
        """Name with its mark."""
        return marked(self.name, self.mark)


@dataclass(frozen=True)
class Table:
    """One data set under one protocol.

    Attributes:
        dataset, protocol: names.
        kind: "simulated" or "measured", with another task's name.
        condition: which of the protocol's; "" where it has but one.
        n_splits, pooled: how many splits, and whether they are scored together.
        seed: of the run.
        metrics: the columns of each axis.
        coverage: nominal coverage of the intervals; None: there are none.
        rows: models, then published methods.
        notes: what must be read with it.
    """

    dataset: str
    kind: str
    protocol: str
    condition: str
    n_splits: int
    pooled: bool
    seed: int
    metrics: tuple[Metric, ...]
    coverage: float | None
    rows: tuple[Row, ...]
    notes: tuple[str, ...]

    @property
    def title(self) -> str:
        """Data set, protocol, splits, seed, unit and nominal coverage in one line."""
        splits = counted(self.n_splits, "split")
        spread = ""
        if self.pooled:
            spread = " over the predictions of all splits"
        elif self.n_splits > 1:
            spread = ", mean ± standard deviation over splits"
        units = dict.fromkeys(PRINTED[metric.unit][0] for metric in self.metrics)
        unit = " and ".join(filter(None, units))
        protocol = " | ".join(filter(None, (self.protocol, self.condition)))
        intervals = "" if self.coverage is None else f" | {percent(self.coverage)} intervals"
        return (
            f"{self.dataset} ({self.kind}) | {protocol}, {splits}, seed {self.seed} | "
            f"{unit}{spread}{intervals}"
        )


def build_tables(results: Sequence[CellResult], metrics: Sequence[Metric]) -> list[Table]:
    """Return a table for each data set, protocol and condition, in the results' order.

    Raises:
        StoreError: rows of different data or splits would meet in one table.
    """
    groups: dict[tuple[str, str, str], list[CellResult]] = {}
    for result in results:
        shown = result.shown
        task = (shown.dataset, shown.protocol, result.cell.condition)
        groups.setdefault(task, []).append(result)
    return [_table(group, tuple(metrics)) for group in groups.values()]


def _table(group: list[CellResult], metrics: tuple[Metric, ...]) -> Table:
    cell, shown = group[0].cell, group[0].shown
    by_model: dict[str, list[CellResult]] = {}
    for result in group:
        by_model.setdefault(result.shown.model, []).append(result)
    refuse_mixed(by_model)
    rows = [_model_row(results, metrics) for results in by_model.values()]
    notes = [*shown.caveats, *size_notes(group)]
    if shown.selects_on_test:
        notes.append(shown.warning)
    for results in by_model.values():
        notes += model_notes(results)
    if shown.published and not cell.condition:
        published = _published_rows(shown.published, metrics)
        rows += published
        notes += [f"[{MARK}]: {NOTE}."] if published else []
    return Table(
        dataset=shown.dataset,
        kind=kind_label(shown.kind, shown.task),
        protocol=shown.protocol,
        condition=cell.condition,
        n_splits=len({result.cell.split_index for result in group}),
        pooled=shown.pooled,
        seed=cell.seed,
        metrics=metrics,
        coverage=cell.coverage,
        rows=tuple(rows),
        notes=tuple(notes),
    )


def refuse_mixed(by_model: Mapping[str, Sequence[CellResult]]) -> None:
    """See that every model's results are of the same data, source, splits and coverage.

    Raises:
        StoreError: they are not.
    """
    identities = {
        tuple(
            (
                result.cell.data_sha256,
                result.cell.source_sha256,
                result.cell.split_sha256,
                result.cell.coverage,
            )
            for result in results
        )
        for results in by_model.values()
    }
    if len(identities) > 1:
        raise StoreError(
            "rows of different data, different sources, different splits or different coverage "
            "cannot stand in one table"
        )


def _model_row(results: Sequence[CellResult], metrics: Sequence[Metric]) -> Row:
    shown = results[0].shown
    failed = sum(result.status == "failed" for result in results)
    if failed:
        return Row(shown.model, "ours", f"FAILED in {failed} of {len(results)} splits", {})
    if any(result.status == "skipped" for result in results):
        return Row(shown.model, "ours", "SKIPPED", {})
    values = _pooled_values(results, metrics) if shown.pooled else _split_values(results, metrics)
    return Row(shown.model, "ours", mark_of(shown), values)


def mark_of(shown: Presentation) -> str:
    """Return what must stand beside the model's name; "" for nothing."""
    return ", ".join(filter(None, [shown.regime, SELECTION_MARK if shown.picked_on_test else ""]))


def _split_values(
    results: Sequence[CellResult], metrics: Sequence[Metric]
) -> dict[tuple[str, str], Value]:
    """Return mean and deviation of each value over the splits; none where a split lacks it."""
    of_splits: dict[tuple[str, str], list[float]] = {}
    for result in results:
        for record in result.records:
            of_splits.setdefault((record.metric, record.axis), []).append(record.value)
    return {
        (metric.key, axis): _value(metric, found)
        for metric in metrics
        for axis in metric.axes
        if len(found := of_splits.get((metric.key, axis), [])) == len(results)
    }


def _value(metric: Metric, values: Sequence[float]) -> Value:
    unit, factor = PRINTED[metric.unit]
    std = float(np.std(values, ddof=1)) if len(values) > 1 else math.nan
    return Value(float(np.mean(values)) * factor, std * factor, unit)


def _pooled_values(
    results: Sequence[CellResult], metrics: Sequence[Metric]
) -> dict[tuple[str, str], Value]:
    """Return the values over the predictions of all splits; costs are means over the splits."""
    together = pooled_prediction(results)
    of_costs = _split_values(results, [metric for metric in metrics if metric.of_cost is not None])
    return of_costs | {
        (metric.key, axis): _value(metric, [value])
        for metric in metrics
        for axis, value in metric.values(together).items()
    }


def pooled_prediction(results: Sequence[CellResult]) -> Prediction:
    """Return the predictions of several splits as one."""
    parts = [result.prediction for result in results if result.prediction is not None]
    intervals = [part.interval for part in parts if part.interval is not None]
    references = [part.reference for part in parts if part.reference is not None]
    return Prediction(
        np.concatenate([part.rows for part in parts]),
        np.concatenate([part.predicted for part in parts]),
        np.concatenate([part.measured for part in parts]),
        _together(intervals) if len(intervals) == len(parts) else None,
        np.concatenate(references) if len(references) == len(parts) else None,
    )


def _together(intervals: Sequence[Interval]) -> Interval:
    return Interval(
        np.concatenate([interval.lower for interval in intervals]),
        np.concatenate([interval.upper for interval in intervals]),
        intervals[0].coverage,
    )


def _published_rows(table: str, metrics: Sequence[Metric]) -> list[Row]:
    """Return the rows of a published table; none where it has none of these metrics."""
    keys = {metric.key for metric in metrics}
    return [
        Row(
            row.method,
            "published",
            MARK,
            {key: Value(value, math.nan, "mm") for key, value in row.values_mm.items()},
        )
        for row in published_rows(table)
        if keys & {key for key, _ in row.values_mm}
    ]
