"""Results -> paper-style tables. Here SI becomes mm, and here numbers are rounded.

A table holds one data set under one protocol; rows are models, columns axes x metrics. Rows of
different data or of different splits never meet in one table.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stiff_bench.published import MARK, NOTE, published_rows
from stiff_bench.runner import CellTask
from stiff_protocols.contract import EvaluationProtocol
from stiff_protocols.errors import StoreError
from stiff_protocols.metrics import Metric
from stiff_protocols.record import CellResult
from stiff_protocols.types import AXES, Prediction

MM = 1000.0
SELECTION_MARK = "epoch picked on test part"


@dataclass(frozen=True)
class Value:
    """A metric on an axis, mm: its mean over the splits and their standard deviation.

    The deviation is NaN where there is one split, or one value over all splits together.
    """

    mean: float
    std: float


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
        dataset, kind, protocol: keys, and "simulated" or "measured" with another task's name.
        options: what was set of the data set, "name=value, ..."; "" for all defaults.
        n_splits, pooled: how many splits, and whether they are scored together.
        seed: of the run.
        metrics: the columns of each axis.
        rows: models, then published methods.
        notes: what must be read with it.
    """

    dataset: str
    kind: str
    protocol: str
    options: str
    n_splits: int
    pooled: bool
    seed: int
    metrics: tuple[Metric, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...]

    @property
    def title(self) -> str:
        """Data set, protocol, splits, seed and unit in one line."""
        splits = "1 split" if self.n_splits == 1 else f"{self.n_splits} splits"
        spread = ""
        if self.pooled:
            spread = " over the predictions of all splits"
        elif self.n_splits > 1:
            spread = ", mean ± standard deviation over splits"
        about = ", ".join(filter(None, (self.kind, self.options)))
        return (
            f"{self.dataset} ({about}) | {self.protocol}, {splits}, seed {self.seed} | mm{spread}"
        )


def build_tables(
    tasks: Sequence[CellTask], results: Sequence[CellResult], metrics: Sequence[Metric]
) -> list[Table]:
    """Return a table for each data set and protocol of a run, in the run's order.

    Raises:
        StoreError: rows of different data or splits would meet in one table.
    """
    groups: dict[tuple[str, str], list[tuple[CellTask, CellResult]]] = {}
    for task, result in zip(tasks, results, strict=True):
        groups.setdefault((task.cell.dataset, task.cell.protocol), []).append((task, result))
    return [_table(group, tuple(metrics)) for group in groups.values()]


def _table(group: list[tuple[CellTask, CellResult]], metrics: tuple[Metric, ...]) -> Table:
    first = group[0][0]
    dataset, protocol = first.dataset.info, first.protocol.info
    made: EvaluationProtocol = first.protocol.make()
    by_model: dict[str, list[tuple[CellTask, CellResult]]] = {}
    for task, result in group:
        by_model.setdefault(task.cell.model, []).append((task, result))
    _refuse_mixed(by_model)
    rows = [_model_row(cells, metrics, pooled=made.pooled) for cells in by_model.values()]
    notes = [*dataset.caveats]
    if made.selects_on_test:
        notes.append(protocol.warning)
    for cells in by_model.values():
        notes += _model_notes([result for _, result in cells])
    if dataset.published:
        rows += [
            _published_row(row.method, row.values_mm) for row in published_rows(dataset.published)
        ]
        notes.append(f"[{MARK}]: {NOTE}.")
    return Table(
        dataset=dataset.key,
        kind=dataset.label,
        protocol=protocol.key,
        options=first.dataset.options_text,
        n_splits=first.n_splits,
        pooled=made.pooled,
        seed=first.cell.seed,
        metrics=metrics,
        rows=tuple(rows),
        notes=tuple(notes),
    )


def _refuse_mixed(by_model: Mapping[str, list[tuple[CellTask, CellResult]]]) -> None:
    identities = {
        tuple((task.cell.data_sha256, task.cell.split_sha256) for task, _ in cells)
        for cells in by_model.values()
    }
    if len(identities) > 1:
        raise StoreError("rows of different data or different splits cannot stand in one table")


def _model_row(
    cells: list[tuple[CellTask, CellResult]], metrics: Sequence[Metric], *, pooled: bool
) -> Row:
    task = cells[0][0]
    results = [result for _, result in cells]
    info = task.model.info
    picked = task.selects_on_test and task.chooses_epoch
    failed = sum(result.status == "failed" for result in results)
    if failed:
        return Row(info.key, "ours", f"FAILED in {failed} of {len(results)} splits", {})
    values = _pooled_values(results, metrics) if pooled else _split_values(results, metrics)
    return Row(info.key, "ours", SELECTION_MARK if picked else "", values)


def _split_values(
    results: Sequence[CellResult], metrics: Sequence[Metric]
) -> dict[tuple[str, str], Value]:
    values = {}
    for metric in metrics:
        for axis in AXES:
            of_splits = [
                record.value * MM
                for result in results
                for record in result.records
                if (record.metric, record.axis) == (metric.key, axis)
            ]
            std = float(np.std(of_splits, ddof=1)) if len(of_splits) > 1 else math.nan
            values[metric.key, axis] = Value(float(np.mean(of_splits)), std)
    return values


def _pooled_values(
    results: Sequence[CellResult], metrics: Sequence[Metric]
) -> dict[tuple[str, str], Value]:
    parts = [result.prediction for result in results if result.prediction is not None]
    together = Prediction(
        np.concatenate([part.rows for part in parts]),
        np.concatenate([part.predicted for part in parts]),
        np.concatenate([part.measured for part in parts]),
    )
    return {
        (metric.key, axis): Value(float(value) * MM, math.nan)
        for metric in metrics
        for axis, value in zip(AXES, metric(together), strict=True)
    }


def _published_row(method: str, values_mm: Mapping[tuple[str, str], float]) -> Row:
    values = {key: Value(value, math.nan) for key, value in values_mm.items()}
    return Row(method, "published", MARK, values)


def _model_notes(results: Sequence[CellResult]) -> list[str]:
    """Return what a model's cells reported: numbers as means, warnings, reasons of failure."""
    name = results[0].cell.model
    notes = []
    done = [result for result in results if result.status == "ok"]
    if done and done[0].diagnostics:
        numbers = []
        for key in done[0].diagnostics:
            values = [result.diagnostics.get(key, math.nan) for result in done]
            numbers.append(f"{key} {float(np.mean(values)):.4g}")
        over = f" (means over {len(done)} splits)" if len(done) > 1 else ""
        notes.append(f"{name}{over}: {', '.join(numbers)}.")
    for kind, messages in (
        ("warning", [message for result in results for message in result.warnings]),
        ("FAILED", [result.failure for result in results if result.failure]),
    ):
        lines = [" ".join(message.split()) for message in messages]
        for message in dict.fromkeys(lines):
            times = lines.count(message)
            where = f" ({times} of {len(results)} splits)" if len(results) > 1 else ""
            notes.append(f"{name}: {kind}{where}: {message}")
    return notes
