"""Reading a folder of results: what contradicts the newest run never mixes with it."""

from __future__ import annotations

import pytest

from helpers.figure_results import with_fields
from helpers.made_results import MadeResults, forget
from stiff_bench.results.load import StoredResults, Task
from stiff_bench.results.notes import left_out_notes


def only(made: MadeResults) -> Task:
    (task,) = StoredResults.read(made.folder).tasks
    return task


@pytest.mark.parametrize(
    ("runs", "splits", "models"),
    [
        ([("a", 5, "old-"), ("c", 5, "old-"), ("a", 3, "new-")], ["new-0", "new-1", "new-2"], "a"),
        # an older run of the newest splits keeps its additional splits
        (
            [("a", 3, "old-"), ("a", 5, "new-"), ("b", 3, "new-")],
            [f"new-{number}" for number in range(5)],
            "ab",
        ),
        ([("a", 3, ""), ("b", 2, "")], ["0", "1", "2"], "ab"),
    ],
)
def test_older_results_on_other_splits_are_left_out_with_a_note(made, runs, splits, models):
    for number, (model, n_splits, named) in enumerate(runs):
        made.add(model, [1.0] * n_splits, run_id=str(number), splits_named=named)
    task = only(made)
    assert task.splits == tuple((index, f"split-{name}") for index, name in enumerate(splits))
    assert [*task.models] == [*models]
    notes = [*left_out_notes([task])]
    model_names = " (all of c)" if "c" in {model for model, *_ in runs} else ""
    note_text = f"older results on other splits than the newest run{model_names} are left out."
    assert notes == ([f"twin | holdout: {note_text}"] if len({run[2] for run in runs}) > 1 else [])


def test_splits_that_an_older_run_finished_later_go_with_it(made):
    """The second run has only split 2; only the first run shows that it is an old split."""
    made.add("a", [1.0] * 3, run_id="1", splits_named="old-")
    *first, _ = made.add("b", [1.0] * 3, run_id="2", splits_named="old-")
    for key in first:
        forget(made.folder, key)
    made.add("a", [2.0] * 2, run_id="3", splits_named="new-")
    assert {split[1] for split in only(made).splits} == {"split-new-0", "split-new-1"}


def test_a_resumed_run_includes_the_results_that_it_resumed_from_or_requested_again(made):
    """The second run was killed after two splits; the third did the rest; the fourth found all."""
    old = made.add("a", [9.0] * 5, run_id="1", splits_named="old-")
    made.add_run("3", made.add("a", [1.0] * 5, run_id="3", splits_named="new-"))
    made.add("a", [1.0] * 2, run_id="2", splits_named="new-")
    task = only(made)
    assert [split[1] for split in task.splits] == [f"split-new-{index}" for index in range(5)]
    assert [result.run_id for result in task.results("a")] == ["2", "2", "3", "3", "3"]
    assert task.newest_run == "3"
    made.add_run("4", old)
    assert {result.run_id for result in only(made).results("a")} == {"1"}
    assert only(made).newest_run == "4"


def test_a_cell_that_fails_when_it_is_computed_again_keeps_its_result(made):
    made.add("a", [1.0, 1.0], run_id="1")
    made.add_run("2", made.add("a", failed=[0], run_id="2"))
    stored = only(made).models["a"]
    assert {split[0] for split in stored.done} == {0, 1} and not stored.failures


@pytest.mark.parametrize(("newest", "n_requested"), [(slice(0, 2), 2), (slice(2, 3), 5)])
def test_the_newest_run_has_the_number_of_requested_splits(made, newest, n_requested):
    keys = made.add("a", [1.0] * 3, n_splits=2)
    with_fields(made, "a", split=2, n_splits=5)
    made.add_run("run-2", keys[newest])
    assert only(made).models["a"].n_requested == n_requested


def test_older_results_of_a_name_with_other_options_are_left_out_with_a_note(made):
    """A grid file was edited between two runs of `nested`."""
    for error, run_id, neighbours in ((9.0, "1", "3"), (1.0, "2", "5")):
        options = {"neighbours": neighbours}
        made.add("nested", [error, error], run_id=run_id, options=options)
    made.add("other", [2.0, 2.0], run_id="1")
    task = only(made)
    assert {result.run_id for result in task.results("nested")} == {"2"}
    assert len(task.results("other")) == 2
    (note,) = left_out_notes([task])
    assert "older results of nested with another version or other options are left out" in note


def test_a_model_that_fails_now_has_failed_and_an_older_failure_is_none(made):
    made.add("a", [1.0, 1.0], run_id="1")
    made.add("a", [1.0], failed=[0], run_id="2", coverage=0.9)
    made.add("b", failed=[0], run_id="1", coverage=0.9)
    made.add("b", [1.0], run_id="2")
    a, b = only(made).models.values()
    assert [split[0] for split in a.done] == [1]
    assert [failure.why_none for failure in a.failures.values()] == ["failed: it broke"]
    assert len(b.done) == 1 and not b.failures


@pytest.mark.parametrize("coverages", [(None, 0.9), (0.9, None), (0.8, 0.9), (0.9, 0.8)])
def test_the_newest_of_two_coverages_counts_and_any_before_none(made, coverages):
    older, newer = coverages
    for run_id, coverage in zip("12", coverages, strict=True):
        made.add("a", [1.0], run_id=run_id, coverage=coverage)
    (result,) = only(made).results("a")
    assert result.fit.coverage == (newer or older)


@pytest.mark.parametrize("newer", ["with intervals", "without"])
def test_results_with_intervals_have_a_version_of_their_own(made, newer):
    """Splits without intervals stay where a newer run has intervals, and the other way round."""
    plain, with_intervals = ("1", "2") if newer == "with intervals" else ("2", "1")
    made.add("a", [1.0, 1.0, 1.0], run_id=plain)
    made.add("a", [1.0], run_id=with_intervals, coverage=0.9, interval_version=3)
    made.add("a", [1.0, 1.0], run_id="0", coverage=0.8, interval_version=2)
    task = only(made)
    assert [result.fit.coverage for result in task.results("a")] == [0.9, None, None]
    (note,) = left_out_notes([task])
    assert "older results of a with another version" in note
