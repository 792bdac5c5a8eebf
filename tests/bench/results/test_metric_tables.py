"""Tables of metrics: numbers by hand, published rows, and what is never in one table."""

from __future__ import annotations

import json
import math
import statistics
from dataclasses import replace

import numpy as np
import pytest

from stiff_bench.results.columns import metric_tables
from stiff_bench.tables.table import Quantity, Table
from stiff_bench.tables.writers import render
from stiff_protocols.contract.record import Cost, FitResult
from stiff_protocols.contract.types import Interval, Prediction
from stiff_protocols.scoring.metrics import metric

METRICS = [metric(key) for key in ("mae", "stde", "me")]
COST = Cost(fit_s=1.5, predict_s=0.1, latency_s=5e-5, throughput_per_s=2e4, memory_bytes=2**21)
WITH_INTERVALS = [metric(key) for key in ("mae", "coverage", "width")]


def result(task, error_m, *, interval_m=None, reference_m=None, known_m=(), **changes):
    """Return a result with errors of `error_m` on every axis, and known predictions."""
    rows = task.split.test
    measured = task.data.samples.deflection[rows]
    interval = None if interval_m is None else Interval(*(measured + interval_m), 0.9)
    reference = None if reference_m is None else measured + reference_m
    known_predictions = {name: measured + wrong for name, wrong in dict(known_m).items()}
    scores = Prediction(rows, measured + error_m, measured, interval, reference, known_predictions)
    fields = {"presentation": task.presentation, "status": "ok", "prediction": scores, "cost": COST}
    return FitResult(fit=task.fit, run_id="r", **(fields | changes))


def with_intervals(tasks):
    """Return results with 90 % intervals of 0.5 mm that miss the first n rows of split n."""
    tasks = [replace(task, fit=replace(task.fit, coverage=0.9)) for task in tasks]
    results = []
    for number, task in enumerate(tasks):
        lower = np.full((len(task.split.test), 3), -1e-4)
        lower[:number] += 1.0
        ends = np.stack([lower, lower + 5e-4])
        results.append(result(task, 1e-4, interval_m=ends, calibration_samples=11))
    return results


def value_of(table: Table, metric: str, axis: str, row: int = 0) -> Quantity | None:
    place = {"metric": metric, "axis": axis}
    (matching_cell,) = (
        cell
        for column, cell in zip(table.columns, table.rows[row], strict=True)
        if column.about == place
    )
    return matching_cell


def facts(table: Table, name: str) -> list[object]:
    """Return the values of a field of each row, as in CSV and JSON."""
    return [texts[name] for texts, _ in table.records()]


def test_a_row_is_the_mean_and_the_sample_deviation_over_the_splits_in_mm(tasks_of):
    errors = [1e-4, 2e-4, 6e-4]
    results = [result(task, e) for task, e in zip(tasks_of(splits=3), errors, strict=True)]
    (table,) = metric_tables(results, METRICS)
    value = value_of(table, "mae", "y")
    assert (value.value, value.n) == (pytest.approx(0.3), 3)
    assert value.spread == pytest.approx(statistics.stdev([0.1, 0.2, 0.6]))


def test_leave_one_out_scores_all_poses_together(tasks_of):
    tasks = tasks_of(dataset="fanuc-r2000ic", protocol="leave-one-out", splits=None)
    errors = np.linspace(1e-5, 5e-4, len(tasks))
    results = [result(task, e) for task, e in zip(tasks, errors, strict=True)]
    (table,) = metric_tables(results, METRICS)
    assert value_of(table, "mae", "z").value == pytest.approx(errors.mean() * 1000)
    of_all = errors.std() * 1000  # 0 split by split
    assert value_of(table, "stde", "z").value == pytest.approx(of_all)
    assert value_of(table, "me", "z").value == pytest.approx(0.5)
    (costs,) = metric_tables(results, [metric("fit-time")])
    assert value_of(costs, "fit-time", "").value == pytest.approx(1500.0)  # a mean over the splits
    (covered,) = metric_tables(with_intervals(tasks), WITH_INTERVALS)
    assert value_of(covered, "coverage", "x").value == pytest.approx(100 / 43)  # the first is right
    assert value_of(covered, "width", "z").value == pytest.approx(0.5)


def test_a_failed_or_skipped_model_is_a_row_with_its_reason_and_the_others_stay(tasks_of):
    tasks = tasks_of(splits=2)
    good_results = [result(task, 1e-4) for task in tasks_of(models=("zero",), splits=2)]
    broken = {"status": "failed", "prediction": None, "failure": "it broke"}
    absent = broken | {"status": "skipped", "failure": "no a|b\nhere"}
    failed = [result(tasks[0], 1e-4), result(tasks[1], 0, **broken)]
    skipped = [result(task, 0, **absent) for task in tasks]
    for bad, mark, reason in (
        (failed, "FAILED in 1 of 2 splits", "FAILED: vjm (1 fit): it broke"),
        (skipped, "SKIPPED", "SKIPPED: vjm (2 fits): no a|b here"),
    ):
        (table,) = metric_tables([*bad, *good_results], METRICS)
        assert str(table.rows[0][0]) == f"vjm [{mark}]" and reason in table.notes
        has_numbers = [any(isinstance(cell, Quantity) for cell in row) for row in table.rows]
        assert has_numbers[:2] == [False, True]


def test_rows_of_different_splits_are_never_in_one_table(tasks_of):
    vjm_tasks, zero_tasks = tasks_of(models=("vjm",)), tasks_of(models=("zero",))
    moved = [replace(t, fit=replace(t.fit, split_sha256="another")) for t in zero_tasks]
    tables = metric_tables([result(task, 1e-4) for task in [*vjm_tasks, *moved]], METRICS)
    models = [{"vjm", "zero"} & {*facts(table, "model")} for table in tables]
    assert {"zero"} in models and len(models) == 2


def test_the_published_rows_are_below_the_kr10_and_nowhere_else(tasks_of):
    (kr10,), (fanuc,) = tasks_of(splits=1), tasks_of(dataset="fanuc-r2000ic", splits=1)
    with_rows, *without = (
        metric_tables([result(task, 1e-4)], metrics)[0]
        for task, metrics in ((kr10, METRICS), (fanuc, METRICS), (kr10, [metric("norm")]))
    )
    assert facts(with_rows, "source") == ["ours", *["published"] * 3]
    assert "source paper, measured KR10, not comparable in absolute terms" in with_rows.notes[-1]
    for table in without:  # norm has no published value
        assert facts(table, "source") == ["ours"] and "published" not in " ".join(table.notes)


def test_the_numbers_of_fits_are_details_and_the_mean_of_a_rigid_joint_is_infinite(tasks_of):
    tasks = tasks_of(splits=2)
    results = [
        result(task, 1e-4, diagnostics={"stiffness [Nm/rad]": value})
        for task, value in zip(tasks, (2e4, float("inf")), strict=True)
    ]
    (table,) = metric_tables(results, METRICS)
    assert table.details == ["vjm (means over 2 splits): stiffness [Nm/rad] inf."]
    assert not any("stiffness" in note for note in table.notes)


def test_coverage_is_a_percentage_next_to_errors_in_mm(tasks_of):
    tables = metric_tables(with_intervals(tasks_of(splits=2)), WITH_INTERVALS)
    covered = value_of(tables[0], "coverage", "x")  # of 31 test rows per split
    expected = 100 * (1 - 0.5 / 31), 100 / 31 / math.sqrt(2)
    assert (covered.value, covered.spread) == pytest.approx(expected)
    (table_record,) = json.loads(render(tables, "json", "bench run"))["tables"]
    assert table_record["nominal_coverage"] == 0.9
    units = {value["metric"]: value["unit"] for value in table_record["rows"][0]["values"]}
    assert units == {"mae": "mm", "coverage": "%", "width": "mm"}


def test_each_condition_of_a_protocol_has_a_table_of_its_own_without_published_rows(tasks_of):
    tasks = tasks_of(protocol="space-transfer", splits=2)
    tables = metric_tables([result(task, 1e-4) for task in tasks], METRICS)
    assert [facts(table, "condition")[0] for table in tables] == [
        "joint-space -> cartesian",
        "cartesian -> joint-space",
    ]
    assert {facts(table, "splits")[0] for table in tables} == {2}
    assert "| space-transfer | joint-space -> cartesian, 2 splits" in tables[0].title
    assert all({*facts(table, "source")} == {"ours"} for table in tables)


def test_a_value_missing_in_one_split_is_a_dash_and_not_a_mean_of_the_others(tasks_of):
    metrics = [metric("mae"), metric("skill")]
    first, second = tasks_of(splits=2)
    results = [result(first, 1e-4), result(second, 1e-4, reference_m=1e-3)]
    (table,) = metric_tables(results, metrics)
    assert value_of(table, "skill", "") is None and value_of(table, "mae", "x") is not None
    assert "| - |" in " ".join(render([table], "github", "bench run").split())


def test_rows_of_reference_predictions_have_no_source_domain(tasks_of):
    (task,) = tasks_of(splits=1)
    presentation = replace(task.presentation, model="ft-mlp", source="vjm on Sobol poses")
    predictions = {"reference_m": 2e-4, "known_m": {"oracle": 0.0, "noise": 1e-5}}
    (table,) = metric_tables(
        [result(task, 1e-4, presentation=presentation, **predictions)], METRICS
    )
    names = [str(row[0]) for row in table.rows]
    assert all(name in " ".join(names) for name in ("vjm", "oracle", "instrument noise"))
    assert [note for note in table.notes if "source domain" in note] == [
        "ft-mlp: source domain: vjm on Sobol poses."
    ]
