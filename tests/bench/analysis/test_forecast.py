"""`bench run --plan`: the forecast that it prints before anything is computed."""

from __future__ import annotations

import pytest

from helpers.command_line import bench_here
from stiff_bench.analysis.forecast import (
    LONGEST_FIT_S,
    Forecast,
    forecast,
    forecast_line,
    forecast_table,
    time_fits,
    untimed_fits,
)
from stiff_bench.run.cell import Execution
from stiff_bench.run.isolate import TIMED_OUT
from stiff_bench.store.database import ResultStore
from stiff_protocols.contract.record import CellResult, Cost

DATASETS = ("kr10-twin", "fanuc-r2000ic")


@pytest.fixture()
def cells(tasks_of):
    """A function that lists three splits of some models on some data sets."""

    def make(*models, datasets=DATASETS[:1]):
        return [task for dataset in datasets for task in tasks_of(models, dataset, splits=3)]

    return make


def store(folder, tasks, fit_s=1.0, status="ok"):
    """Store results of cells with this fit time."""
    cost = Cost(fit_s, 0.5, 0.0, 1.0, None) if status == "ok" else None
    ResultStore(folder).write_cells(
        CellResult(task.cell, task.presentation, "r", status, cost=cost) for task in tasks
    )


def test_without_stored_results_cells_are_counted_and_nothing_is_written(cells, tmp_path):
    folder, tasks = tmp_path / "new", cells("zero", "vjm", datasets=DATASETS)
    *parts, total = forecast(tasks, folder, rerun="missing")
    assert parts == [Forecast(model, 6, 0, 6, 0.0) for model in ("zero", "vjm")]
    assert total == Forecast("all", 12, 0, 12, 0.0)
    assert "12 to compute; time unknown: 12 fits" in forecast_line(total, 1)
    assert not folder.exists()


def test_stored_cells_are_cached_and_their_mean_is_the_time_of_the_others(cells, tmp_path):
    zero, vjm = cells("zero"), cells("vjm")
    for tasks, fit_s in ((vjm[:1], 6.0), (vjm[1:2], 8.0), (zero, 100.0)):
        store(tmp_path, tasks, fit_s)
    *parts, total = forecast([*zero, *vjm], tmp_path, rerun="missing")
    assert parts == [Forecast("zero", 3, 3, 0, 0.0), Forecast("vjm", 3, 2, 0, 7.5)]
    assert forecast_line(total, 1).endswith("1 to compute; about 0:00:08 with 1 job")
    assert forecast_line(total, 2).endswith("about 0:00:04 with 2 jobs")


def test_one_fit_is_timed_of_each_model_and_data_set_whose_model_has_no_stored_fit(
    cells, tasks_of, tmp_path
):
    tasks = cells("zero", "vjm", "knn", datasets=DATASETS)
    store(tmp_path, tasks[:1])
    chosen = untimed_fits(tasks[1:], tmp_path, rerun="missing")
    places = [(task.presentation.model, task.presentation.dataset) for task in chosen]
    assert places == [(model, dataset) for dataset in DATASETS for model in ("vjm", "knn")]
    sizes = tasks_of(("knn",), protocol="sample-efficiency@sizes=20,5", splits=1)
    (smallest,) = untimed_fits(sizes, tmp_path, rerun="missing")
    assert smallest.cell.condition == "n = 5"


ENDS = {"vjm": {"cost": Cost(2.0, 1.0, 0.0, 1.0, None)}, "knn": {"cause": TIMED_OUT}}


class Timed(Execution):
    """Returns a fixed result for each model."""

    def results(self, tasks, run_id, display):
        for task in tasks:
            fields = ENDS.get(task.presentation.model, {"failure": "it broke"})
            status = "ok" if "cost" in fields else "failed"
            yield CellResult(task.cell, task.presentation, run_id, status, **fields)


def test_a_timed_fit_is_the_time_of_the_others_or_a_bound_and_a_failure_is_reported(
    cells, tmp_path
):
    tasks = cells("vjm", "knn", "zero", datasets=DATASETS)
    chosen = untimed_fits(tasks, tmp_path / "new", rerun="missing")
    timed = time_fits(chosen[:-1], Timed())
    forecasts = forecast(tasks, tmp_path / "new", rerun="missing", timed=timed)
    vjm, knn, zero, total = forecasts
    assert (vjm.seconds, vjm.n_timed, vjm.is_lower_bound) == (18.0, 6, False)
    assert knn.is_lower_bound and knn.seconds == 6 * LONGEST_FIT_S
    assert zero.n_unknown == 6 and "it broke" in zero.failure
    assert total.n_unknown == 6 and total.is_lower_bound
    rows = {row[0]: row[-1] for row in forecast_table(forecasts, 1).texts()}
    assert rows["vjm"] == "0:00:18" and rows["knn"].startswith("more than ")
    notes = forecast_table(forecasts, 1).notes
    assert any("timed now" in note for note in notes) and any("it broke" in note for note in notes)
    assert not (tmp_path / "new").exists()


def test_no_fit_is_started_when_the_time_of_a_plan_is_over(cells, monkeypatch):
    monkeypatch.setattr("stiff_bench.analysis.forecast.LONGEST_S", 0.0)
    assert time_fits(cells("zero", "vjm"), Timed()) == []


@pytest.mark.slow
def test_a_fit_that_takes_longer_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr("stiff_bench.analysis.forecast.LONGEST_FIT_S", 0.05)
    words = ("run", "--model", "mlp", "--dataset", "fanuc-r2000ic", "--splits", "1", "--plan")
    done = bench_here(*words, "--output", "new", cwd=tmp_path)
    assert "more than" in done.stdout and not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("rerun", "status", "n_cached"),
    [
        ("missing", "failed", 3),
        ("missing", "skipped", 0),
        ("failed", "ok", 3),
        ("failed", "failed", 0),
        ("all", "ok", 0),
    ],
)
def test_the_forecast_counts_as_cached_what_the_run_reuses(
    cells, tmp_path, rerun, status, n_cached
):
    store(tmp_path, cells("vjm"), status=status)
    assert forecast(cells("vjm"), tmp_path, rerun=rerun)[-1].n_cached == n_cached
