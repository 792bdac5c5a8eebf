"""The board: one vote per robot, measured robots apart, and a headline from the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from helpers.figure_results import with_fields
from helpers.made_results import MadeResults, made_data
from stiff_bench.analysis.answer import Answer
from stiff_bench.analysis.board import Board, BoardRow, without_seeds
from stiff_bench.analysis.board_tables import board_headline, board_sentences, board_tables
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.sort_key import sort_key
from stiff_protocols.contract.record import PATH_ERROR
from stiff_protocols.scoring.paired import holm

N_ROBOTS = 7
GOOD = (0.30, 0.35, 0.32, 0.40, 0.28, 0.33, 0.45)
FAIR = (0.70, 0.80, 0.75, 0.66, 0.90, 0.72, 0.40)
"""Error over the VJM's by robot; `FAIR` has the smaller error on the last robot."""


@pytest.fixture()
def made(tmp_path: Path) -> MadeResults:
    return MadeResults(tmp_path)


def add_robot(
    made: MadeResults, number: int, ratios: Mapping[str, float], *, words: str = "", **about
) -> None:
    """Write results of the VJM, and of models with these ratios to it, on a new robot."""
    data = made_data(number)
    data = replace(data, robot=replace(data.robot, name=f"robot-{number}"))
    where = {"dataset": f"arm-{number}{words}", "data": data, **about}
    for model, ratio in {"vjm": 1.0, **ratios}.items():
        made.add(model, [0.2 * ratio, 0.22 * ratio], **where)


def add_all(made: MadeResults, **about) -> None:
    for number, (good, fair) in enumerate(zip(GOOD, FAIR, strict=True)):
        add_robot(made, number, {"good": good, "fair": fair}, **about)


def board_of(made: MadeResults, **facts) -> Board:
    stored = without_seeds(StoredResults.read(made.folder))
    return Board(Answer.of(stored, sort_key("norm", None)), **facts)


def row_of(board: Board, name: str) -> BoardRow:
    return next(row for row in board.rows if row.name == name)


def sentence(board: Board, label: str) -> str:
    return next(part.text for part in board_sentences(board) if part.label == label)


def test_a_model_is_ranked_by_its_geometric_mean_over_robots(made):
    add_all(made)
    board = board_of(made)
    assert [row.name for row in board.rows] == ["good", "fair", "vjm"]
    good = row_of(board, "good")
    assert good.mean.ratio == pytest.approx(stats.gmean(GOOD))
    assert (good.won, row_of(board, "fair").won) == (6, 1)
    assert (good.worst, good.worst_robot) == (pytest.approx(0.45), "robot-6")
    assert good.p95 == pytest.approx(good.mean.ratio)


def test_data_sets_of_one_robot_weigh_the_same_and_are_one_vote(made):
    for number in range(N_ROBOTS):
        for plan, ratio in (("narrow", 0.2), ("wide", 0.8)):
            change = 1.0 + 0.01 * number
            add_robot(made, number, {"net": ratio * change}, words=f"@plan={plan}")
    add_robot(made, 0, {"net": 0.8}, words="@plan=wide", seed=1)
    wide = [f"arm-{number}@plan=wide" for number in range(N_ROBOTS)]
    board = board_of(made, groups={"wide": wide})
    net = row_of(board, "net")
    spread = stats.gmean(1.0 + 0.01 * np.arange(N_ROBOTS))
    assert net.mean.ratio == pytest.approx(0.4 * spread) and net.mean.n_robots == N_ROBOTS
    assert net.groups == {"wide": pytest.approx(0.8 * spread)}


def test_p_values_are_sign_flips_over_robots_corrected_for_all_models(made):
    add_all(made)
    board = board_of(made)
    assert row_of(board, "good").p_reference == pytest.approx(holm([2 / 128, 2 / 128])[0])
    assert row_of(board, "good").verdict == "better"
    assert np.isnan(row_of(board, "good").p_best) and not row_of(board, "fair").like_best


def test_a_model_within_five_percent_of_the_best_is_like_it(made):
    for number, ratio in enumerate(GOOD):
        add_robot(made, number, {"net": ratio, "twin": 1.01 * ratio, "far": 1.2 * ratio})
    board = board_of(made)
    assert row_of(board, "twin").like_best and not row_of(board, "far").like_best


def test_measured_robots_have_their_own_columns_and_are_not_averaged(made):
    add_all(made)
    add_robot(made, 9, {"good": 3.0, "fair": 0.5}, kind="measured")
    board = board_of(made)
    good = row_of(board, "good")
    assert good.mean.ratio == pytest.approx(stats.gmean(GOOD)) and good.mean.n_robots == 7
    assert good.measured["arm-9"].ratio == pytest.approx(3.0)
    assert "1 of 8 robots is measured" in sentence(board, "Data")
    assert "smallest on the board: fair (0.50)" in sentence(board, "Data")


def test_enough_measured_robots_are_the_board_and_have_no_columns_of_their_own(made):
    add_all(made, kind="measured")
    add_robot(made, 20, {"good": 5.0, "fair": 5.0})
    board = board_of(made)
    assert row_of(board, "good").mean.ratio == pytest.approx(stats.gmean(GOOD))
    assert not row_of(board, "good").measured
    assert "7 of 8 robots are measured" in sentence(board, "Data")


def test_a_model_without_every_score_is_not_on_the_board_and_is_named(made):
    add_all(made)
    add_robot(made, 20, {"good": 0.3, "fair": 0.7})
    for number in (0, 1):
        add_robot(made, number, {"some": 0.1})
    board = board_of(made)
    assert "some" not in {row.name for row in board.rows}
    assert board.n_splits["some"] == (2, 8)
    assert any("some (2 of 8)" in note for note in board_tables(board, {})[0].notes)


def test_one_split_of_each_data_set_is_enough_and_the_vjm_of_that_split_counts(made):
    for number, ratio in enumerate(GOOD):
        add_robot(made, number, {"good": ratio, "net": 2.0 * ratio})
        add_robot(made, number, {"good": ratio}, seed=1)
    board = board_of(made)
    assert row_of(board, "net").mean.ratio == pytest.approx(2.0 * stats.gmean(GOOD))
    (note,) = [text for text in board_tables(board, {})[0].notes if "net (" in text]
    assert f"{len(GOOD)} of {2 * len(GOOD)}" in note and "fewer" in note


def test_seeds_of_a_pre_training_are_one_model(made):
    for number, ratio in enumerate(GOOD):
        add_robot(made, number, {"net@layers=2": ratio})
        add_robot(made, number, {"net@layers=2@pretrain_seed=1": 2.0 * ratio}, seed=1)
    net = row_of(board_of(made), "net@layers=2")
    assert net.mean.ratio == pytest.approx(np.sqrt(2.0) * stats.gmean(GOOD))


def test_errors_on_tool_paths_are_over_those_of_the_vjm(made):
    add_all(made)
    for model, error in (("vjm", 0.2), ("good", 0.05), ("fair", 0.1)):
        with_fields(made, model, diagnostics={PATH_ERROR: error})
    assert row_of(board_of(made), "good").path == pytest.approx(0.25)


def test_the_headline_names_the_best_model_its_interval_and_its_robots(made):
    add_all(made)
    board = board_of(made)
    good = row_of(board, "good").mean
    text = board_headline(board)
    assert text.startswith("Use good:") and "7 simulated robots" in text
    assert f"{good.ratio:.2f} times" in text and f"{good.low:.2f} to {good.high:.2f}" in text


def test_the_headline_claims_nothing_that_chance_explains(made):
    for number, ratio in enumerate((0.5, 1.6, 0.7, 1.3, 0.6, 1.5, 0.9)):
        add_robot(made, number, {"net": ratio})
    assert board_headline(board_of(made)).startswith("No model is reliably better")


def test_exceptions_name_robots_and_groups_where_another_model_is_ahead(made):
    add_all(made)
    board = board_of(made, groups={"the last": ["arm-6"], "the first": ["arm-0"]})
    but = sentence(board, "But")
    assert "fair on robot-6 (0.400 against 0.450)" in but
    assert "'the last' fair is ahead" in but and "'the first'" not in but


def test_rivals_that_are_not_clearly_worse_are_named(made):
    for number, ratio in enumerate(GOOD):
        rival = ratio * (0.9 if number % 2 else 1.15)
        add_robot(made, number, {"net": ratio, "rival": rival})
    assert "Not significantly worse: rival" in sentence(board_of(made), "How sure")


def test_controls_compare_a_model_with_its_own_beginning(made):
    add_all(made)
    (control,) = board_of(made).controls({"good": "fair", "absent": "vjm"})
    ratios = np.array(GOOD) / np.array(FAIR)
    assert control.mean.ratio == pytest.approx(stats.gmean(ratios))
    assert (control.name, control.control, control.is_equal) == ("good", "fair", False)
