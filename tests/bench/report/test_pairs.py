"""A pair of models has one verdict everywhere, corrected for all pairs."""

from __future__ import annotations

import pytest

from helpers.compared_results import case_in, fifths, spread, steady, store_results
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.comparison import compare
from stiff_bench.analysis.leaderboard import build_leaderboard
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.analysis.verdict import Question
from stiff_bench.report.html_page import page_table
from stiff_bench.report.model_pairs import pair_table

MODELS = {
    "good": spread(1e-5, 2e-6, seed=1),
    "bad": spread(5e-4, 1e-4, seed=2),
    "alike": spread(5e-4, 1e-4, seed=3),
    "nearly": steady(1.0e-5, 1.1e-5, 1.2e-5, 1.1e-5, 1.0e-5),
}
WON = {"a": "1 : 0", "b": "0 : 1", "equivalent": "0 : 0", "open": "0 : 0"}


def pairs_of(folder):
    """Return row -> column -> cell of the table, and the page's table."""
    board = build_leaderboard(StoredResults.read(folder), sort_key("norm", None))
    table = pair_table(board.sections[0], board)
    names = [row[0].split()[1] for row in table.texts()]
    rows = zip(names, table.texts(), strict=True)
    return {name: dict(zip(names, row[1:], strict=True)) for name, row in rows}, page_table(table)


@pytest.mark.parametrize(
    ("n_splits", "options"),
    [(5, {}), (1, {}), (5, {"pooled": True})],
    ids=["splits", "one", "pooled"],
)
def test_every_pair_has_the_verdict_that_compare_has_among_all_and_its_mirror_image(
    tmp_path, n_splits, options
):
    tests = fifths(5)[:n_splits]
    folder = store_results(tmp_path, MODELS, tests=tests, **options)
    case, data = case_in(folder)
    cells, page = pairs_of(folder)
    for a in MODELS:
        for b in MODELS:
            if a != b:
                verdict = compare(case, a, b, data, Question()).among_all
                assert cells[a][b] == WON[verdict]
    assert cells["good"]["good"] == "-"
    if n_splits == 1:  # five poses cannot show a difference among that number of pairs
        return
    assert cells["good"]["bad"] == "1 : 0"
    styles = {style for row in page["rows"] for _, _, style in row[1:]}
    assert {"number better", "number worse"} <= styles


def test_a_model_without_a_result_has_no_pairs(tmp_path):
    cells, _ = pairs_of(store_results(tmp_path, MODELS, failed={"bad": range(5)}))
    assert set(cells) - {"vjm"} == MODELS.keys() - {"bad"}
