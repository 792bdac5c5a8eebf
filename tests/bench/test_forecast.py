"""What `bench run --plan` says before anything is computed."""

from __future__ import annotations

import csv
import json
import tracemalloc
import weakref
from dataclasses import replace

import pytest

from run_requests import planned
from stiff_bench.execution import IN_THIS_PROCESS, Execution
from stiff_bench.forecast import OVERHEAD_S, forecast
from stiff_bench.forecast_text import forecast_line, forecast_table, render_forecast
from stiff_bench.isolate import Limits, LocalProcesses
from stiff_bench.packing import pack
from stiff_bench.store import ResultStore
from stiff_bench.tasks import cell_tasks
from stiff_protocols.cost import Cost
from stiff_protocols.record import CellResult

MIB = 2**20


def plan_into(output, **changes):
    words = {"models": ("zero", "vjm"), "splits": 3} | changes
    return planned(output=output, **words)


def store_some(plan, fit_s, *, of=lambda task: True, status="ok", memory_bytes=None, **changes):
    """Store results of cells of a plan as if their fits had taken so long."""
    store = ResultStore(plan.output)
    for task in filter(of, cell_tasks(plan)):
        cost = Cost(fit_s, 0.0, 0.0, 1.0, memory_bytes) if status == "ok" else None
        store.write_cell(CellResult(task.cell, task.shown, "r", status, cost=cost, **changes))


def told(plan, *, jobs=1, rerun="missing"):
    def fails(error):
        raise error

    execution = Execution(LocalProcesses(jobs, Limits()), rerun)
    return forecast(cell_tasks(plan), plan.output, execution, fails)


def parts_of(found):
    return {(part.model, part.dataset): part for part in found.parts}


def test_without_stored_results_cells_are_counted_and_nothing_is_written(tmp_path):
    plan = plan_into(tmp_path / "new", datasets=("kr10-twin", "fanuc-r2000ic"))
    found = told(plan)
    assert [(part.model, part.dataset, part.protocol, part.n_cells) for part in found.parts] == [
        (model, dataset, "holdout", 3)
        for dataset in ("kr10-twin", "fanuc-r2000ic")
        for model in ("zero", "vjm")
    ]
    assert (found.n_cells, found.n_cached, found.n_unknown) == (12, 0, 12)
    assert found.memory_bytes is None
    assert "12 to compute; time not known" in forecast_line(found)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("packed", [False, True])
def test_stored_cells_are_cached_and_give_the_time_of_the_others(tmp_path, packed):
    plan = plan_into(tmp_path)
    store_some(plan, 7.0, of=lambda t: t.shown.model == "vjm" and t.cell.split_index < 2)
    store_some(plan, 100.0, of=lambda t: t.shown.model == "zero")
    if packed:
        pack(tmp_path)
    found = told(plan)
    assert {name: part.n_cached for (name, _), part in parts_of(found).items()} == {
        "zero": 3,
        "vjm": 2,
    }
    assert found.seconds == pytest.approx(7.0 + OVERHEAD_S)
    assert told(plan, jobs=2).seconds == pytest.approx((7.0 + OVERHEAD_S) / 2)


def test_the_same_data_set_counts_more_than_others_and_these_more_than_nothing(tmp_path):
    both = ("kr10-twin", "fanuc-r2000ic")
    store_some(plan_into(tmp_path, models=("zero", "vjm"), datasets=both[:1]), 3.0)
    store_some(plan_into(tmp_path, models=("zero",), datasets=both[1:]), 50.0)
    parts = parts_of(
        told(plan_into(tmp_path, datasets=both, models=("zero", "vjm", "knn"), seed=1))
    )
    expected = {
        ("zero", both[0]): 3.0,
        ("zero", both[1]): 50.0,
        ("vjm", both[0]): 3.0,
        ("vjm", both[1]): 3.0,
    }
    for names, seconds in expected.items():
        assert parts[names].cell_s == pytest.approx(seconds + OVERHEAD_S)
    assert parts["knn", both[0]].cell_s is None


def test_where_some_times_are_unknown_the_sum_is_a_lower_bound(tmp_path):
    store_some(plan_into(tmp_path, models=("zero",), splits=1, seed=1), 60.0)
    found = told(plan_into(tmp_path))
    assert found.n_unknown == 3
    assert "at least 0:03:00, without 3 cells of which no time is known" in forecast_line(found)
    rows = {row[0]: row[1:] for row in forecast_table(found).rows}
    assert rows == {
        "model zero": ["3", "0", "3", "0:03:00"],
        "model vjm": ["3", "0", "3", "not known"],
        "data set kr10-twin": ["6", "0", "6", "over 0:03:00"],
        "protocol holdout": ["6", "0", "6", "over 0:03:00"],
        "all": ["6", "0", "6", "over 0:03:00"],
    }


def test_intervals_of_a_second_fit_count_twice(tmp_path):
    store_some(plan_into(tmp_path, models=("vjm",)), 4.0, calibration_samples=9)
    found = told(plan_into(tmp_path, models=("vjm",), seed=1))
    assert found.parts[0].cell_s == pytest.approx(8.0 + OVERHEAD_S)


def test_the_largest_rise_of_the_plans_models_is_added_to_this_process(tmp_path):
    store_some(plan_into(tmp_path, models=("vjm",)), 1.0, memory_bytes=700 * MIB)
    store_some(plan_into(tmp_path, models=("knn",)), 1.0, memory_bytes=9000 * MIB)
    found = told(plan_into(tmp_path, models=("vjm",), seed=1))
    assert 700 * MIB < found.memory_bytes < 9000 * MIB
    assert f"about {found.memory_bytes / MIB:.0f} MiB in each process" in forecast_line(found)


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
    assert told(plan, rerun=rerun).n_cached == n_cached


def test_a_damaged_pack_is_told_and_its_cells_are_to_be_computed(tmp_path):
    plan = plan_into(tmp_path)
    store_some(plan, 1.0)
    pack(tmp_path)
    (path,) = (tmp_path / "packs").iterdir()
    path.write_bytes(path.read_bytes()[:-1])
    said = []
    assert forecast(cell_tasks(plan), plan.output, IN_THIS_PROCESS, said.append).n_cached == 0
    assert [path.name in str(error) for error in said] == [True]


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


def test_a_plan_of_ten_times_the_cells_takes_no_more_memory(tmp_path):
    peaks = []
    told(plan_into(tmp_path, models=("zero",), splits=1))  # what is imported and cached once
    for splits in (3, 30):
        tracemalloc.start()
        told(plan_into(tmp_path, models=("zero",), splits=splits))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 50_000


def test_a_cells_key_is_the_same_whatever_the_number_of_cells(tmp_path):
    keys = [
        {task.cell.key for task in cell_tasks(plan_into(tmp_path, splits=splits))}
        for splits in (3, 5)
    ]
    assert len(keys[0]) == 6 and keys[0] < keys[1]


def test_names_stand_in_the_plans_order(tmp_path):
    found = told(
        plan_into(tmp_path, models=("vjm", "zero"), protocols=("kfold", "holdout"), splits=5)
    )
    headings = [row[0] for row in forecast_table(replace(found, jobs=3)).rows]
    assert headings == [
        "model vjm",
        "model zero",
        "data set kr10-twin",
        "protocol kfold",
        "protocol holdout",
        "all",
    ]


def test_every_format_has_the_cells(tmp_path):
    plan = plan_into(tmp_path)
    store_some(plan, 60.0, of=lambda t: t.shown.model == "vjm" and t.cell.split_index == 0)
    found = told(plan)
    assert "model vjm" in render_forecast(found, "github", "bench run")
    plain = json.loads(render_forecast(found, "json", "bench run --plan"))
    assert plain["command"] == "bench run --plan"
    assert (plain["cells"], plain["cached"], plain["unknown"]) == (6, 1, 3)
    assert plain["seconds"] == pytest.approx(2 * (60.0 + OVERHEAD_S))
    zero, vjm = csv.DictReader(render_forecast(found, "csv", "bench run").splitlines())
    assert (zero["model"], zero["n_cells"], zero["cell_s"]) == ("zero", "3", "")
    assert (vjm["model"], vjm["n_cached"], float(vjm["cell_s"])) == (
        "vjm",
        "1",
        pytest.approx(60.0 + OVERHEAD_S),
    )
