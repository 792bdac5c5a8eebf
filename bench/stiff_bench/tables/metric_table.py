"""Convert results to tables like the paper's, in mm and per cent.

A table shows one data set under one protocol. Its rows are models, its columns axes x metrics. All
rows of a table have the same data and splits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from operator import attrgetter, methodcaller

import numpy as np

from stiff_bench.store.names import grouped
from stiff_bench.tables.fit_notes import number_notes, outcome_notes, size_notes
from stiff_bench.tables.published import MARK, NOTE, published_errors
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table
from stiff_bench.tables.units import PRINTED, counted, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.record import CellResult, Cost, Presentation
from stiff_protocols.contract.types import AXES, BOUND_NAMES, Interval, Prediction
from stiff_protocols.scoring.metrics import METRICS, WHOLE_VECTOR, Metric

SELECTION_MARK = "epoch picked on test part"
TRAINING_MARK = "training samples among those reported"
DECIMALS = {"mm": 4, "%": 1, "": 3, "ms": 3, "MiB": 1, "1/s": 0}
"""Decimals by unit; mm as in the source paper's Table 10."""
USUAL_METRICS = ("mae", "stde", "me")
PATH_METRICS = ("norm", "norm-p95", "norm-max", "removed")
Values = Mapping[tuple[str, str], Quantity]
"""Mean and standard deviation over splits in printed units, by (metric key, axis). The
deviation is missing with one split, or with one value for all splits together."""


def build_tables(results: Sequence[CellResult], metrics: Sequence[Metric]) -> list[Table]:
    """Return a table per data set, protocol, condition and seed, in the results' order.

    Models on different data, pre-training data, splits or coverage are in separate tables. Without
    `metrics` the tables show the usual metrics, or the metrics of tool paths.
    """
    groups = grouped(
        results,
        lambda result: (
            result.presentation.dataset,
            result.presentation.protocol,
            result.cell.condition,
            result.cell.seed,
        ),
    )
    return [
        _table(dict(models), tuple(metrics))
        for group in groups.values()
        for models in grouped(
            grouped(group, lambda result: result.presentation.model).items(),
            lambda model: _tested_on(model[1]),
        ).values()
    ]


def _tested_on(results: Sequence[CellResult]) -> frozenset[object]:
    """Return the set of data and split hashes that models in one table share."""
    identity = attrgetter("data_sha256", "source_sha256", "split_sha256", "coverage")
    return frozenset(identity(result.cell) for result in results)


def _table(by_model: dict[str, list[CellResult]], metrics: tuple[Metric, ...]) -> Table:
    group = list(chain.from_iterable(by_model.values()))
    cell, presentation = group[0].cell, group[0].presentation
    usual = PATH_METRICS if presentation.measured_sha256 else USUAL_METRICS
    metrics = metrics or tuple(METRICS[key] for key in usual)
    extra = _extra_results(by_model)
    reference = {name: extra.pop(name) for name in [REFERENCE_MODEL] if name in extra}
    by_model = reference | by_model | extra  # known bounds of a simulation come last
    warned = presentation.selects_on_test or presentation.reports_training
    notes = [*presentation.caveats, *size_notes(group), *([presentation.warning] * warned)]
    for results in by_model.values():
        notes += outcome_notes(results)
    of_table = (
        published_errors(presentation.published)
        if presentation.published and not cell.condition
        else {}
    )
    keys = {metric.key for metric in metrics}
    published = {
        method: values
        for method, values in of_table.items()
        if not keys.isdisjoint(key for key, _ in values)
    }
    notes += [f"[{MARK}]: {NOTE}."] if published else []
    kind, n_splits = presentation.kind, len({r.cell.split_index for r in group})
    facts: dict[str, Entry] = {
        **{"dataset": presentation.dataset, "kind": kind},
        **{"protocol": presentation.protocol, "condition": cell.condition},
        **{"splits": n_splits, "seed": cell.seed, "source": "ours"},
    }
    of_others = {**dict.fromkeys(facts), "source": MARK}
    rows = [
        {"model": name, **facts, **values}
        for name, values in (_of_model(model, of, metrics) for model, of in by_model.items())
        if values or name.text not in extra  # extra rows have no costs and intervals
    ]
    rows += [
        {"model": Name(method, MARK), **of_others, **values} for method, values in published.items()
    ]
    return Table.of(
        _title(group[0], n_splits, metrics),
        [
            Column("model", "text"),
            *(Column(name, "text", hidden=True) for name in facts),
            *metric_columns(metrics),
        ],
        rows,
        notes=notes,
        details=[note for results in by_model.values() for note in number_notes(results)],
        unit=PRINTED["m"][0],
        about={} if cell.coverage is None else {"nominal_coverage": cell.coverage},
    )


def _extra_results(by_model: Mapping[str, list[CellResult]]) -> dict[str, list[CellResult]]:
    """Return results of the VJM and of known bounds, which every cell stores.

    The VJM is fitted to all training and validation rows of the cell. The bounds are known for the
    test rows of a simulation.
    """
    names = [name for name in (REFERENCE_MODEL, *BOUND_NAMES.values()) if name not in by_model]
    rows = {}
    for name in names:
        for results in by_model.values():
            bound_results = [
                bound_result
                for result in results
                if (bound_result := bound_result_of(result, name)) is not None
            ]
            if len(bound_results) == len(results):
                rows[name] = bound_results
                break
    return rows


def bound_result_of(result: CellResult, name: str) -> CellResult | None:
    """Return the VJM's result, or a bound of `BOUND_NAMES`, from a cell; None: not stored."""
    stored = result.prediction
    if stored is None:
        return None
    bound_values = {row: stored.bound_deflections.get(key) for key, row in BOUND_NAMES.items()}
    if (predicted := ({REFERENCE_MODEL: stored.reference} | bound_values)[name]) is None:
        return None
    prediction = Prediction(stored.rows, predicted, stored.measured, reference=stored.reference)
    return CellResult(
        result.cell,
        replace(result.presentation, model=name, regime="", source="", picked_on_test=False),
        *(result.run_id, "ok", prediction),
        n_train=result.n_train,
        n_splits=result.n_splits,
    )


def setting(presentation: Presentation, condition: str, n_splits: int, seed: int) -> str:
    """Return data set, protocol, condition, splits and seed for a title."""
    data = f"{presentation.dataset} ({presentation.kind})"
    protocol = " | ".join(filter(None, (presentation.protocol, condition)))
    return f"{data} | {protocol}, {counted(n_splits, 'split')}, seed {seed}"


def _title(first: CellResult, n_splits: int, metrics: Sequence[Metric]) -> str:
    """Return the setting, unit and nominal coverage in one line."""
    cell, presentation = first.cell, first.presentation
    spread = ", mean ± standard deviation over splits" if n_splits > 1 else ""
    if presentation.pooled:
        spread = " over the predictions of all splits"
    units = " and ".join(filter(None, dict.fromkeys(PRINTED[metric.unit][0] for metric in metrics)))
    intervals = "" if cell.coverage is None else f" | {percent(cell.coverage)} intervals"
    of_cell = setting(presentation, cell.condition, n_splits, cell.seed)
    return f"{of_cell} | {units}{spread}{intervals}"


def metric_columns(metrics: Sequence[Metric]) -> list[Column]:
    """Return columns of metrics, grouped by axis; metrics without axes come last.

    A row has its values under (metric key, axis).
    """
    return [
        Column(
            f"{axis.upper()} {metric.label}".strip(),
            unit=PRINTED[metric.unit][0],
            format=number_format(metric),
            about={"axis": axis, "metric": metric.key},
            value=methodcaller("get", (metric.key, axis)),
        )
        for axis in (*AXES, *WHOLE_VECTOR)
        for metric in metrics
        if axis in metric.axes
    ]


def number_format(metric: Metric) -> str:
    """Return the format of a metric's values in printed units."""
    return f".{DECIMALS[PRINTED[metric.unit][0]]}f"


def _of_model(
    model: str, results: Sequence[CellResult], metrics: Sequence[Metric]
) -> tuple[Name, Values]:
    """Return a model with its values; without values if a cell failed or was skipped."""
    statuses = [result.status for result in results]
    if failed := statuses.count("failed"):
        return Name(model, f"FAILED in {failed} of {len(results)} splits"), {}
    if "skipped" in statuses:
        return Name(model, "SKIPPED"), {}
    return Name(model, mark_of(results[0].presentation)), metric_values(results, metrics)


def metric_values(results: Sequence[CellResult], metrics: Sequence[Metric]) -> Values:
    """Return a model's values over its splits, or over all predictions together.

    The results belong to one data set and protocol, without failures.
    """
    quantities = {}
    for metric in metrics:
        split_values = values_of_splits(metric, results)
        _, factor = PRINTED[metric.unit]
        for axis in metric.axes:
            if all(axis in values for values in split_values):  # no value if a split has none
                quantities[metric.key, axis] = mean_over(
                    [values[axis] * factor for values in split_values]
                )
    return quantities


def metric_lines(prediction: Prediction, cost: Cost | None = None) -> list[dict[str, object]]:
    """Return all metrics as lines of tidy data, in printed units."""
    return [
        {
            "metric": metric.key,
            "axis": axis,
            "value": value * PRINTED[metric.unit][1],
            "unit": PRINTED[metric.unit][0],
        }
        for metric in METRICS.values()
        for axis, value in metric.values(prediction, cost).items()
    ]


def values_of_splits(metric: Metric, results: Sequence[CellResult]) -> list[dict[str, float]]:
    """Return the values of a metric by axis, per split, in SI units.

    If the protocol scores all predictions together, there is one value for all splits; costs still
    have a value per split.
    """
    if results[0].presentation.pooled and metric.of_prediction is not None:
        return [metric.values(pooled_prediction(results))]
    return [metric.of_result(result) for result in results]


def mark_of(presentation: Presentation) -> str:
    """Return the mark printed next to the model's name; "" for none."""
    picked = SELECTION_MARK if presentation.picked_on_test else ""
    trained_on = TRAINING_MARK if presentation.reports_training else ""
    return ", ".join(filter(None, [presentation.regime, picked, trained_on]))


def mean_over(values: Sequence[float], mark: str = "") -> Quantity:
    """Return mean and sample deviation of values; a single value has no deviation."""
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return Quantity(float(np.mean(values)), spread, n=len(values), mark=mark)


def pooled_prediction(results: Sequence[CellResult]) -> Prediction:
    """Join the checked predictions of several splits."""
    parts = [result.prediction for result in results if result.prediction is not None]
    intervals = [part.interval for part in parts if part.interval is not None]
    references = [part.reference for part in parts if part.reference is not None]
    interval = None
    if intervals and len(intervals) == len(parts):
        interval = Interval(
            lower=np.concatenate([part.lower for part in intervals]),
            upper=np.concatenate([part.upper for part in intervals]),
            coverage=intervals[0].coverage,
        )
    return Prediction.of_stored(
        rows=np.concatenate([part.rows for part in parts]),
        predicted=np.concatenate([part.predicted for part in parts]),
        measured=np.concatenate([part.measured for part in parts]),
        interval=interval,
        reference=np.concatenate(references) if len(references) == len(parts) else None,
        bound_deflections={},
    )
