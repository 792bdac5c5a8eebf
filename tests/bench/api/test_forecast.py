"""`bench run --plan`: the counts and times that it prints before anything is computed."""

from __future__ import annotations

import pytest

from stiff_bench.api.evaluation import forecast
from stiff_bench.run.execution import Execution
from stiff_bench.store.database import ResultStore
from stiff_protocols.contract.record import Cost, FitResult


@pytest.fixture()
def fits(tasks_of):
    """A function that lists three splits of some models."""
    return lambda *models: tasks_of(models, "kr10-twin", splits=3)


def store(folder, tasks, fit_s=1.0, status="ok"):
    """Store results of fits with this fit time."""
    cost = Cost(fit_s, 0.5, 0.0, 1.0, None) if status == "ok" else None
    ResultStore(folder).write_fits(
        FitResult(task.fit, task.presentation, "r", status, cost=cost) for task in tasks
    )


def test_without_stored_results_cells_are_counted_and_nothing_is_written(fits, tmp_path):
    table, line = forecast(fits("zero", "vjm"), tmp_path / "new", Execution())
    parts = [["zero", "3", "0", "3", "unknown"], ["vjm", "3", "0", "3", "unknown"]]
    assert table.texts() == [*parts, ["all", "6", "0", "6", "unknown"]]
    assert "6 to compute; time unknown: 6 fits" in line
    assert not (tmp_path / "new").exists()


def test_stored_cells_are_cached_and_their_mean_is_the_time_of_the_others(fits, tmp_path):
    zero, vjm = fits("zero"), fits("vjm")
    for tasks, fit_s in ((vjm[:1], 6.0), (vjm[1:2], 8.0), (zero, 100.0)):
        store(tmp_path, tasks, fit_s)
    table, line = forecast([*zero, *vjm], tmp_path, Execution(at_once=2))
    assert table.texts()[:2] == [
        ["zero", "3", "3", "0", "0:00:00"],
        ["vjm", "3", "2", "1", "0:00:08"],
    ]
    assert line.endswith("1 to compute; about 0:00:04 with 2 jobs")


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
def test_the_forecast_counts_as_cached_what_the_run_reuses(fits, tmp_path, rerun, status, n_cached):
    store(tmp_path, fits("vjm"), status=status)
    table, _ = forecast(fits("vjm"), tmp_path, Execution(rerun=rerun))
    assert table.texts()[-1][2] == str(n_cached)
