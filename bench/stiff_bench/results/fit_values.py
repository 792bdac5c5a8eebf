"""Compute the values of fits: metrics of splits, and known bounds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stiff_bench.tables.table import Quantity
from stiff_bench.tables.units import PRINTED
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.record import Cost, FitResult
from stiff_protocols.contract.types import BOUND_NAMES, TRUTHS, Interval, Prediction
from stiff_protocols.scoring.metrics import METRICS, Metric


def pooled_prediction(results: Sequence[FitResult]) -> Prediction:
    """Join the checked predictions of several splits."""
    parts = [result.prediction for result in results if result.prediction is not None]
    intervals = [part.interval for part in parts if part.interval is not None]
    references = [part.reference for part in parts if part.reference is not None]
    truths = {
        name: np.concatenate([part.bound_deflections[name] for part in parts])
        for name in TRUTHS
        if parts and all(name in part.bound_deflections for part in parts)
    }
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
        bound_deflections=truths,
        directions=np.concatenate([part.directions for part in parts]),
    )


def bound_results(models: Iterable[Sequence[FitResult]], name: str) -> list[FitResult]:
    """Return the VJM's results, or a bound of `BOUND_NAMES`, from the fits of any model; or none.

    Each fit stores the predictions of the VJM on its test rows. The bounds are known for the test
    rows of a simulation.
    """
    for results in models:
        bounds = [bound for result in results if (bound := _bound_result(result, name))]
        if bounds and len(bounds) == len(results):
            return bounds
    return []


def _bound_result(result: FitResult, name: str) -> FitResult | None:
    if (stored := result.prediction) is None:
        return None
    bounds = {row: stored.bound_deflections.get(key) for key, row in BOUND_NAMES.items()}
    if (predicted := ({REFERENCE_MODEL: stored.reference} | bounds)[name]) is None:
        return None
    truths = {key: of for key, of in stored.bound_deflections.items() if key in TRUTHS}
    prediction = Prediction(
        stored.rows, predicted, stored.measured, None, stored.reference, truths, stored.directions
    )
    presentation = replace(
        result.presentation, model=name, regime="", source="", picked_on_test=False
    )
    return FitResult(
        *(result.fit, presentation, result.run_id, "ok", prediction),
        n_train=result.n_train,
        n_splits=result.n_splits,
    )


def values_of_splits(metric: Metric, results: Sequence[FitResult]) -> list[dict[str, float]]:
    """Return the values of a metric by axis, per split, in SI units.

    If the protocol scores all predictions together, there is one value for all splits; costs still
    have a value per split.
    """
    if results[0].presentation.pooled and metric.of_prediction is not None:
        return [metric.values(pooled_prediction(results))]
    return [metric.of_result(result) for result in results]


def metric_values(
    results: Sequence[FitResult], metrics: Sequence[Metric]
) -> dict[tuple[str, str], Quantity]:
    """Return mean and deviation over splits in printed units, by (metric key, axis).

    The results belong to one data set and protocol, without failures. A metric that a split does
    not have is omitted.
    """
    quantities = {}
    for metric in metrics:
        split_values = values_of_splits(metric, results)
        _, factor = PRINTED[metric.unit]
        for axis in metric.axes:
            if all(axis in values for values in split_values):
                quantities[metric.key, axis] = mean_over([v[axis] * factor for v in split_values])
    return quantities


def mean_over(values: Sequence[float], mark: str = "") -> Quantity:
    """Return mean and sample deviation of values; a single value has no deviation."""
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return Quantity(float(np.mean(values)), spread, n=len(values), mark=mark)


def metric_lines(prediction: Prediction | None, cost: Cost | None = None) -> list[dict[str, Any]]:
    """Return all metrics as lines of tidy data, in printed units; none without a prediction."""
    if prediction is None:
        return []
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
