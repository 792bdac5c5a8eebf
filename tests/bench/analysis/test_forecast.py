"""What `bench run --plan` says before anything is computed."""

from __future__ import annotations

import pytest

from helpers.command_line import bench_here
from helpers.run_requests import planned
from stiff_bench.analysis.forecast import (
    LONGEST_FIT_S,
    Forecast,
    forecast,
    forecast_line,
    forecast_table,
    time_fits,
    untimed_fits,
)
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.run.cell import Execution
from stiff_bench.run.isolate import TIMED_OUT
from stiff_bench.store.database import ResultStore
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


def told(plan, *, rerun="missing", timed=()):
    return forecast(cell_tasks(plan), plan.output, rerun=rerun, timed=timed)


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


def test_one_fit_is_timed_of_each_model_and_data_set_whose_model_has_no_stored_fit(tmp_path):
    store_some(plan_into(tmp_path, models=("zero",), splits=1, seed=1), 60.0)
    plan = plan_into(tmp_path, models=("zero", "vjm", "knn"), datasets=("kr10-twin", "ur5-twin"))
    chosen = untimed_fits(cell_tasks(plan), plan.output, rerun="missing")
    places = [(task.shown.model, task.shown.dataset) for task in chosen]
    assert places == [(m, d) for d in ("kr10-twin", "ur5-twin") for m in ("vjm", "knn")]
    sizes = plan_into(tmp_path, models=("knn",), protocols=("sample-efficiency@sizes=20,5",))
    (smallest,) = untimed_fits(cell_tasks(sizes), plan.output, rerun="missing")
    assert smallest.cell.condition == "n = 5"


ENDS = {"vjm": {"cost": Cost(2.0, 1.0, 0.0, 1.0, None)}, "knn": {"cause": TIMED_OUT}}


class Timed(Execution):
    """Gives each model's result as if its fit had ended so."""

    def results(self, tasks, run_id, display):
        for task in tasks:
            fields = ENDS.get(task.shown.model, {"failure": "it broke"})
            status = "ok" if "cost" in fields else "failed"
            yield CellResult(task.cell, task.shown, run_id, status, **fields)


def test_a_timed_fit_is_the_time_of_the_others_or_a_bound_and_a_failure_is_said(tmp_path):
    datasets = ("kr10-twin", "fanuc-r2000ic")
    plan = plan_into(tmp_path / "new", models=("vjm", "knn", "zero"), datasets=datasets)
    chosen = untimed_fits(cell_tasks(plan), plan.output, rerun="missing")
    found = told(plan, timed=time_fits(chosen[:-1], Timed()))
    vjm, knn, zero, total = found
    assert (vjm.seconds, vjm.n_timed, vjm.is_lower_bound) == (18.0, 6, False)
    assert knn.is_lower_bound and knn.seconds == 6 * LONGEST_FIT_S
    assert zero.n_unknown == 6 and "it broke" in zero.failure
    assert total.n_unknown == 6 and total.is_lower_bound
    rows = {row[0]: row[-1] for row in forecast_table(found, 1).texts()}
    assert rows["vjm"] == "0:00:18" and rows["knn"].startswith("more than ")
    notes = forecast_table(found, 1).notes
    assert any("timed now" in note for note in notes) and any("it broke" in note for note in notes)
    assert not (tmp_path / "new").exists()


def test_no_fit_is_started_when_the_time_of_a_plan_is_over(tmp_path, monkeypatch):
    monkeypatch.setattr("stiff_bench.analysis.forecast.LONGEST_S", 0.0)
    plan = plan_into(tmp_path)
    assert time_fits(list(cell_tasks(plan)), Timed()) == []


@pytest.mark.slow
def test_a_fit_that_takes_longer_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr("stiff_bench.api.evaluation.LONGEST_FIT_S", 0.5)
    words = ("run", "--model", "ft-mlp", "--model", "zero", "--splits", "1", "--plan")
    done = bench_here(*words, "--output", "new", cwd=tmp_path)
    assert "more than" in done.stdout and not (tmp_path / "new").exists()


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
