"""Scores: a row per task and model next to the VJM's, and tasks that count."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.made_results import TWINS, VJM_MM
from stiff_bench.results.columns import matrix_table, model_table
from stiff_bench.results.scored_task import sort_key
from stiff_bench.results.scores import FEWEST_ROBOTS, model_frame
from stiff_bench.tables.table import Quantity
from stiff_protocols.contract.errors import ConfigError


def test_a_row_has_the_mean_error_and_its_ratio_to_the_vjms(made):
    made.add_robot(0, {"net": 0.5})
    rows = made.scores().frame.set_index("model")
    assert rows.loc["net", "error"] == pytest.approx(1e-3 * 0.5 * np.mean(VJM_MM))
    assert rows["error ratio"].to_dict() == pytest.approx({"net": 0.5, "vjm": 1.0})
    assert rows["p95 ratio"].to_dict() == pytest.approx({"net": 0.5, "vjm": 1.0})
    assert {*rows["robot"]} == {"robot-0"} and {*rows["kind"]} == {"simulated"}


def test_specimens_of_one_robot_are_one_robot_and_one_column(made):
    for twin in TWINS:
        made.add("vjm", VJM_MM, twin)
        made.add("net", [0.5 * error for error in VJM_MM], twin)
    scores = made.scores()
    assert scores.frame["robot"].nunique() == 1 and len(TWINS) >= FEWEST_ROBOTS
    assert scores.claim is None
    assert "low" not in model_frame(scores)
    assert [len(tasks) for tasks in scores.columns.values()] == [len(TWINS)]


def test_the_vjm_that_each_fit_stores_is_the_reference_if_it_was_not_run(made):
    made.add("net", [0.5, 0.5, 0.5])
    rows = made.scores().frame.set_index("model")
    assert {*rows.index} == {"net", "vjm"}
    assert rows.loc["vjm", "error"] == pytest.approx(np.sqrt(3.0) * 1e-3)  # 1 mm along each axis


@pytest.mark.parametrize("unfair", [{"selects_on_test": True}, {"reports_training": True}])
def test_unfair_protocols_count_only_without_others(made, unfair):
    made.add_robot(0, {"net": 0.1}, protocol="paper", warning="optimistic", **unfair)
    assert [task.name.protocol for task in made.scores().tasks] == ["paper"]
    made.add_robot(0, {"net": 0.5})
    assert [task.name.protocol for task in made.scores().tasks] == ["holdout"]


def test_measured_data_come_first_and_others_in_the_order_of_requests(made):
    keys = []
    for dataset, kind in (("b", "simulated"), ("a", "simulated"), ("c", "measured")):
        keys += made.add("net", [1.0], dataset, kind=kind)
    made.add_run("run-1", keys)
    assert [task.name.dataset for task in made.scores().tasks] == ["c", "b", "a"]


def test_only_the_chosen_models_and_the_vjm_are_scored(made):
    made.add_robot(0, {"net": 0.5, "other": 0.1})
    assert {*made.scores(models=["net"]).models} == {"net", "vjm"}
    with pytest.raises(ConfigError, match="no model has a score of fit time"):
        made.scores("fit-time")


def test_a_metric_whose_larger_values_are_better_has_no_ratio_and_its_best_is_largest(made):
    made.add_robot(0, {"net": 0.5})
    scores = made.scores("r2")
    assert scores.frame["error ratio"].isna().all()
    assert [*model_frame(scores)["model"]] == ["net", "vjm"]


def test_verdicts_are_counted_by_task(made):
    for number, ratio in enumerate((0.5, 1.5, 1.0)):
        made.add_robot(number, {"net": ratio})
    scores = made.scores()
    assert scores.verdict_counts("net") == {"a": 1, "b": 1, "equivalent": 1}
    (net, _) = model_table(scores, model_frame(scores), "models").texts()
    assert net[3:6] == ["1", "1", "1"]


def test_the_matrix_has_a_row_per_model_and_marks_the_best_of_each_column(made):
    made.add_robot(0, {"net": 0.5})
    made.add_robot(1, {"net": 1.5, "some": 1.1})
    table = matrix_table(made.scores(), ["net", "vjm", "some"])
    marked = {
        str(row[0]): [isinstance(cell, Quantity) and cell.mark == "*" for cell in row[1:]]
        for row in table.rows
    }
    assert marked == {"net": [True, False], "vjm": [False, True], "some": [False, False]}
    assert table.rows[0][1].value == pytest.approx(0.5 * np.mean(VJM_MM))  # mm
    assert table.rows[2][1] is None


@pytest.mark.parametrize(
    ("metric", "axis", "message"),
    [
        ("coverage", None, r"coverage does not rank models \(valid: "),
        ("norm", "x", r"metric with axes \(mae"),
        ("maw", None, "did you mean 'mae'"),
    ],
)
def test_what_cannot_sort_is_refused(metric, axis, message):
    with pytest.raises(ConfigError, match=message):
        sort_key(metric, axis)
