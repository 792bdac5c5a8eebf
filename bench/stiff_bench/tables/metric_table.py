"""Results -> paper-style tables. Here SI becomes mm and per cent.

A table holds one data set under one protocol; rows are models, columns axes x metrics. Rows of
different data or of different splits never meet in one table.
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
from stiff_protocols.contract.types import AXES, KNOWN, Interval, Prediction
from stiff_protocols.scoring.metrics import METRICS, WHOLE, Metric

SELECTION_MARK = "epoch picked on test part"
TRAINING_MARK = "training samples among those reported"
DECIMALS = {"mm": 4, "%": 1, "": 3, "ms": 3, "MiB": 1, "1/s": 0}
"""Of mm: as in the source paper's Table 10."""
USUAL_METRICS = ("mae", "stde", "me")
PATH_METRICS = ("norm", "norm-p95", "norm-max", "removed")
Values = Mapping[tuple[str, str], Quantity]
"""(metric key, axis) -> mean over the splits and their standard deviation, as printed; no
deviation where there is one split, or one value over all splits together."""


def build_tables(results: Sequence[CellResult], metrics: Sequence[Metric]) -> list[Table]:
    """Return a table for each data set, protocol, condition and seed, in the results' order.

    Models on different data, pre-training data, splits or coverage stand in tables of their own.
    Where no metrics are asked for, they are the usual ones, or those of tool paths.
    """
    groups = grouped(
        results,
        lambda one: (one.shown.dataset, one.shown.protocol, one.cell.condition, one.cell.seed),
    )
    return [
        _table(dict(models), tuple(metrics))
        for group in groups.values()
        for models in grouped(
            grouped(group, lambda result: result.shown.model).items(),
            lambda model: _tested_on(model[1]),
        ).values()
    ]


def _tested_on(results: Sequence[CellResult]) -> frozenset[object]:
    """Return what models must share to stand in one table, in whichever order it was stored."""
    identity = attrgetter("data_sha256", "source_sha256", "split_sha256", "coverage")
    return frozenset(identity(result.cell) for result in results)


def _table(by_model: dict[str, list[CellResult]], metrics: tuple[Metric, ...]) -> Table:
    group = list(chain.from_iterable(by_model.values()))
    cell, shown = group[0].cell, group[0].shown
    usual = PATH_METRICS if shown.measured_sha256 else USUAL_METRICS
    metrics = metrics or tuple(METRICS[key] for key in usual)
    beside = _beside_models(by_model)
    reference = {name: beside.pop(name) for name in [REFERENCE_MODEL] if name in beside}
    by_model = reference | by_model | beside  # what only a simulation knows comes last
    warned = shown.selects_on_test or shown.reports_training
    notes = [*shown.caveats, *size_notes(group), *([shown.warning] * warned)]
    for results in by_model.values():
        notes += outcome_notes(results)
    of_table = published_errors(shown.published) if shown.published and not cell.condition else {}
    keys = {metric.key for metric in metrics}
    published = {
        method: values
        for method, values in of_table.items()
        if not keys.isdisjoint(key for key, _ in values)
    }
    notes += [f"[{MARK}]: {NOTE}."] if published else []
    kind, n_splits = shown.kind, len({r.cell.split_index for r in group})
    facts: dict[str, Entry] = {
        **{"dataset": shown.dataset, "kind": kind},
        **{"protocol": shown.protocol, "condition": cell.condition},
        **{"splits": n_splits, "seed": cell.seed, "source": "ours"},
    }
    of_others = {**dict.fromkeys(facts), "source": MARK}
    rows = [
        {"model": name, **facts, **values}
        for name, values in (_of_model(model, of, metrics) for model, of in by_model.items())
        if values or name.text not in beside  # they have neither costs nor intervals
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


def _beside_models(by_model: Mapping[str, list[CellResult]]) -> dict[str, list[CellResult]]:
    """Return the results that each cell has beside its model's own.

    Every cell stores what the VJM predicts that learned from its whole training side, and what a
    simulation knows of the test rows.
    """
    names = [name for name in (REFERENCE_MODEL, *KNOWN.values()) if name not in by_model]
    rows = {}
    for name in names:
        for results in by_model.values():
            found = [one for result in results if (one := known_result(result, name)) is not None]
            if len(found) == len(results):
                rows[name] = found
                break
    return rows


def known_result(result: CellResult, name: str) -> CellResult | None:
    """Return the VJM's result, or one of `KNOWN`, that a cell holds; None where it has none."""
    found = result.prediction
    if found is None:
        return None
    known = {row: found.known.get(key) for key, row in KNOWN.items()}
    if (other := ({REFERENCE_MODEL: found.reference} | known)[name]) is None:
        return None
    prediction = Prediction(found.rows, other, found.measured, reference=found.reference)
    return CellResult(
        result.cell,
        replace(result.shown, model=name, regime="", source="", picked_on_test=False),
        *(result.run_id, "ok", prediction),
        n_train=result.n_train,
        n_splits=result.n_splits,
    )


def setting(shown: Presentation, condition: str, n_splits: int, seed: int) -> str:
    """Return data set, protocol, condition, splits and seed, as a title has them."""
    data = f"{shown.dataset} ({shown.kind})"
    protocol = " | ".join(filter(None, (shown.protocol, condition)))
    return f"{data} | {protocol}, {counted(n_splits, 'split')}, seed {seed}"


def _title(first: CellResult, n_splits: int, metrics: Sequence[Metric]) -> str:
    """Return the setting, unit and nominal coverage in one line."""
    cell, shown = first.cell, first.shown
    spread = ", mean ± standard deviation over splits" if n_splits > 1 else ""
    if shown.pooled:
        spread = " over the predictions of all splits"
    units = " and ".join(filter(None, dict.fromkeys(PRINTED[one.unit][0] for one in metrics)))
    intervals = "" if cell.coverage is None else f" | {percent(cell.coverage)} intervals"
    of_cell = setting(shown, cell.condition, n_splits, cell.seed)
    return f"{of_cell} | {units}{spread}{intervals}"


def metric_columns(metrics: Sequence[Metric]) -> list[Column]:
    """Return the columns: all metrics of an axis stand together, those without axes come last.

    They read a row that has a value under (metric key, axis).
    """
    return [
        Column(
            f"{axis.upper()} {metric.label}".strip(),
            unit=PRINTED[metric.unit][0],
            format=number_format(metric),
            about={"axis": axis, "metric": metric.key},
            value=methodcaller("get", (metric.key, axis)),
        )
        for axis in (*AXES, *WHOLE)
        for metric in metrics
        if axis in metric.axes
    ]


def number_format(metric: Metric) -> str:
    """Return how its values are written, as printed."""
    return f".{DECIMALS[PRINTED[metric.unit][0]]}f"


def _of_model(
    model: str, results: Sequence[CellResult], metrics: Sequence[Metric]
) -> tuple[Name, Values]:
    """Return a model with its values; a failed or skipped cell leaves none."""
    statuses = [result.status for result in results]
    if failed := statuses.count("failed"):
        return Name(model, f"FAILED in {failed} of {len(results)} splits"), {}
    if "skipped" in statuses:
        return Name(model, "SKIPPED"), {}
    return Name(model, mark_of(results[0].shown)), metric_values(results, metrics)


def metric_values(results: Sequence[CellResult], metrics: Sequence[Metric]) -> Values:
    """Return a model's values over its splits, or over their predictions together.

    The results are of one data set and protocol; none has failed.
    """
    found = {}
    for metric in metrics:
        each = values_of_splits(metric, results)
        _, factor = PRINTED[metric.unit]
        for axis in metric.axes:
            if all(axis in values for values in each):  # none where a split lacks it
                found[metric.key, axis] = mean_over([values[axis] * factor for values in each])
    return found


def metric_lines(prediction: Prediction, cost: Cost | None = None) -> list[dict[str, object]]:
    """Return every metric as lines of tidy data, in the units that they are printed in."""
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
    """Return axis -> value of a model on each split, in SI units.

    One value where the protocol scores the predictions of all splits together; costs have one for
    each split there, too.
    """
    if results[0].shown.pooled and metric.of_prediction is not None:
        return [metric.values(pooled_prediction(results))]
    return [metric.of_result(result) for result in results]


def mark_of(shown: Presentation) -> str:
    """Return what must stand beside the model's name; "" for nothing."""
    picked = SELECTION_MARK if shown.picked_on_test else ""
    trained_on = TRAINING_MARK if shown.reports_training else ""
    return ", ".join(filter(None, [shown.regime, picked, trained_on]))


def mean_over(values: Sequence[float], mark: str = "") -> Quantity:
    """Return mean and sample deviation over splits or specimens; one alone has no deviation."""
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return Quantity(float(np.mean(values)), spread, n=len(values), mark=mark)


def pooled_prediction(results: Sequence[CellResult]) -> Prediction:
    """Return the predictions of several splits as one; each of them was checked."""
    parts = [result.prediction for result in results if result.prediction is not None]
    intervals = [part.interval for part in parts if part.interval is not None]
    references = [part.reference for part in parts if part.reference is not None]
    interval = None
    if intervals and len(intervals) == len(parts):
        interval = Interval(
            lower=np.concatenate([one.lower for one in intervals]),
            upper=np.concatenate([one.upper for one in intervals]),
            coverage=intervals[0].coverage,
        )
    return Prediction.of_stored(
        rows=np.concatenate([part.rows for part in parts]),
        predicted=np.concatenate([part.predicted for part in parts]),
        measured=np.concatenate([part.measured for part in parts]),
        interval=interval,
        reference=np.concatenate(references) if len(references) == len(parts) else None,
        known={},
    )
