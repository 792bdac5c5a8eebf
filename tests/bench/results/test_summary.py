"""Sentences: they claim what the numbers show, and name exceptions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.figure_results import with_fields
from helpers.made_results import GOOD, VJM_MM, MadeResults, made_data
from stiff_bench.results.columns import matrix_table, task_table
from stiff_bench.results.scores import model_frame
from stiff_bench.results.summary import Summary, elsewhere_notes, summarize, task_headline
from stiff_protocols.contract.record import TEACHER_EPOCHS


def summary_of(made: MadeResults) -> Summary:
    scores = made.scores()
    return summarize(scores, model_frame(scores))


def sentence_of(made: MadeResults, label: str) -> str:
    return dict(summary_of(made).sentences)[label]


@pytest.mark.slow
def test_over_robots_the_headline_has_the_best_model_its_interval_and_its_robots(made):
    made.add_robots()
    scores = made.scores()
    table = model_frame(scores)
    good = table.iloc[0]
    headline = summarize(scores, table).headline
    assert headline.startswith("Use good: ") and "7 simulated robots" in headline
    for key in ("ratio", "low", "high"):
        assert f"{good[key]:.2f}" in headline


@pytest.mark.slow
@pytest.mark.parametrize(
    "ratios", [(0.5, 1.6, 0.7, 1.3, 0.6, 1.5, 0.9), (0.3, 0.5, 0.9, 1.4, 1.6), GOOD[:5]]
)
def test_the_headline_claims_nothing_that_chance_explains(made, ratios):
    for number, ratio in enumerate(ratios):
        made.add_robot(number, {"net": ratio})
    assert summary_of(made).headline.startswith("No model is reliably better")


@pytest.mark.slow
def test_exceptions_name_robots_on_which_another_model_is_ahead(made):
    made.add_robots()
    assert "fair on robot-6 (0.400 against 0.450)" in sentence_of(made, "But")


@pytest.mark.slow
def test_rivals_that_are_not_clearly_worse_are_named(made):
    for number, ratio in enumerate(GOOD):
        rival = ratio * (0.9 if number % 2 else 1.15)
        made.add_robot(number, {"vjm-full": ratio, "rival": rival})
    assert "Not significantly worse: rival" in sentence_of(made, "How sure")


@pytest.mark.parametrize(
    ("ratios", "headline"), [((0.5, 0.8), "Use net"), ((0.5, 1.2), "No model"), ((1.2,), "No")]
)
def test_with_few_robots_a_model_that_wins_more_than_it_loses_is_named(made, ratios, headline):
    for number, ratio in enumerate(ratios):
        made.add_robot(number, {"net": ratio})
    assert summary_of(made).headline.startswith(headline)
    assert "too few for a claim about other robots" in sentence_of(made, "Data")


def test_another_model_that_is_better_somewhere_is_named(made):
    made.add_robot(0, {"net": 0.5, "other": 5.0})
    made.add_robot(1, {"net": 0.6, "other": 0.1})
    assert summary_of(made).headline.endswith("better in 2 of 2 comparisons")
    but = sentence_of(made, "But")
    assert "other on arm-1" in but and "arm-0" not in but


def test_a_model_with_less_error_than_the_significant_one_is_named(made):
    made.add("vjm", VJM_MM)
    made.add("steady", [0.8 * error for error in VJM_MM])
    made.add("unsteady", [0.02, 0.17, 0.18])
    (task,) = made.scores().tasks
    assert (task.verdict("steady"), task.verdict("unsteady")) == ("a", "open")
    assert task.mean("unsteady") < task.mean("steady")
    headline = task_headline(task)
    assert headline.startswith("steady is better") and "unsteady has less error" in headline


@pytest.mark.parametrize("is_run", [True, False], ids=["its teacher is run", "it is not"])
def test_a_network_that_equals_its_teacher_says_so_and_wins_nothing(made, is_run):
    for number in range(2):
        made.add_robot(number, {"net": 0.5} | ({"vjm-full": 0.5} if is_run else {}))
    if not is_run:
        made_by = {"diagnostics": {TEACHER_EPOCHS: 0.0}, "chosen": {"anchor": "vjm-full"}}
        with_fields(made, "net", **made_by)
    scores = made.scores()
    assert scores.copies == {"net": "= vjm-full"}
    assert all(task.best() == ("vjm-full" if is_run else "vjm") for task in scores.tasks)
    (task, *_) = scores.tasks
    for table in (task_table(task), matrix_table(scores, scores.models)):
        ((name, error, *_),) = [row for row in table.rows if str(row[0]).startswith("net")]
        assert name.mark == "= vjm-full" and not error.mark
    headline = task_headline(task)
    assert headline.startswith("vjm-full is better") if is_run else "net = vjm-full" in headline
    assert not summary_of(made).headline.startswith("Use net")


def test_left_out_regions_that_contradict_the_test_poses_are_named(made):
    data = made_data(0)
    for protocol, ratio in {"holdout": 0.8, "workspace-extrapolation": 2.0}.items():
        errors = {"vjm": VJM_MM, "net": [ratio * error for error in VJM_MM]}
        made.add_each(errors, "arm", protocol, data=data)
    (note,) = elsewhere_notes(made.scores().tasks)
    assert note.startswith("arm, holdout: net is the best only near the training poses")
    assert "0.400 mm and vjm 0.200 mm" in note


@pytest.mark.parametrize(("group", "is_said"), [("d-optimal", True), ("measured", False)])
def test_errors_at_planned_poses_do_not_tell_those_of_a_path(made, group, is_said):
    data = made_data(0)
    samples = replace(data.samples, group=np.full(len(data.samples), group))
    errors = {"vjm": VJM_MM, "net": [0.8 * error for error in VJM_MM]}
    made.add_each(errors, "arm", data=replace(data, samples=samples))
    notes = [*elsewhere_notes(made.scores().tasks)]
    assert any("--protocol workspace-extrapolation" in note for note in notes) == is_said


def test_a_network_with_other_predictions_on_one_split_is_not_a_copy(made):
    made.add("vjm-full", [0.1, 0.1, 0.1])
    made.add("net", [0.1, 0.1, 0.0999])
    assert made.scores().copies == {}


def test_the_gain_in_one_task_is_that_of_the_numbers_with_their_wider_interval(made):
    made.add_robot(0, {"net": 0.5})
    (task,) = made.scores().tasks
    widest = max(task.estimates("net"), key=lambda estimate: estimate.high - estimate.low)
    interval = f"{-1e3 * widest.high:.3f} to {-1e3 * widest.low:.3f}"
    assert f"0.100 mm less error (95 % interval {interval})" in task_headline(task)


@pytest.mark.parametrize("kind", ["simulated", "unknown"])
def test_data_of_unknown_origin_are_never_called_simulated(made, kind):
    for number in range(2):
        made.add_robot(number, {"net": 0.5}, kind=kind)
    assert sentence_of(made, "Data").startswith(f"2 {kind} data sets.")
