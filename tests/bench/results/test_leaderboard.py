"""The leaderboard per data set: it imputes nothing and compares only common splits."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from helpers.figure_results import with_fields
from helpers.made_results import GOOD, TWINS, MadeResults, forget
from stiff_bench.results.leaderboard import (
    StudyLeaderboard,
    comparable_scores,
    leaderboard_tables,
)
from stiff_bench.results.load import StoredResults
from stiff_bench.results.notes import TRAINING_MARK
from stiff_bench.results.scored_task import sort_key
from stiff_bench.results.scores import model_frame
from stiff_bench.results.selection import BoardSettings, Selection
from stiff_bench.tables.writers import render
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.record import Cost


def board_of(made: MadeResults, *models: str, metric="norm", axis=None, **chosen):
    """Return the scores, the notes on what does not count, and the tables."""
    stored = StoredResults.read(made.folder)
    selection = Selection(models, **{name: tuple(words) for name, words in chosen.items()})
    request = stored, sort_key(metric, axis), selection
    scores, notes = comparable_scores(*request)
    return SimpleNamespace(scores=scores, notes=notes, tables=leaderboard_tables(*request))


def text_of(board, fmt: str = "github") -> str:
    return render(board.tables, fmt, "bench leaderboard")


def cells(board, title: str) -> dict[str, list[str]]:
    """Return the cells of each row of a table, by the start of its title."""
    table = text_of(board).split(f"**{title}")[1].split("\n**")[0]
    lines = [line.strip("|").split("|") for line in table.splitlines() if line.startswith("|")]
    return {name.strip(): [cell.strip() for cell in row_cells] for name, *row_cells in lines[2:]}


def order(board) -> list[str]:
    """Return the models with a score without the VJM, best first."""
    return [name for name in model_frame(board.scores)["model"] if name != "vjm"]


def add_three(made: MadeResults) -> None:
    """Add three models on three data sets: a wins twice, b once; c is last, then second."""
    for dataset, errors in zip(TWINS, [(1, 2, 3), (1, 2, 3), (3, 1, 2)], strict=False):
        made.add_each({m: [error] * 2 for m, error in zip("abc", errors, strict=True)}, dataset)


def test_models_of_a_data_set_are_listed_best_first_among_those_that_are_shown(made):
    add_three(made)
    first = cells(board_of(made), TWINS[0])
    assert [name for name in first if name in "abc"] == ["a", "b", "c"]
    assert first["a"][0].endswith("*") and first["vjm"][-1] == "baseline"
    assert "b" not in cells(board_of(made, "a", "c"), TWINS[0])
    made.add_each({"net": [1.0], "net@size=2": [1.0], "network": [1.0]})
    assert {*order(board_of(made, "net"))} == {"net", "net@size=2"}


def test_a_missing_score_is_reported_with_its_reason_and_moves_no_other_model(made):
    add_three(made)
    made.add("winner", [0.1, 0.1], TWINS[0])
    made.add("broken", [0.1, 0.1], TWINS[1], failed=[1])
    board = board_of(made)
    missing = board.scores.missing
    assert missing["winner"] == ["not run"] * 2 and "FAILED: it broke" in missing["broken"]
    assert cells(board, TWINS[1])["broken"][0] == "FAILED"
    assert "Scores are missing" in text_of(board)


def test_the_intervals_are_those_of_the_verdicts_over_splits_and_over_poses(made, rng):
    base = rng.gamma(9.0, 1.0, size=(3, 4))
    made.add_each({"vjm": list(base), "net": list(0.5 * base)})
    board = board_of(made)
    (task,) = board.scores.tasks
    _, change, *intervals, verdict = cells(board, "twin")["net"]
    for text, estimate in zip(intervals, task.estimates("net"), strict=True):
        assert text == f"{1e3 * estimate.low:.4f} to {1e3 * estimate.high:.4f}"
    assert len(intervals) == 2 and (change, verdict) == ("-50", "better")
    assert task.verdict("net") == "a"


def test_protocols_that_select_on_the_test_part_count_only_without_others_and_have_a_mark(made):
    paper = {"protocol": "paper-holdout", "selects_on_test": True, "warning": "it is optimistic"}
    made.add("a", [2.0], **paper)
    made.add("b", [1.0], picked_on_test=True, **paper)
    unfair = board_of(made)
    assert order(unfair) == ["b", "a"] and unfair.scores.mark("b") == "epoch picked on test part"
    for part in ("b [epoch picked on test part]", "it is optimistic"):
        assert part in text_of(unfair)
    add_three(made)
    board = board_of(made)
    assert board.scores.mark("b") == "" and "optimistic" not in text_of(board)
    assert board.notes[-1].endswith("twin | paper-holdout.")


def test_what_noise_can_explain_or_makes_none_in_practice_is_like_the_best_and_no_other(made, rng):
    """Every split and pose of `equivalent` differs by 0.005 mm: equivalent in `bench compare`."""
    base = rng.gamma(9.0, 1.0, size=(3, 4))
    noise = rng.normal(size=(3, 4))
    changes = {"best": 0.0, "equivalent": 0.005, "near": 0.015, "worse": 50.0, "vjm": 60.0}
    changes |= {"like": noise - noise.mean() + 0.1}
    made.add_each({model: list(base + change) for model, change in changes.items()})
    marks = {name: cell[0].split()[-1] for name, cell in cells(board_of(made), "twin").items()}
    assert marks["best"] == "*" and {marks["equivalent"], marks["like"]} == {"≈"}
    assert not {marks["near"], marks["worse"]} & {"*", "≈"}


def test_a_clear_difference_is_found_among_any_number_of_models(made, rng):
    """Holm over 51 rivals needs a rarer event than 2000 draws can show."""
    base = rng.gamma(9.0, 1.0, size=(3, 4))
    worse = {f"worse-{number}": list(base + 50.0 + 0.01 * number) for number in range(51)}
    made.add_each({"best": list(base), "vjm": list(base + 60.0), **worse})
    (task,) = board_of(made).scores.tasks
    assert task.like_best() == {"best"}


def test_the_metric_decides_what_is_sorted_and_in_which_direction(made):
    made.add_each({"a": [3.0], "b": [1.0]})
    of_z, of_all = (board_of(made, metric="mae", axis=axis) for axis in ("z", None))
    assert of_z.scores.tasks[0].mean("a") == pytest.approx(3e-3)
    assert of_all.scores.tasks[0].mean("a") == pytest.approx(1e-3)
    assert order(of_z) == order(board_of(made, metric="skill")) == ["b", "a"]
    made.add_each({"a": [1.0, 3.0], "b": [4.0, 4.0]}, protocol="leave-one-out", pooled=True)
    (pooled,) = board_of(made, metric="me", axis="z", protocols=["leave-one-out"]).scores.tasks
    assert pooled.scores["a"].tolist() == pytest.approx([3e-3])


def test_splits_that_all_models_have_count_and_there_must_be_one(made):
    made.add_each({"a": [1.0, 5.0, 9.0], "b": [2.0, 2.0]})
    board = board_of(made)
    assert board.scores.tasks[0].mean("a") == pytest.approx(3e-3)
    assert "only the 2 of 3 splits" in text_of(board)
    first, *_ = made.add("b", [2.0, 2.0])
    forget(made.folder, first, *made.add("a", [1.0, 5.0, 9.0])[1:])
    with pytest.raises(StoreError, match="a and b were run on different splits and share none"):
        board_of(made)


@pytest.mark.parametrize(
    ("field", "values", "message"),
    [
        ("version", (1, 0), "twin is the name of different data here: samples ("),
        ("source", ("old", "new"), "different pre-training data here (new, old)"),
    ],
)
def test_the_newest_runs_data_count_if_data_of_one_name_changed(made, field, values, message):
    for value, run_id, error in zip(values, ("20260101T", "20270101T"), (1.0, 3.0), strict=True):
        made.add_each({"a": [error], "b": [2.0]}, run_id=run_id, **{field: value})
    board = board_of(made)
    assert order(board) == ["b", "a"] and len(board.scores.tasks) == 1
    assert message in text_of(board)


def test_what_cannot_be_compared_moves_no_model_and_is_reported(made):
    add_three(made)
    before = order(board_of(made))
    training = {"protocol": "paper-holdout@read_on=all", "reports_training": True}
    made.add_each({"a": [9.0] * 2, "b": [1.0] * 2}, "own", **training)
    made.add("a", [9.0] * 2, "lonely")
    board = board_of(made)
    assert order(board) == before and len(board.scores.tasks) == 3
    assert {*board.notes} == {
        f"Left out ({TRAINING_MARK}): own | paper-holdout@read_on=all.",
        "Left out (one of the models was run there): lonely | holdout.",
    }
    assert "Left out" in text_of(board)
    for dataset in ("own", "lonely"):
        with pytest.raises(ConfigError, match="nothing to compare"):
            board_of(made, datasets=(dataset,))


@pytest.mark.parametrize(
    ("done_counts", "requested_counts", "ranked", "n_splits"),
    [
        ((5, 5, 5), (5, 5, 5), "abc", 5),
        ((2, 5, 5), (5, 5, 5), "bc", 5),  # a takes no split from the others
        ((2, 2, 5), (2, 5, 5), "abc", 2),  # b has all that the others share
        ((2, 3, 5), (5, 3, 5), "bc", 3),  # --splits 3 for b; a has only two of those
        ((8, 5, 5), (20, 5, 5), "abc", 5),  # more splits requested later, and interrupted
        ((2, 2, 5), (0, 5, 5), "abc", 2),  # a's requested number is unknown
    ],
)
def test_an_interrupted_run_is_included_if_it_takes_no_split_from_the_finished(
    made, done_counts, requested_counts, ranked, n_splits
):
    for model, n_done, n_requested in zip("abc", done_counts, requested_counts, strict=True):
        made.add(model, [1.0] * n_done, n_splits=n_requested)
    (scored,) = board_of(made).scores.tasks
    assert {*scored.scores} - {"vjm"} == {*ranked} and len(scored.splits) == n_splits


def test_data_without_a_score_are_named_and_there_must_be_a_score(made):
    for model in "ab":
        made.add(model, [1.0] * 2, "unfinished", n_splits=5)
    with pytest.raises(ConfigError, match="no model has a score"):
        board_of(made)
    add_three(made)
    assert "no model has a score): unfinished | holdout." in text_of(board_of(made))


def test_a_table_shows_only_the_caveats_of_its_own_data_sets(made):
    for dataset, caveat in (("left", "left is odd"), ("right", "right is odd")):
        made.add_each({"a": [1.0], "b": [1.0]}, dataset, caveats=(caveat,))
    left_section, right_section = text_of(board_of(made)).split("\n**")[:2]
    assert "left is odd" in left_section and "right is odd" not in left_section
    assert "right is odd" in right_section and "left is odd" not in right_section


def test_costs_rank_models_without_a_test(made):
    for model, fit_s in {"quick": 4e-5, "slow": 90.0}.items():
        made.add(model, [1.0, 1.0, 1.0])
        for split in range(3):
            cost = Cost(fit_s, 0.1, 0.5 * fit_s, 12_345.6, None)
            with_fields(made, model, split=split, cost=cost)
    made.add("unknown", [1.0])  # it takes no splits from the others
    board = board_of(made, metric="fit-time")
    (task,) = board.scores.tasks
    assert order(board) == ["quick", "slow"] and "≈" not in text_of(board)
    assert len(task.splits) == 3 and not task.left_out
    assert task.missing["unknown"] == "no value of fit time [ms]"


@pytest.mark.slow
def test_on_a_study_s_board_a_model_equal_to_its_teacher_says_so_and_wins_nothing(made):
    for number, ratio in enumerate(GOOD):
        made.add_robot(number, {"net": ratio, "vjm-full": ratio})
    settings = BoardSettings("holdout", controls={"net": "vjm-full"})
    frame = StudyLeaderboard(StoredResults.read(made.folder), settings).frame.set_index("model")
    assert frame.loc["net", ["mark", "won"]].tolist() == ["= vjm-full", 0.0]
    assert frame.loc["vjm-full", "won"] == len(GOOD)


@pytest.mark.slow
def test_on_a_robot_where_two_models_tie_no_model_wins(made):
    for number, ratio in enumerate(GOOD):
        made.add_robot(number, {"net": 0.9 * ratio if number == 0 else ratio, "vjm-full": ratio})
    settings = BoardSettings("holdout", controls={"net": "vjm-full"})
    frame = StudyLeaderboard(StoredResults.read(made.folder), settings).frame.set_index("model")
    assert frame.loc[["net", "vjm-full"], "won"].tolist() == [1, 0]


@pytest.mark.slow
def test_variants_that_ran_in_some_worlds_have_tables_of_these_worlds(made):
    for number, ratio in enumerate(GOOD):
        made.add_robot(number, {"good": ratio, "wide": 0.9}, words="@world=all")
        ratios = {"good": ratio, "wide": 0.9, "narrow": 2.0 * ratio}
        made.add_robot(number, ratios, words="@world=structure")
    controls = {"narrow": "good", "wide": "good"}
    settings = BoardSettings("holdout", controls=controls, variants=("wide", "narrow"))
    tables = StudyLeaderboard(StoredResults.read(made.folder), settings).tables
    titles = [table.title for table in tables if table.about["table"] == "variants"]
    assert any(title.startswith("Variants: ") for title in titles)
    (against,) = [
        table for table in tables if table.title.startswith("Variants in structure: Models against")
    ]
    (row,) = against.texts()
    assert row[:3] == ["narrow", "good", "2.00"]
    (board,) = [t for t in tables if t.title.startswith("Variants in structure: Error over")]
    assert "wide" not in str(board.texts())


@pytest.mark.slow
def test_on_a_study_s_board_measured_data_have_estimates_and_no_verdicts(made):
    made.add_robots()
    made.add_robot(9, {"good": 3.0, "fair": 0.5}, kind="measured")
    board = StudyLeaderboard(StoredResults.read(made.folder), BoardSettings("holdout"))
    assert board.frame.set_index("model")["measured", "arm-9"]["good"] == pytest.approx(3.0)
    assert not any("verdict" in key[0] for key in board.frame if isinstance(key, tuple))
    (table,) = [table for table in board.tables if table.about.get("table") == "data set"]
    assert "verdict" not in {column.name for column in table.columns}
    assert any("is found in" in note for note in table.notes)
