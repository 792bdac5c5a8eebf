"""The answer: error over the VJM's, one unit per robot, no claim from few robots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from helpers.made_results import TWINS, MadeResults, made_data
from stiff_bench.analysis.answer import FEWEST_ROBOTS, Answer, ModelAnswer
from stiff_bench.analysis.answer_text import headline, matrix_table, model_table, sentences
from stiff_bench.analysis.board import Board
from stiff_bench.analysis.task_text import verdict_sentence
from stiff_bench.results.load import StoredResults
from stiff_bench.results.leaderboard import build_leaderboard
from stiff_bench.results.scored_task import sort_key
from stiff_bench.tables.table import Quantity

RATIOS = (0.5, 0.6, 0.4, 0.55, 0.7)
VJM_MM = (0.2, 0.21, 0.19)


@pytest.fixture()
def made(tmp_path: Path) -> MadeResults:
    return MadeResults(tmp_path)


def add_robot(made: MadeResults, number: int, ratio: float, **presentation) -> None:
    """Write the VJM's and a network's results on a robot of its own."""
    data = made_data(number)
    data = replace(data, robot=replace(data.robot, name=f"robot-{number}"))
    where = {"dataset": f"arm-{number}", "data": data, **presentation}
    made.add("vjm", VJM_MM, **where)
    made.add("net", [ratio * error for error in VJM_MM], **where)


def answer_of(made: MadeResults, **narrowed) -> Answer:
    return Answer.of(StoredResults.read(made.folder), sort_key("norm", None), **narrowed)


def model_of(answer: Answer, name: str) -> ModelAnswer:
    return next(model for model in answer.models if model.name == name)


def test_the_ratio_is_a_geometric_mean_over_robots_with_students_interval(made):
    for number, ratio in enumerate(RATIOS):
        add_robot(made, number, ratio)
    net = model_of(answer_of(made), "net")
    logs = np.log(RATIOS)
    bounds = stats.t.interval(0.95, len(logs) - 1, logs.mean(), stats.sem(logs))
    assert net.ratio == pytest.approx(stats.gmean(RATIOS))
    assert (net.low, net.high) == pytest.approx(tuple(np.exp(bounds)))
    assert (net.smallest, net.largest) == pytest.approx((0.4, 0.7))


def test_specimens_of_one_robot_are_one_robot(made):
    for twin in TWINS:
        made.add("vjm", VJM_MM, twin)
        made.add("net", [0.5 * error for error in VJM_MM], twin)
    answer = answer_of(made)
    assert len(answer.robots) == 1 and len(TWINS) >= FEWEST_ROBOTS
    assert model_of(answer, "net").low is None and not answer.claim_robots
    assert len(answer.columns) == 1 and len(answer.columns[0].tasks) == len(TWINS)


def test_a_robot_with_many_comparisons_counts_once(made):
    add_robot(made, 0, 0.5)
    for number in range(1, 4):
        add_robot(made, 0, 0.8, protocol=f"plan-{number}", condition="n = 5")
    add_robot(made, 1, 0.9)
    of_robot = np.exp(np.mean(np.log([0.5, 0.8, 0.8, 0.8])))
    assert model_of(answer_of(made), "net").ratio == pytest.approx(np.sqrt(of_robot * 0.9))


def test_measured_and_simulated_robots_are_never_averaged(made):
    for number, ratio in enumerate(RATIOS):
        add_robot(made, number, ratio)
    add_robot(made, 9, 3.0, kind="measured")
    answer = answer_of(made)
    assert model_of(answer, "net").ratio == pytest.approx(stats.gmean(RATIOS))
    assert answer.columns[0].dataset == "arm-9"  # measured data come first
    assert "5 simulated robots" in headline(answer)


def test_an_interval_that_reaches_the_vjm_is_no_claim(made):
    for number, ratio in enumerate((0.3, 0.5, 0.9, 1.4, 1.6)):
        add_robot(made, number, ratio)
    net = model_of(answer_of(made), "net")
    assert net.high is not None and net.ratio is not None and net.ratio < 1.0 < net.high
    assert headline(answer_of(made)).startswith("No model is reliably better")


def test_the_claim_over_robots_needs_the_sign_flips_of_six_robots_as_on_the_board(made):
    for number, ratio in enumerate(RATIOS):
        add_robot(made, number, ratio)
    five = answer_of(made)
    assert model_of(five, "net").p_value == pytest.approx(2 / 2**5)
    assert headline(five).startswith("No model is reliably better")
    add_robot(made, 5, 0.5)
    six = answer_of(made)
    (row,) = [row for row in Board(six).rows if row.name == "net"]
    assert model_of(six, "net").p_value == row.p_reference == pytest.approx(2 / 2**6)
    assert headline(six).startswith("Use net:") and row.verdict == "better"


def test_a_model_with_less_error_than_the_significant_one_is_named(made):
    made.add("vjm", VJM_MM)
    made.add("steady", [0.8 * error for error in VJM_MM])
    made.add("unsteady", [0.02, 0.17, 0.18])
    answer = answer_of(made)
    (task,) = answer.tasks
    verdicts = {name: answer.verdict(name, task) for name in ("steady", "unsteady")}
    assert verdicts == {"steady": "a", "unsteady": "open"}
    assert task.mean("unsteady") < task.mean("steady")
    text = verdict_sentence(answer, task)
    assert text.startswith("steady is better") and "unsteady has less error" in text


def test_with_few_robots_the_headline_names_data_sets(made):
    add_robot(made, 0, 0.5)
    add_robot(made, 1, 1.5)
    answer = answer_of(made)
    assert not answer.claim_robots
    assert "arm-0" in headline(answer) and "none on arm-1" in headline(answer)
    assert "2 robots" in sentences(answer)[-1].text


def test_the_vjm_of_each_cell_is_the_reference_if_it_was_not_run(made):
    made.add("net", [0.5, 0.5, 0.5])
    answer = answer_of(made)
    assert {model.name for model in answer.models} == {"net", "vjm"}
    (task,) = answer.tasks
    assert answer.error("vjm", task) == pytest.approx(np.sqrt(3.0) * 1e-3)  # 1 mm along each axis


def test_protocols_that_select_on_the_test_part_do_not_count_with_others(made):
    add_robot(made, 0, 0.5)
    add_robot(made, 0, 0.1, protocol="paper", selects_on_test=True, warning="selects")
    answer = answer_of(made)
    assert [task.name.protocol for task in answer.tasks] == ["holdout"]
    assert len(answer.left_out) == 1


def test_only_the_requested_models_and_the_vjm_are_shown(made):
    add_robot(made, 0, 0.5)
    data = made_data(0)
    data = replace(data, robot=replace(data.robot, name="robot-0"))
    made.add("other", [0.1] * 3, "arm-0", data=data)
    assert {model.name for model in answer_of(made, models=["net"]).models} == {"net", "vjm"}


def test_the_matrix_has_a_row_per_model_and_marks_the_best_of_each_column(made):
    add_robot(made, 0, 0.5)
    add_robot(made, 1, 1.5)
    table = matrix_table(answer_of(made))
    marked = {
        row[0].text: [isinstance(cell, Quantity) and cell.mark == "*" for cell in row[1:]]
        for row in table.rows
    }
    assert marked == {"net": [True, False], "vjm": [False, True]}
    assert table.rows[0][1].value == pytest.approx(0.5 * np.mean(VJM_MM))  # mm
    assert len(model_table(answer_of(made)).rows) == 2


def test_a_metric_whose_larger_values_are_better_has_no_ratio(made):
    add_robot(made, 0, 0.5)
    answer = Answer.of(StoredResults.read(made.folder), sort_key("r2", None))
    assert model_of(answer, "net").ratio is None and "net" in headline(answer)


@pytest.mark.parametrize(
    ("ratios", "text"),
    [
        ((0.5, 0.8), "20 to 50 % less"),
        ((1.2, 1.6), "20 to 60 % more"),
        ((0.5, 1.2), "50 % less to 20 % more"),
    ],
)
def test_the_gain_is_a_range_over_comparisons_from_the_smaller_to_the_larger_change(
    made, ratios, text
):
    for number, ratio in enumerate(ratios):
        add_robot(made, number, ratio)
    texts = dict(sentences(answer_of(made)))
    label = "Gain" if max(ratios) < 1.0 else "Change"
    assert texts[label].startswith(f"{text} error than the VJM")


def test_another_model_that_is_better_somewhere_is_named(made):
    for number, ratio, factor in ((0, 0.5, 5.0), (1, 0.6, 0.1)):
        add_robot(made, number, ratio)
        data = made_data(number)
        data = replace(data, robot=replace(data.robot, name=f"robot-{number}"))
        made.add("other", [factor * error for error in VJM_MM], f"arm-{number}", data=data)
    texts = dict(sentences(answer_of(made)))
    assert texts["How sure"].startswith("net ")
    assert "arm-1 other is better" in texts["But"] and "arm-0" not in texts["But"]


@pytest.mark.parametrize("models", [None, ["net"]])
def test_comparisons_that_a_leaderboard_scored_give_the_same_answer(made, models):
    for number, ratio in enumerate(RATIOS):
        add_robot(made, number, ratio)
    stored, key = StoredResults.read(made.folder), sort_key("norm", None)
    board = build_leaderboard(stored, key)
    scored = [task for section in board.sections for task in section.tasks]
    again = Answer.of(stored, key, models=models, scored=scored)
    assert again.models == Answer.of(stored, key, models=models).models
    assert {id(task) for task in again.tasks} == {id(task) for task in scored}


def test_a_range_of_one_number_is_that_number(made):
    add_robot(made, 0, 0.5)
    add_robot(made, 1, 0.5)
    gain = dict(sentences(answer_of(made)))["Gain"]
    assert gain.startswith("50 % less error") and " to " not in gain
