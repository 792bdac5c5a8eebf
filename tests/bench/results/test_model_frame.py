"""Models over robots: one vote per robot, measured robots in separate columns."""

from __future__ import annotations

import numpy as np
import pytest
from pandas import DataFrame
from scipy import stats

from helpers.figure_results import with_fields
from helpers.made_results import FAIR, GOOD, MadeResults
from stiff_bench.results.columns import board_tables, model_table
from stiff_bench.results.scores import control_rows, model_frame
from stiff_bench.results.summary import split_notes, summarize
from stiff_protocols.contract.record import PATH_ERROR
from stiff_protocols.scoring.paired import holm

N_ROBOTS = len(GOOD)


def frame_of(made: MadeResults, few=()) -> DataFrame:
    few_scores = {name: made.scores(protocol=word) for name, word in dict(few).items()}
    scores = made.scores(protocol="holdout")
    return model_frame(scores, few_scores).set_index("model")


def data_text(made: MadeResults) -> str:
    scores = made.scores()
    return dict(summarize(scores, model_frame(scores)).sentences)["Data"]


@pytest.mark.slow
def test_a_model_is_ranked_by_its_geometric_mean_over_robots_with_students_interval(made):
    made.add_robots()
    frame = frame_of(made)
    assert [*frame.index] == ["good", "fair", "vjm"] and frame["complete"].all()
    good, logs = frame.loc["good"], np.log(GOOD)
    bounds = stats.t.interval(0.95, len(logs) - 1, logs.mean(), stats.sem(logs))
    assert good[["ratio", "low", "high"]].tolist() == pytest.approx(
        [stats.gmean(GOOD), *np.exp(bounds)]
    )
    assert good[["smallest", "largest", "worst"]].tolist() == pytest.approx([0.28, 0.45, 0.45])
    assert frame["won"].tolist() == [6, 1, 0] and good["worst robot"] == "robot-6"
    assert good["p95"] == pytest.approx(good["ratio"])
    without_best, without_worst = np.delete(GOOD, 4), np.delete(GOOD, 6)
    assert good[["without low", "without high"]].tolist() == pytest.approx(
        [stats.gmean(without_worst), stats.gmean(without_best)]
    )


@pytest.mark.slow
def test_data_sets_and_protocols_of_one_robot_weigh_the_same_and_are_one_vote(made):
    for number in range(N_ROBOTS):
        for plan, ratio in (("narrow", 0.2), ("wide", 0.8)):
            change = 1.0 + 0.01 * number
            made.add_robot(number, {"net": ratio * change}, words=f"@plan={plan}")
    made.add_robot(0, {"net": 0.8}, words="@plan=wide", seed=1)  # a repeat has no vote
    net = frame_of(made).loc["net"]
    spread = stats.gmean(1.0 + 0.01 * np.arange(N_ROBOTS))
    assert net["ratio"] == pytest.approx(0.4 * spread) and net["n robots"] == N_ROBOTS


@pytest.mark.slow
def test_worlds_of_a_robot_weigh_the_same_and_have_columns_with_intervals(made):
    """Two plans share the vote of the world clean."""
    ratios = {"@plan=narrow@world=clean": 0.2, "@world=clean": 0.8, "@world=all": 0.9}
    for number in range(N_ROBOTS):
        for words, ratio in ratios.items():
            change = 1.0 + 0.01 * number
            made.add_robot(number, {"net": ratio * change}, words=words)
    net = frame_of(made).loc["net"]
    logs = np.log(1.0 + 0.01 * np.arange(N_ROBOTS))
    spread = np.exp(logs.mean())
    assert net["ratio"] == pytest.approx(np.sqrt(0.4 * 0.9) * spread)
    assert net["world", "clean"] == pytest.approx(0.4 * spread)
    assert net["without clean"] == net["world", "all"] == pytest.approx(0.9 * spread)
    bounds = stats.t.interval(0.95, len(logs) - 1, logs.mean(), stats.sem(logs))
    ends = [net[f"world {end}", "all"] for end in ("low", "high")]
    assert ends == pytest.approx(0.9 * np.exp(bounds))


@pytest.mark.slow
def test_the_coverage_of_the_models_own_intervals_has_a_column_by_world_and_number_of_poses(made):
    for number in range(N_ROBOTS):
        for words in ("@world=clean", "@world=all"):
            made.add_robot(number, {"net": 0.5}, words=words, coverage=0.9)
            made.add_robot(number, {"net": 0.5}, words=words, protocol="few")
    scores, few = (made.scores(protocol=name) for name in ("holdout", "few"))
    table = model_frame(scores, {"20 poses": few})
    net = table.set_index("model").loc["net"]
    assert net["coverage", "clean"] == net["coverage", "all"] == 1.0
    assert np.isnan(net["coverage", "20 poses"])  # without intervals
    tables = board_tables(scores, table, {})
    (coverage,) = [part for part in tables if part.about.get("table") == "coverage"]
    assert [row[0] for row in coverage.texts()] == ["net", "vjm"]


def test_with_few_robots_the_ratio_is_their_mean_and_there_is_no_interval(made):
    made.add_robot(0, {"net": 0.5})
    for number in range(1, 4):
        made.add_robot(0, {"net": 0.8}, words=f"@plan={number}")
    made.add_robot(1, {"net": 0.9})
    frame = frame_of(made)
    of_robot = stats.gmean([0.5, 0.8, 0.8, 0.8])
    assert frame.loc["net", "ratio"] == pytest.approx(np.sqrt(of_robot * 0.9))
    assert "low" not in frame and "won" not in frame


@pytest.mark.slow
def test_p_values_are_sign_flips_over_robots_corrected_for_all_models(made):
    """Five robots are too few for significance; six are enough."""
    for n_robots in (5, 6):
        for number in range(n_robots):
            made.add_robot(number, {"good": GOOD[number]})
        good = frame_of(made).loc["good"]
        assert good["p"] == pytest.approx(2 / 2**n_robots)
        assert good["verdict"] == ("better" if n_robots == 6 else "open")
    made.add_robots()
    frame = frame_of(made)
    assert frame.loc["good", "p"] == pytest.approx(holm([2 / 128, 2 / 128])[0])
    assert frame.loc["fair", "like best"] is False


@pytest.mark.slow
def test_the_rival_is_the_best_spring_model_and_every_model_has_a_verdict_against_it(made):
    for number, ratio in enumerate(GOOD):
        ratios = {"net": 0.5 * ratio, "vjm-full": ratio, "curve-springs@a=1": 2.0 * ratio}
        made.add_robot(number, ratios)
    frame = frame_of(made)
    assert {*frame["rival"]} == {"vjm-full"}
    assert frame["verdict rival"].to_dict() == {
        **{"net": "better", "vjm-full": "baseline", "curve-springs@a=1": "worse", "vjm": "worse"}
    }


@pytest.mark.slow
def test_a_model_within_five_percent_of_the_best_is_like_it(made):
    for number, ratio in enumerate(GOOD):
        made.add_robot(number, {"net": ratio, "twin": 1.01 * ratio, "far": 1.2 * ratio})
    assert frame_of(made)["like best"][["twin", "far"]].tolist() == [True, False]


@pytest.mark.slow
def test_measured_robots_have_their_own_columns_and_are_not_averaged(made):
    made.add_robots()
    made.add_robot(9, {"good": 3.0, "fair": 0.5}, kind="measured")
    good = frame_of(made).loc["good"]
    assert good["ratio"] == pytest.approx(stats.gmean(GOOD)) and good["n robots"] == N_ROBOTS
    assert good["measured", "arm-9"] == pytest.approx(3.0)
    assert good["measured verdict", "arm-9"] == "b"
    assert data_text(made).startswith("1 of 8 robots is measured; on arm-9 good has")
    assert "smallest on the board: fair (0.50)" in data_text(made)


@pytest.mark.slow
def test_enough_measured_robots_are_the_board_and_have_no_columns_of_their_own(made):
    made.add_robots(kind="measured")
    made.add_robot(20, {"good": 5.0, "fair": 5.0})
    frame = frame_of(made)
    assert frame.loc["good", "ratio"] == pytest.approx(stats.gmean(GOOD))
    assert ("measured", "arm-0") not in frame
    assert "7 of 8 robots are measured" in data_text(made)


@pytest.mark.slow
def test_a_model_without_every_score_is_not_on_the_board_and_is_named(made):
    made.add_robots()
    made.add_robot(20, {"good": 0.3, "fair": 0.7})
    for number in (0, 1):
        made.add_robot(number, {"some": 0.1})
    scores = made.scores()
    table = model_frame(scores)
    assert table.set_index("model")["complete"].to_dict() == {
        **{"good": True, "fair": True, "vjm": True, "some": False}
    }
    *_, last_row = model_table(scores, table, "models").texts()  # last, with the smallest ratio
    assert (last_row[0], last_row[3]) == ("some", "-")
    board, *_ = board_tables(scores, table, {}, split_notes(scores, table))
    assert "some" not in {str(row[0]) for row in board.rows}
    assert any("Not on the board" in note and "some (2 of 8)" in note for note in board.notes)


@pytest.mark.slow
def test_one_split_of_each_data_set_is_enough_and_the_vjm_of_that_split_counts(made):
    for number, ratio in enumerate(GOOD):
        made.add_robot(number, {"good": ratio, "net": 2.0 * ratio})
        made.add_robot(number, {"good": ratio}, seed=1)
    scores = made.scores()
    table = model_frame(scores)
    net = table.set_index("model").loc["net"]
    assert net["complete"] and net["ratio"] == pytest.approx(2.0 * stats.gmean(GOOD))
    assert split_notes(scores, table) == ["With fewer splits: net (7 of 14)."]


@pytest.mark.slow
def test_seeds_of_a_pre_training_are_one_model(made):
    for number, ratio in enumerate(GOOD):
        made.add_robot(number, {"net@layers=2": ratio})
        made.add_robot(number, {"net@layers=2@pretrain_seed=1": 2.0 * ratio}, seed=1)
    ratio = frame_of(made).loc["net@layers=2", "ratio"]
    assert ratio == pytest.approx(np.sqrt(2.0) * stats.gmean(GOOD))


@pytest.mark.slow
def test_errors_on_paths_and_with_fewer_poses_are_over_those_of_the_vjm(made):
    made.add_robots()
    for number, ratio in enumerate(FAIR):
        made.add_robot(number, {"good": ratio}, protocol="few")
    for model, error in (("vjm", 0.2), ("good", 0.05), ("fair", 0.1)):
        with_fields(made, model, diagnostics={PATH_ERROR: error})
    frame = frame_of(made, few={"20 poses": "few"})
    assert frame.loc["good", "path"] == pytest.approx(0.25)
    few = frame["few", "20 poses"]
    assert few["good"] == pytest.approx(stats.gmean(FAIR)) and np.isnan(few["fair"])


def test_controls_compare_a_model_with_its_own_beginning(made):
    made.add_robots()
    (control,) = control_rows(made.scores(), {"good": "fair", "absent": "vjm"})
    assert control["ratio"] == pytest.approx(stats.gmean(np.array(GOOD) / np.array(FAIR)))
    assert (control["model"], control["control"], control["equal"]) == ("good", "fair", False)
