"""What `bench run --plan` says before anything is computed."""

from __future__ import annotations

import weakref

import pytest

from helpers.run_requests import planned
from stiff_bench.analysis.forecast import Forecast, forecast, forecast_line, forecast_table
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.store.database import ResultStore
from stiff_bench.tables.render import render
from stiff_protocols.contract.record import CellResult, Cost


def plan_into(output, **changes):
    words = {"models": ("zero", "vjm"), "splits": 3} | changes
    return planned(output=output, **words)


def store_some(plan, fit_s, *, of=lambda task: True, status="ok"):
    """Store results of cells of a plan as if their fits had taken so long."""
    tasks = filter(of, cell_tasks(plan))
    cost = Cost(fit_s, 0.5, 0.0, 1.0, None) if status == "ok" else None
    ResultStore(plan.output).write_cells(
        CellResult(task.cell, task.shown, "r", status, cost=cost) for task in tasks
    )


def told(plan, *, rerun="missing"):
    return forecast(cell_tasks(plan), plan.output, rerun=rerun)


def test_without_stored_results_cells_are_counted_and_nothing_is_written(tmp_path):
    *parts, total = told(plan_into(tmp_path / "new", datasets=("kr10-twin", "fanuc-r2000ic")))
    assert parts == [Forecast(model, 6, 0, 6, 0.0) for model in ("zero", "vjm")]
    assert total == Forecast("all", 12, 0, 12, 0.0)
    assert "12 to compute; time unknown: 12 fits" in forecast_line(total, 1)
    assert not (tmp_path / "new").exists()


def test_stored_cells_are_cached_and_their_mean_is_the_time_of_the_others(tmp_path):
    plan = plan_into(tmp_path)
    for index, fit_s in enumerate((6.0, 8.0)):
        of = {"of": lambda t, i=index: t.shown.model == "vjm" and t.cell.split_index == i}
        store_some(plan, fit_s, **of)
    store_some(plan, 100.0, of=lambda t: t.shown.model == "zero")
    *parts, total = told(plan)
    assert parts == [Forecast("zero", 3, 3, 0, 0.0), Forecast("vjm", 3, 2, 0, 7.5)]
    assert forecast_line(total, 1).endswith("1 to compute; about 0:00:08 with 1 job")
    assert forecast_line(total, 2).endswith("about 0:00:04 with 2 jobs")


def test_models_without_a_stored_fit_are_said_beside_the_time_of_the_others(tmp_path):
    store_some(plan_into(tmp_path, models=("zero",), splits=1, seed=1), 60.0)
    found = told(plan_into(tmp_path))
    assert found[-1].n_unknown == 3
    assert "about 0:03:02 with 1 job, and 3 fits" in forecast_line(found[-1], 1)
    table = render([forecast_table(found, 1)], "github", "bench run --plan")
    rows = {
        cells[1].strip(): cells[-2].strip()
        for cells in (r.split("|") for r in table.split("\n"))
        if len(cells) > 3
    }
    assert (rows["zero"], rows["vjm"], rows["all"]) == ("0:03:02", "unknown", "unknown")


@pytest.mark.parametrize(
    ("rerun", "status", "n_cached"),
    [
        ("missing", "ok", 3),
        ("missing", "failed", 3),
        ("missing", "skipped", 0),
        ("failed", "ok", 3),
        ("failed", "failed", 0),
        ("all", "ok", 0),
    ],
)
def test_what_counts_as_cached_is_what_the_run_takes(tmp_path, rerun, status, n_cached):
    plan = plan_into(tmp_path, models=("vjm",))
    store_some(plan, 1.0, status=status)
    assert told(plan, rerun=rerun)[-1].n_cached == n_cached


@pytest.mark.parametrize(
    "protocol",
    ["holdout", "sensor-noise", "cross-robot", "sample-efficiency", "load-extrapolation"],
)
def test_splits_are_made_one_by_one(protocol):
    made = [
        weakref.ref(task.split)
        for task in cell_tasks(planned(models=("zero",), protocols=(protocol,), splits=8))
    ]
    assert len(made) >= 8
    assert sum(split() is not None for split in made) == 0


def test_the_number_of_splits_of_each_condition_is_known_from_the_first_cell():
    tasks = cell_tasks(planned(protocols=("sample-efficiency@sizes=5,10",), splits=4))
    assert next(tasks).n_splits == 4
