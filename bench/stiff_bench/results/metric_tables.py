"""Tables like the paper's: models by axes and metrics, in mm and per cent.

A table shows one data set under one protocol. All its rows have the same data and splits.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from operator import attrgetter

from stiff_bench.results.columns import metric_columns
from stiff_bench.results.fit_values import bound_results, metric_values
from stiff_bench.results.notes import (
    failure_lines,
    mark_of,
    number_notes,
    outcome_notes,
    size_notes,
)
from stiff_bench.store.names import grouped
from stiff_bench.tables.published import MARK, NOTE, published_errors
from stiff_bench.tables.table import Column, Entry, Name, Quantity, Table
from stiff_bench.tables.units import PRINTED, counted, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.record import CellResult, Presentation
from stiff_protocols.contract.types import BOUND_NAMES
from stiff_protocols.scoring.metrics import METRICS, Metric

USUAL_METRICS = ("mae", "stde", "me")
PATH_METRICS = ("norm", "norm-p95", "norm-max", "removed")


def metric_tables(results: Sequence[CellResult], metrics: Sequence[Metric]) -> list[Table]:
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
    extra = {
        name: results
        for name in (REFERENCE_MODEL, *BOUND_NAMES.values())
        if name not in by_model and (results := bound_results(by_model.values(), name))
    }
    reference = {name: extra.pop(name) for name in [REFERENCE_MODEL] if name in extra}
    by_model = reference | by_model | extra  # known bounds of a simulation come last
    warned = presentation.selects_on_test or presentation.reports_training
    notes = [*presentation.caveats, *size_notes(group), *([presentation.warning] * warned)]
    for results in by_model.values():
        notes += outcome_notes(results)
    notes += failure_lines(group)
    published = {}
    if presentation.published and not cell.condition:
        keys = {metric.key for metric in metrics}
        published = {
            method: values
            for method, values in published_errors(presentation.published).items()
            if any(key in keys for key, _ in values)
        }
    notes += [f"[{MARK}]: {NOTE}."] if published else []
    n_splits = len({result.cell.split_index for result in group})
    facts: dict[str, Entry] = {
        **{"dataset": presentation.dataset, "kind": presentation.kind},
        **{"protocol": presentation.protocol, "condition": cell.condition},
        **{"splits": n_splits, "seed": cell.seed, "source": "ours"},
    }
    rows = [
        {"model": name, **facts, **values}
        for name, values in (_model_values(model, of, metrics) for model, of in by_model.items())
        if values or name.text not in extra  # bounds have no costs and intervals
    ]
    of_others = {**dict.fromkeys(facts), "source": MARK}
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


def _model_values(
    model: str, results: Sequence[CellResult], metrics: Sequence[Metric]
) -> tuple[Name, dict[tuple[str, str], Quantity]]:
    """Return a model with its values; without values if a fit failed or was skipped."""
    statuses = [result.status for result in results]
    if failed := statuses.count("failed"):
        return Name(model, f"FAILED in {failed} of {len(results)} splits"), {}
    if "skipped" in statuses:
        return Name(model, "SKIPPED"), {}
    return Name(model, mark_of(results[0].presentation)), metric_values(results, metrics)


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
    of_fits = setting(presentation, cell.condition, n_splits, cell.seed)
    return f"{of_fits} | {units}{spread}{intervals}"
