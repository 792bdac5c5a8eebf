"""All pairs of a contest say what `bench compare` says of each."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from compared_results import contest_in, fifths, spread, steady, store_results
from stiff_bench.analysis.comparison import NORM, compare
from stiff_bench.analysis.verdict import Question
from stiff_bench.report import pairs as pair_tables
from stiff_bench.report.pairs import compared_pairs, n_pairs

MODELS = {
    "good": spread(1e-5, 2e-6, seed=1),
    "bad": spread(5e-4, 1e-4, seed=2),
    "alike": spread(5e-4, 1e-4, seed=3),
    "nearly": steady(1.0e-5, 1.1e-5, 1.2e-5, 1.1e-5, 1.0e-5),
}


@pytest.mark.parametrize(
    ("n_splits", "shown"),
    [(5, {}), (1, {}), (5, {"pooled": True})],
    ids=["splits", "one", "pooled"],
)
def test_every_pair_has_the_verdict_and_the_numbers_of_compare(tmp_path, n_splits, shown):
    tests = fifths(5)[:n_splits]
    contest, data = contest_in(store_results(tmp_path, MODELS, tests=tests, **shown))
    found = list(compared_pairs(contest, list(MODELS), data, Question()))
    assert [(pair.a, pair.b) for pair in found] == list(combinations(MODELS, 2))
    verdicts = set()
    for pair in found:
        row = compare(contest, pair.a, pair.b, data, Question()).row(NORM)
        assert pair.verdict == row.verdict
        assert pair.p_value == pytest.approx(row.main.p_value)
        assert pair.difference == pytest.approx(row.difference)
        assert pair.of_fits == (row.over_splits is None)
        verdicts.add(pair.verdict)
    assert {"a", "equivalent"} <= verdicts


def test_a_pair_is_compared_on_the_splits_that_both_have(tmp_path):
    folder = store_results(tmp_path, MODELS, failed={"bad": (0, 3)})
    contest, data = contest_in(folder)
    n_splits = {
        (pair.a, pair.b): pair.n_splits
        for pair in compared_pairs(contest, list(MODELS), data, Question())
    }
    assert n_splits["good", "bad"] == 3
    assert n_splits["good", "alike"] == 5


def test_a_model_without_a_result_has_no_pairs(tmp_path):
    folder = store_results(tmp_path, MODELS, failed={"bad": range(5)})
    contest, data = contest_in(folder)
    found = list(compared_pairs(contest, ["good", "bad", "unknown"], data, Question()))
    assert found == []


def test_one_pose_alone_gives_no_pair(tmp_path):
    contest, data = contest_in(store_results(tmp_path, MODELS, tests=[np.array([3])]))
    assert list(compared_pairs(contest, list(MODELS), data, Question())) == []


def test_the_number_of_pairs_counts_the_models_that_were_run(tmp_path):
    contest, _ = contest_in(store_results(tmp_path, MODELS))
    assert n_pairs(contest, ["good", "bad", "alike", "unknown"]) == 3


def test_pairs_mirror_each_other_in_the_matrix(tmp_path):
    contest, data = contest_in(store_results(tmp_path, MODELS))
    pairs = list(compared_pairs(contest, ["good", "bad"], data, Question()))
    two = [*pairs, *(replace(pair, verdict="open") for pair in pairs)]
    table = pair_tables._matrix(two, ["good", "bad"], ["good", "bad"])
    cells = [[cell.text for cell in row] for row in table.rows]
    assert cells == [["1 good", "", "1 : 0"], ["2 bad", "0 : 1", ""]]
    assert (table.rows[0][2].tone, table.rows[1][1].tone) == ("better", "worse")
