"""A table compares named and fresh robots, and a model that knows the named ones has a flag."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from helpers.made_results import GOOD, MadeResults
from stiff_bench.results.fresh_robots import (
    COMMON_WORLDS,
    FILE,
    FLAG,
    flag_of,
    fresh_over_named,
    fresh_tables,
)
from stiff_bench.results.leaderboard import StudyLeaderboard
from stiff_bench.results.load import StoredResults
from stiff_bench.results.selection import BoardSettings
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.scoring.over_robots import MeanRatio

pytestmark = pytest.mark.slow


def written(folder: Path, worlds: tuple[str, ...], factor: float) -> MadeResults:
    """Write results of a model that is `factor` times the good one's error."""
    made = MadeResults(folder)
    for world in worlds:
        for number, ratio in enumerate(GOOD):
            ratios = {"good": ratio, "table": factor * ratio}
            made.add_robot(number, ratios, words=f"@world={world}")
    return made


def board_of(folder: Path) -> StudyLeaderboard:
    stored = StoredResults.read(folder / "board" / "runs")
    return StudyLeaderboard(stored, BoardSettings("holdout", fresh="fresh"))


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    written(folder / "board" / "runs", COMMON_WORLDS, 0.1)
    written(folder / "fresh" / "runs", (*COMMON_WORLDS, "unseen"), 1.5)
    return folder


def test_a_model_that_is_better_on_named_than_on_fresh_robots_has_a_flag(results):
    rows = {row["model"]: row for row in board_of(results).fresh.to_dict("records")}
    assert flag_of(rows["table"]) == FLAG and not flag_of(rows["good"])
    assert rows["table"]["change", "ratio"] == pytest.approx(1.5 / 0.1)
    assert rows["good"]["fresh", "ratio"] == pytest.approx(rows["good"]["named", "ratio"])
    assert rows["good"]["unseen", "ratio"] == pytest.approx(rows["good"]["fresh", "ratio"])


def test_the_table_of_fresh_robots_has_the_flag_only_if_a_model_has_it(results):
    frame = board_of(results).fresh
    (flagged,), (plain,) = fresh_tables(frame), fresh_tables(frame[frame["model"] != "table"])
    assert [len(table.columns) for table in (flagged, plain)] == [6, 5]


def test_a_board_without_results_on_fresh_robots_has_no_such_table(results, tmp_path):
    written(tmp_path / "board" / "runs", ("all",), 0.5)
    board = board_of(tmp_path)
    assert board.fresh is None
    assert not [table for table in board.tables if table.about.get("table") == "fresh"]


def test_a_submission_has_the_fresh_robots_of_its_own_verification(results, tmp_path):
    for side in ("board", "fresh"):
        written(tmp_path / side / "runs", (*COMMON_WORLDS, "unseen"), 1.0)
    file = tmp_path / "board" / FILE
    entry = {"fresh": [0.7, 0.6, 0.8], "worlds": {"unseen": 0.9}, "fresh_over_named": [2, 1.5, 3]}
    file.write_text(json.dumps({"table": entry, "gone": entry}))
    rows = {row["model"]: row for row in board_of(tmp_path).fresh.to_dict("records")}
    assert "gone" not in rows and flag_of(rows["table"]) == FLAG
    numbers = [rows["table"][of, "ratio"] for of in ("fresh", "unseen", "change")]
    assert numbers == [0.7, 0.9, 2.0]
    file.write_text("{")
    with pytest.raises(StoreError, match=FILE):
        _ = board_of(tmp_path).fresh


def test_the_interval_is_welch_s():
    rng = np.random.default_rng(0)
    logs = {
        n: pd.DataFrame({"a": rng.normal(size=n), "b": 0.1 * rng.normal(size=n)}) for n in (12, 7)
    }
    change = fresh_over_named("a", logs[7], logs[12])
    first, second = (frame["a"] - frame["b"] for frame in (logs[12], logs[7]))
    welch = stats.ttest_ind(first, second, equal_var=False).confidence_interval(0.95)
    assert np.log([change.low, change.high]) == pytest.approx([welch.low, welch.high])
    equal = pd.DataFrame({"a": [0.1, 0.2, 0.3], "b": [0.1, 0.2, 0.3]})
    assert fresh_over_named("a", equal, equal) == MeanRatio(1.0, 1.0, 1.0, 3)
