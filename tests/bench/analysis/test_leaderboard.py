"""The leaderboard: ranks by hand, nothing imputed, nothing compared that did not meet."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from helpers.figure_results import with_fields
from helpers.made_results import N_POSES, TWINS, MadeResults, forget
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.leaderboard import Leaderboard, build_leaderboard
from stiff_bench.analysis.leaderboard_tables import leaderboard_tables
from stiff_bench.analysis.selection import Selection
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.tables.metric_table import TRAINING_MARK
from stiff_bench.tables.render import render
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.record import Cost
from stiff_protocols.scoring.bootstrap import pose_errors, resampled_means


@pytest.fixture()
def made(tmp_path: Path) -> MadeResults:
    return MadeResults(tmp_path)


def board_of(made: MadeResults, *models: str, metric="norm", axis=None, **narrowed) -> Leaderboard:
    stored = StoredResults.read(made.folder)
    selection = Selection(models, **{name: tuple(words) for name, words in narrowed.items()})
    return build_leaderboard(stored, sort_key(metric, axis), selection)


def text_of(board: Leaderboard, fmt: str = "github") -> str:
    return render(leaderboard_tables(board), fmt, "bench leaderboard")


def scores_of(board: Leaderboard) -> dict[str, dict[str, object]]:
    """Return the numbers of the first table by protocol, of its first column, by model."""
    table = json.loads(text_of(board, "json"))["tables"][1]
    return {row["model"]: row["values"][0] for row in table["rows"]}


def cells(board: Leaderboard, title: str) -> dict[str, list[str]]:
    """Return the cells of the rows of the table whose title begins so."""
    table = text_of(board).split(f"**{title}")[1]
    lines = [line.strip("|").split("|") for line in table.splitlines() if line.startswith("|")]
    return {name.strip(): [cell.strip() for cell in found] for name, *found in lines[2:]}


def ranks(board: Leaderboard) -> dict[str, float]:
    return board.sections[0].ranked["mean_rank"].to_dict()


def add_three(made: MadeResults, **changes) -> None:
    """Three models on three data sets: a wins twice, b once, c comes last, then second."""
    for dataset, errors in zip(TWINS, [(1, 2, 3), (1, 2, 3), (3, 1, 2)], strict=False):
        each = {model: [error] * 2 for model, error in zip("abc", errors, strict=True)}
        made.add_each(each, dataset, **changes)


def test_models_are_sorted_by_their_mean_rank_among_those_that_are_shown(made):
    add_three(made)
    board = board_of(made)
    assert ranks(board) == pytest.approx({"a": 5 / 3, "b": 5 / 3, "c": 8 / 3})
    assert board.sections[0].ranked["won"].tolist() == [2, 1, 0]
    assert "sorted by mean rank of 3-D error [mm] (smaller is better)" in text_of(board)
    board = board_of(made, "a", "c")
    assert ranks(board) == pytest.approx({"a": 4 / 3, "c": 5 / 3})
    assert "| b" not in text_of(board)


def test_a_key_stands_for_all_its_variants(made):
    made.add_each({key: [1.0] for key in ["net", "net@size=2", "network"]})
    assert set(ranks(board_of(made, "net"))) == {"net", "net@size=2"}


def test_a_model_that_lacks_a_case_has_no_mean_rank_and_moves_nobody_elses(made):
    add_three(made)
    made.add("winner", [0.1, 0.1], TWINS[0])
    board = board_of(made)
    assert ranks(board) == pytest.approx({"a": 5 / 3, "b": 5 / 3, "c": 8 / 3})
    ((name, missing),) = board.sections[0].unranked.items()
    assert name == "winner" and set(missing.values()) == {"not run"}
    lacking = ", ".join(f"twin@specimen={number} | holdout" for number in (1, 2))
    assert f"winner lacks 2 of 3 results ({lacking}: not run)" in text_of(board)
    assert cells(board, "holdout")["winner"] == ["0.1000 (1/3)"]
    made.add_each({"other": [1.0], "vjm": [1.0]}, "twin@specimen=3")
    for dataset in TWINS[:3]:
        made.add("vjm", [1.0, 1.0], dataset)
    assert board_of(made).sections[0].unranked["vjm"] == {}, "no other model has all results"


def test_a_failure_is_missing_with_its_reason_and_is_said_in_its_column(made):
    add_three(made)
    for dataset in TWINS[:3]:
        made.add("broken", [0.1, 0.1], dataset, failed=[1] if dataset == TWINS[0] else [])
    made.add("never", failed=[0, 1], dataset=TWINS[0])
    board = board_of(made)
    assert "FAILED in 1 of 2 splits: it broke" in text_of(board)
    shown = cells(board, "holdout")
    assert shown["broken"] == ["0.1000 ± 0.0000 (2/3) FAILED"]
    assert shown["never"] == ["FAILED"]


def test_splits_that_all_models_have_count_and_there_must_be_one(made):
    made.add_each({"a": [1.0, 5.0, 9.0], "b": [2.0, 2.0]})
    board = board_of(made)
    assert board.sections[0].cases[0].mean("a") == pytest.approx(3e-3)
    assert "only the 2 of 3 splits" in text_of(board)
    first, *_ = made.add("b", [2.0, 2.0])
    forget(made.folder, first, *made.add("a", [1.0, 5.0, 9.0])[1:])
    with pytest.raises(StoreError, match="a and b were run on different splits and share none"):
        board_of(made)


@pytest.mark.parametrize(
    ("older", "newer", "said"),
    [
        ({"version": 1}, {"version": 0}, "twin stands for different data here: samples ("),
        ({"source": "old"}, {"source": "new"}, "different pre-training data here (new, old)"),
    ],
)
def test_of_data_that_changed_under_one_name_those_of_the_newest_run_count(
    made, older, newer, said
):
    for run_id, about, error in (("20260101T", older, 1.0), ("20270101T", newer, 3.0)):
        made.add_each({"a": [error], "b": [2.0]}, run_id=run_id, **about)
    board = board_of(made)
    assert ranks(board) == {"b": 1.0, "a": 2.0}
    assert len(board.sections[0].cases) == 1
    assert said in text_of(board)


@pytest.mark.parametrize(
    ("models", "dataset", "about", "said"),
    [
        (
            *("ab", "own", {"protocol": "paper-holdout@read_on=all", "reports_training": True}),
            f"paper-holdout@read_on=all is left out: {TRAINING_MARK}.",
        ),
        (
            *("a", "lonely", {}),
            "lonely | holdout is left out: none of the other models was run there.",
        ),
    ],
)
def test_what_cannot_be_ranked_moves_no_rank_and_is_said(made, models, dataset, about, said):
    add_three(made)
    before = ranks(board_of(made))
    for model, error in zip(models, (9.0, 1.0), strict=False):
        made.add(model, [error, error], dataset, **about)
    board = board_of(made)
    (section,) = board.sections
    assert ranks(board) == before and len(section.cases) == 3
    assert said in text_of(board)
    with pytest.raises(ConfigError, match="nothing to rank"):
        board_of(made, datasets=(dataset,))


def test_protocols_that_select_on_the_test_part_are_ranked_apart_and_marked(made):
    add_three(made)
    papers = {"protocol": "paper-holdout", "selects_on_test": True, "warning": "it is optimistic"}
    made.add("a", [2.0], **papers)
    made.add("b", [1.0], picked_on_test=True, **papers)
    board = board_of(made)
    fair, unfair = board.sections
    assert ranks(board)["a"] == pytest.approx(5 / 3)
    assert unfair.ranked["mean_rank"].to_dict() == {"b": 1.0, "a": 2.0}
    assert (fair.mark_under("b"), unfair.mark_under("b")) == ("", "epoch picked on test part")
    text = text_of(board)
    assert "b [epoch picked on test part]" in text
    assert "not a fair comparison" in text and "it is optimistic" in text


def test_the_interval_of_one_case_is_that_of_the_ranks_over_its_poses(made, rng):
    errors = {
        model: rng.gamma(2.0, scale, size=N_POSES)
        for model, scale in zip("abc", (5, 6, 9), strict=True)
    }
    made.add_each({model: [error] for model, error in errors.items()}, rows=np.arange(N_POSES))
    poses = [f"P{pose:02d}" for pose in range(N_POSES)]
    of_models = np.column_stack([errors[model] * 1e-3 for model in "abc"])
    drawn = resampled_means(pose_errors(poses, of_models))
    low, high = np.quantile(stats.rankdata(drawn, axis=1), [0.025, 0.975], axis=0)
    ranked = board_of(made).sections[0].ranked.loc[[*"abc"]]
    means = [errors[m].mean() for m in "abc"]
    assert ranked["mean_rank"].tolist() == stats.rankdata(means).tolist()
    assert ranked["low"].tolist() == pytest.approx(low)
    assert ranked["high"].tolist() == pytest.approx(high)
    assert low[0] < high[0]  # else nothing was shown


def test_the_interval_holds_the_mean_rank_also_where_draws_pull_it_to_the_middle(made, rng):
    """A model that is ahead everywhere by a hair falls behind somewhere in nearly every draw."""
    for dataset in TWINS:
        errors = rng.gamma(2.0, 1.0, size=(6, N_POSES))
        errors *= (1.0 / errors.mean(axis=1))[:, None]
        errors[0] *= 0.999
        each = {model: [error] for model, error in zip("abcdef", errors, strict=True)}
        made.add_each(each, dataset, rows=np.arange(N_POSES))
    board = board_of(made)
    first = board.sections[0].ranked.iloc[0]
    assert (first.name, first.mean_rank, first.low) == ("a", 1.0, 1.0)
    assert first.high > 2.0


def test_cases_on_the_same_poses_are_drawn_together(made, rng):
    """Two conditions with the same errors say no more than one of them."""
    errors = {"a": [rng.gamma(2.0, 5, size=N_POSES)], "b": [rng.gamma(2.0, 6, size=N_POSES)]}
    for condition in ("n = 5", "n = 10"):
        made.add_each(errors, rows=np.arange(N_POSES), condition=condition)
    first = board_of(made).sections[0].ranked.iloc[0]
    assert (first.low, first.high) == (1.0, 2.0)  # independent draws would give 1.5 too


def test_what_noise_can_explain_or_makes_none_in_practice_is_like_the_best_and_no_other(made, rng):
    """Every split and pose of `equivalent` differs by 0.005 mm: `bench compare` calls it that."""
    base = rng.gamma(9.0, 1.0, size=(3, 4))
    noise = rng.normal(size=(3, 4))
    changes = {"best": 0.0, "equivalent": 0.005, "near": 0.015, "worse": 50.0}
    for model, change in (changes | {"like": noise - noise.mean() + 0.1}).items():
        made.add(model, list(base + change))
    board = board_of(made)
    found = board.sections[0].ranked["like_best"].to_dict()
    assert found == {"best": 1, "equivalent": 1, "near": 0, "like": 1, "worse": 0}
    marks = {name: cell.split()[-1] for name, (cell,) in cells(board, "holdout").items()}
    assert marks["like"] == "≈" and marks["best"] == "*" and marks["worse"] not in "≈*"
    base = rng.gamma(9.0, 1.0, size=N_POSES)  # of a single split, which is tested over its poses
    for model, change in (("best", 0.0), ("like", rng.normal(size=N_POSES) + 0.1), ("worse", 9.0)):
        made.add(model, [base + change], protocol="other", rows=np.arange(N_POSES))
    (one_split,) = board_of(made, protocols=["other"]).sections
    assert one_split.ranked["like_best"].to_dict() == {
        "best": 1,
        "like": 1,
        "worse": 0,
    }


def test_a_column_is_mean_and_deviation_over_data_sets_and_its_conditions_are_in_order(made):
    for dataset, error in zip(TWINS, (1.0, 2.0, 6.0), strict=False):
        for condition in ("n = 10", "n = 5"):
            made.add_each({"a": [error], "b": [error + 1]}, dataset, condition=condition)
    board = board_of(made)
    value = scores_of(board)["a"]
    assert (value["value"], value["spread"]) == pytest.approx((3, np.std([1, 2, 6], ddof=1)))
    assert value["condition"] == "n = 5"
    assert "3.0000 ± 2.6458 *" in text_of(board)
    assert "n = 5 (3 data sets)" in text_of(board)


def test_the_metric_decides_what_is_ranked_and_in_which_direction(made):
    made.add_each({"a": [3.0], "b": [1.0]})
    of_z, of_all, of_x = (board_of(made, metric="mae", axis=axis) for axis in ("z", None, "x"))
    assert of_z.sections[0].cases[0].mean("a") == pytest.approx(3e-3)
    assert of_all.sections[0].cases[0].mean("a") == pytest.approx(1e-3)
    assert ranks(of_z) == {"b": 1.0, "a": 2.0} and ranks(of_x) == {"a": 1.5, "b": 1.5}
    assert "mean rank of MAE [mm], mean over x, y, z (smaller is better)" in text_of(of_all)
    of_skill = board_of(made, metric="skill")
    assert ranks(of_skill) == {"b": 1.0, "a": 2.0}
    assert of_skill.sections[0].ranked["low"].isna().all()  # nothing is drawn
    assert "larger is better" in text_of(of_skill)
    made.add_each({"a": [1.0, 3.0], "b": [4.0, 4.0]}, protocol="leave-one-out", pooled=True)
    (pooled,) = board_of(made, metric="me", axis="z", protocols=["leave-one-out"]).sections[0].cases
    assert pooled.scores["a"].tolist() == pytest.approx([3e-3])


def test_a_protocols_table_shows_the_marks_of_that_protocol_alone(made):
    for protocol, regime in (("cross-robot", "target alone"), ("holdout", "")):
        made.add("a", [1.0], protocol=protocol, regime=regime)
        made.add("b", [2.0], protocol=protocol)
    board = board_of(made)
    assert "a [target alone]" in cells(board, "Leaderboard")
    assert "a [target alone]" in cells(board, "cross-robot")
    assert "a" in cells(board, "holdout")


def test_a_model_without_the_metric_takes_no_splits_from_the_others(made):
    made.add_each({"a": [1.0] * 3, "b": [1.0] * 3, "c": [1.0]})
    for model in "ab":
        with_fields(made, model, cost=Cost(1.0, 0.1, 1e-3, 1e3, None))
    with_fields(made, "c", cost=None)
    board = board_of(made, metric="fit-time")
    (scored,) = board.sections[0].cases
    assert len(scored.slots) == 3 and set(scored.scores) == {"a", "b"}
    assert scored.missing["c"] == "no value of fit time [ms]"
    assert not scored.left_out


@pytest.mark.parametrize(
    ("done", "asked", "ranked", "n_slots"),
    [
        ((5, 5, 5), (5, 5, 5), "abc", 5),
        ((2, 5, 5), (5, 5, 5), "bc", 5),  # a takes no split from the others
        ((2, 2, 5), (2, 5, 5), "abc", 2),  # b has all that the others share
        ((2, 3, 5), (5, 3, 5), "bc", 3),  # --splits 3 for b; a lacks one of those
        ((8, 5, 5), (20, 5, 5), "abc", 5),  # asked for more later, and interrupted
        ((2, 2, 5), (0, 5, 5), "abc", 2),  # a's number is not known
        ((2, 2, 2), (5, 5, 5), "", 0),  # nobody finished
    ],
)
def test_an_interrupted_run_takes_part_where_it_takes_no_split_from_the_finished(
    made, done, asked, ranked, n_slots
):
    for model, n_done, n_asked in zip("abc", done, asked, strict=True):
        made.add(model, [1.0] * n_done)
        with_fields(made, model, n_splits=n_asked)
    (scored,) = board_of(made).sections[0].cases
    assert set(scored.scores) == set(ranked) and len(scored.slots) == n_slots


def test_costs_are_ranked_without_a_test(made):
    for dataset in TWINS:
        made.add_each({key: [1.0, 1.0] for key in "abc"}, dataset)
    for model, seconds in (("a", 1.0), ("b", 5.0), ("c", 9.0)):
        with_fields(made, model, cost=Cost(seconds, 0.1, 1e-3, 1e3, None))
    board = board_of(made, metric="fit-time")
    assert ranks(board) == {"a": 1.0, "b": 2.0, "c": 3.0}
    assert board.sections[0].ranked["like_best"].isna().all()
    assert "\u2248" not in text_of(board)


def test_a_table_shows_the_caveats_of_its_own_data_sets_alone(made):
    for dataset, caveat in (("left", "left is odd"), ("right", "right is odd")):
        made.add_each({"a": [1.0], "b": [1.0]}, dataset, caveats=(caveat,))
    _, left, right = text_of(board_of(made)).split("\n**")
    assert "left is odd" in left and "right is odd" not in left
    assert "right is odd" in right and "left is odd" not in right


def test_a_clear_difference_is_found_among_any_number_of_models(made, rng):
    """Holm over 51 rivals asks for a rarer event than 2000 draws hold."""
    base = rng.gamma(9.0, 1.0, size=(3, 4))
    worse = {f"worse-{number}": list(base + 50.0 + 0.01 * number) for number in range(51)}
    made.add_each({"best": list(base), **worse})
    assert board_of(made).sections[0].ranked["like_best"].tolist() == [1] + [0] * 51


@pytest.mark.parametrize(
    ("metric", "axis", "said"),
    [
        ("coverage", None, "its best value is the nominal one"),
        ("width", None, "narrower intervals are better only at equal coverage"),
        ("norm", "x", "metrics with axes are mae"),
        ("maw", None, "did you mean 'mae'"),
    ],
)
def test_what_cannot_sort_is_refused(metric, axis, said):
    with pytest.raises(ConfigError, match=said):
        sort_key(metric, axis)


def test_csv_holds_the_ranks_and_json_every_score_with_the_reason_of_a_missing_one(made):
    add_three(made)
    made.add("d", [0.1, 0.1], TWINS[0])
    board = board_of(made)
    rows = list(csv.DictReader(io.StringIO(text_of(board, "csv"))))
    of_rank = [row for row in rows if row["column"] == "mean rank" and row["value"]]
    assert [float(row["value"]) for row in of_rank] == pytest.approx([5 / 3, 5 / 3, 8 / 3])
    assert len({(row["model"], row["column"]) for row in rows}) == len(rows)
    assert not any("note" in name for name in rows[0])
    tables = json.loads(text_of(board, "json"))["tables"]
    (scores,) = (table for table in tables if table["table"] == "scores")
    assert len(scores["rows"]) == 12
    values = {model: [] for model in "abcd"}
    for row in scores["rows"]:
        values[row["model"]].append(row["values"][0])
    assert [one["value"] for one in values["a"]] == pytest.approx([1.0, 1.0, 3.0])
    assert [one.get("status") for one in values["d"]] == [None, "not run", "not run"]
    (score, *_) = tables[1]["rows"][0]["values"]
    assert (score["metric"], score["axis"]) == ("norm", "")  # as in tables of `bench run`
    assert (score["datasets"], score["seeds"]) == ([*TWINS[:3]], [0])


def priced(made: MadeResults, model: str, fits_s: Sequence[float], memory: int | None = None):
    """Say what a model's three splits cost."""
    made.add(model, [1.0, 1.0, 1.0])
    for split, fit_s in enumerate(fits_s):
        cost = Cost(fit_s, 0.1, 0.5 * fit_s, 12_345.6, memory)
        with_fields(made, model, split=split, cost=cost)


def test_costs_stand_beside_the_ranks_as_medians_with_their_range(made):
    priced(made, "quick", [4e-5, 2e-5, 2e-4], memory=3 * 2**20)
    priced(made, "slow", [90.0, 60.0, 70.0])
    made.add("unknown", [1.0, 1.0, 1.0])
    board = board_of(made)
    rows = cells(board, "Costs of 6 fits | median (lowest to highest), not ranked")
    assert rows["quick"] == ["40 us (20 to 200)", "12,300", "20 us (10 to 100)", "3.0", "3"]
    assert rows["slow"] == ["70 s (60 to 90)", "12,300", "35 s (30 to 45)", "-", "3"]
    assert "unknown" not in rows
