"""Results -> paper-style tables. Here SI becomes mm and per cent.

A table holds one data set under one protocol; rows are models, columns axes x metrics. Rows of
different data or of different splits never meet in one table.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.published import MARK, NOTE, published_rows
from stiff_protocols.errors import StoreError
from stiff_protocols.metrics import Metric, Unit
from stiff_protocols.plugin import kind_label
from stiff_protocols.record import CellResult, Presentation
from stiff_protocols.search_space import in_words
from stiff_protocols.types import Interval, Prediction

PRINTED: dict[Unit, tuple[str, float]] = {
    "m": ("mm", 1000.0),
    "share": ("%", 100.0),
    "1": ("", 1.0),
    "s": ("ms", 1000.0),
    "B": ("MiB", 2.0**-20),
    "1/s": ("1/s", 1.0),
}
"""Unit of a metric -> the unit it is printed in, and how many of those it is."""
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
        name: model or published method.
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
        return f"{self.name} [{self.mark}]" if self.mark else self.name


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
        splits = "1 split" if self.n_splits == 1 else f"{self.n_splits} splits"
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


def percent(share: float) -> str:
    """Return a share for people."""
    return f"{100.0 * share:g} %"


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
    notes = [*shown.caveats]
    if shown.selects_on_test:
        notes.append(shown.warning)
    for results in by_model.values():
        notes += _model_notes(results)
    if shown.published and not cell.condition:
        rows += [
            _published_row(row.method, row.values_mm) for row in published_rows(shown.published)
        ]
        notes.append(f"[{MARK}]: {NOTE}.")
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
    """See that every model's results are of the same data, splits and coverage.

    Raises:
        StoreError: they are not.
    """
    identities = {
        tuple(
            (result.cell.data_sha256, result.cell.split_sha256, result.cell.coverage)
            for result in results
        )
        for results in by_model.values()
    }
    if len(identities) > 1:
        raise StoreError(
            "rows of different data, different splits or different coverage cannot stand in one "
            "table"
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


def _published_row(method: str, values_mm: Mapping[tuple[str, str], float]) -> Row:
    values = {key: Value(value, math.nan, "mm") for key, value in values_mm.items()}
    return Row(method, "published", MARK, values)


def _model_notes(results: Sequence[CellResult]) -> list[str]:
    """Return what a model's cells reported: numbers as means, warnings, reasons of failure."""
    name = results[0].shown.model
    notes = []
    done = [result for result in results if result.status == "ok"]
    if done and done[0].diagnostics:
        numbers = []
        for key in done[0].diagnostics:
            values = [result.diagnostics.get(key, math.nan) for result in done]
            numbers.append(f"{key} {_mean_text(values)}")
        over = f" (means over {len(done)} splits)" if len(done) > 1 else ""
        notes.append(f"{name}{over}: {', '.join(numbers)}.")
    notes += _chosen_notes(name, done)
    coverage = results[0].cell.coverage
    if coverage is not None and any(_has_interval(result) for result in done):
        notes.append(f"{name}: {percent(coverage)} intervals are {_interval_kind(done)}.")
    for kind, messages in (
        ("warning", [message for result in results for message in result.warnings]),
        ("FAILED", [result.failure for result in results if result.status == "failed"]),
        ("SKIPPED", [result.failure for result in results if result.status == "skipped"]),
    ):
        lines = [_one_line(message) for message in messages]
        for message in dict.fromkeys(lines):
            times = lines.count(message)
            where = f" ({times} of {len(results)} splits)" if len(results) > 1 else ""
            notes.append(f"{name}: {kind}{where}: {message}")
    return notes


def _chosen_notes(name: str, done: Sequence[CellResult]) -> list[str]:
    """Return which options the fits chose, and in how many splits each; none where none did."""
    choices = [in_words(result.chosen) for result in done if result.chosen]
    if not choices:
        return []
    counted = [
        f"{chosen} ({choices.count(chosen)} of {len(done)} splits)" if len(done) > 1 else chosen
        for chosen in dict.fromkeys(choices)
    ]
    return [f"{name}: chosen on inner folds: {'; '.join(counted)}."]


def _has_interval(result: CellResult) -> bool:
    return result.prediction is not None and result.prediction.interval is not None


def _mean_text(values: Sequence[float]) -> str:
    """Return a mean for people; an infinite value (a joint found rigid) is counted apart."""
    finite = [value for value in values if not math.isinf(value)]
    if len(finite) == len(values) or not finite:
        return f"{float(np.mean(values)):.4g}"
    n_infinite = len(values) - len(finite)
    return f"{float(np.mean(finite)):.4g} (and infinite in {n_infinite} of {len(values)})"


def _interval_kind(results: Sequence[CellResult]) -> str:
    counts = sorted({result.calibration_samples for result in results})
    if counts[-1] == 0:
        return "the model's own"
    of_splits = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return f"split-conformal, with {of_splits} calibration samples"


def _one_line(text: str) -> str:
    return " ".join(text.split())
