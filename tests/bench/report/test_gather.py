"""What the page says of a folder of results."""

from __future__ import annotations

from dataclasses import replace

import pytest

from made_results import TWINS, MadeResults, change
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.analysis.stored_leaderboard import StoredResults
from stiff_bench.report import pairs as pair_tables
from stiff_bench.report import report as gather
from stiff_bench.report import runs as failures
from stiff_bench.report.content import Block
from stiff_bench.report.runs import Selection
from stiff_bench.store.database import ResultStore, stored_results
from stiff_protocols.contract.errors import StoreError


@pytest.fixture(autouse=True)
def no_figures(monkeypatch):
    """They take seconds; the browser's test has them."""
    monkeypatch.setattr(gather, "picture_block", lambda *_: Block("Figures"))


@pytest.fixture()
def results(tmp_path):
    made = MadeResults(tmp_path / "runs-of-today")
    keys = [
        key
        for twin in TWINS[:2]
        for model, errors in (("vjm", [0.1, 0.2]), ("mlp", [0.3, 0.5]), ("gp", [0.1, 0.21]))
        for key in made.add(model, errors, twin, caveats=("made up, never measured",))
    ]
    made.add_run("run-1", keys)
    return made


def blocks_of(folder, **choice):
    asked = Selection(**choice)
    part = gather.part_of(StoredResults.read(folder), asked, sort_key(asked.metric, asked.axis))
    return {block.heading: block for block in part.blocks}


def texts(table):
    return [[cell.text for cell in row] for row in table.rows]


def test_every_model_stands_in_ranks_pairs_and_scores(results):
    blocks = blocks_of(results.folder)
    ranks = blocks["Leaderboard"].tables[0]
    assert [row[0] for row in texts(ranks)] == ["vjm", "gp", "mlp"]
    matrix, pairs = blocks["Pairwise comparisons"].tables
    assert [row[0] for row in texts(matrix)] == ["1 vjm", "2 gp", "3 mlp"]
    assert len(pairs.rows) == 3
    (scores,) = blocks["Scores in each contest"].tables
    assert len(scores.rows) == 6
    assert scores.header[:7] == (
        *("model", "data set", "protocol", "condition", "seed", "splits", "norm [mm]"),
    )
    assert texts(scores)[2][5:7] == ["2/2", "0.1500 ± 0.0707"]


def test_caveats_stand_at_the_top_and_with_every_ranking(results):
    blocks = blocks_of(results.folder)
    assert "made up, never measured" in blocks["Read this first"].notes
    assert "made up, never measured" in blocks["Leaderboard"].tables[0].notes
    assert "made up, never measured" in blocks["Pairwise comparisons"].notes
    assert (
        "12 results of 3 models in 2 contests; 0 cells failed" in blocks["Read this first"].texts[0]
    )


def test_runs_stand_with_their_commit_and_command(results):
    provenance = blocks_of(results.folder)["Provenance"]
    (row,) = texts(provenance.tables[0])
    assert row[0] == "run-1"
    assert {"9.9", "0123456789ab", "finished"} <= set(row)
    assert provenance.folds[0].text == "bench run"
    assert "commit: 0123456789abcdef" in provenance.folds[1].text


def test_results_of_a_run_without_a_manifest_are_counted(results):
    results.add("vjm", [0.1, 0.2], "other", run_id="run-lost")
    rows = texts(blocks_of(results.folder)["Provenance"].tables[0])
    assert [row[0] for row in rows] == ["run-1", "a run without a manifest"]
    assert rows[1][5] == "2"


def test_failures_stand_with_reason_cause_and_log_and_alike_ones_together(results):
    keys = results.add("bad", [0.1], TWINS[0], failed=(1, 2))
    for key in keys[1:]:
        store = ResultStore(results.folder)
        (failed,) = (one for one in stored_results(results.folder, {key}))
        store.write_cell(replace(failed, cause="ValueError", log=("first", "last <b>")))
    block = blocks_of(results.folder)["Failures and skipped cells"]
    (row,) = texts(block.tables[0])
    assert row == ["bad", "failed", "it broke", "ValueError", TWINS[0], "holdout", "-", "1, 2"]
    assert [fold.text for fold in block.folds] == ["first\nlast <b>"] * 2


@pytest.mark.parametrize("change", ["options", "version", "source"])
def test_a_failure_that_a_newer_run_repeats_counts_once(results, change):
    old, new = {
        "options": ({"options": {"steps": 10}}, {"options": {"steps": 20}}),
        "version": ({"version": 0}, {"version": 1}),
        "source": ({"source": "old"}, {"source": "new"}),
    }[change]
    first = results.add("bad", failed=(0,), dataset="other", run_id="run-2", **old)
    results.add_run("run-2", first)
    again = results.add("bad", failed=(0,), dataset="other", run_id="run-3", **new)
    results.add_run("run-3", again)
    blocks = blocks_of(results.folder)
    n_places = 1 if change == "options" else 2  # other data are another contest
    said = f"{n_places} cell{'s' * (n_places > 1)}"
    assert f"; {said} failed, 0 cells skipped." in blocks["Read this first"].texts[0]
    (table,) = blocks["Failures and skipped cells"].tables
    assert table.caption == f"{said} without a result"
    assert len(table.rows) == n_places


def test_a_failure_on_old_data_is_not_hidden_by_a_result_on_new_data(results):
    results.add("bad", failed=(0,), dataset="other", version=0)
    results.add("bad", [0.1], dataset="other", version=1)
    blocks = blocks_of(results.folder)
    assert "; 1 cell failed, 0 cells skipped." in blocks["Read this first"].texts[0]
    assert len(blocks["Failures and skipped cells"].tables[0].rows) == 1


def test_missing_samples_cost_what_needs_them_and_nothing_else(results):
    change(results.folder, "DELETE FROM data")
    blocks = blocks_of(results.folder)
    assert "No ranks: " in blocks["Leaderboard"].texts[0]
    assert "holds no data set" in blocks["Leaderboard"].texts[0]
    assert len(blocks["Scores in each contest"].tables[0].rows) == 6


def test_pairs_whose_samples_cannot_be_read_leave_the_ranks(results, monkeypatch):
    def refuse(folder, sha256):
        raise StoreError(f"{folder / sha256}.npz: cannot be read")

    monkeypatch.setattr(gather, "read_data", refuse)
    blocks = blocks_of(results.folder)
    assert len(blocks["Leaderboard"].tables[0].rows) == 3
    (said,) = blocks["Pairwise comparisons"].texts
    assert said.startswith("No comparisons: ")
    assert said.endswith(".npz: cannot be read.")


def test_many_failures_are_cut_and_said(results, monkeypatch):
    monkeypatch.setattr(failures, "MOST_FAILURES", 1)
    for model in ("bad", "worse"):
        results.add(model, [], TWINS[0], failed=(0,))
    block = blocks_of(results.folder)["Failures and skipped cells"]
    assert len(block.tables[0].rows) == 1
    assert "The first 1 of 2 rows are shown." in block.tables[0].notes


def test_one_model_alone_has_scores_and_no_ranks(results):
    blocks = blocks_of(results.folder, models=("vjm",))
    assert "nothing to rank" in blocks["Leaderboard"].texts[0]
    assert "Pairwise comparisons" not in blocks
    assert len(blocks["Scores in each contest"].tables[0].rows) == 2


def test_choices_narrow_everything_and_stand_in_the_commands(results):
    blocks = blocks_of(
        results.folder, models=("vjm", "mlp"), datasets=(TWINS[1],), metric="mae", axis="z"
    )
    assert len(blocks["Scores in each contest"].tables[0].rows) == 2
    ranks = blocks["Leaderboard"].tables[0]
    assert ranks.command == (
        f"bench leaderboard --results {results.folder} --model vjm --model mlp --dataset "
        f"{TWINS[1]} --metric mae --axis z"
    )


def test_contests_beyond_the_bound_on_pairs_are_left_out_and_said(results, monkeypatch):
    monkeypatch.setattr(pair_tables, "MOST_PAIRS", 4)
    block = blocks_of(results.folder)["Pairwise comparisons"]
    assert {row[3] for row in texts(block.tables[1])} == {"1"}
    assert any("1 contest of 2 not compared" in note for note in block.notes)


def test_models_beyond_the_bound_on_pairs_are_left_out_and_said(results, monkeypatch):
    monkeypatch.setattr(pair_tables, "MOST_MODELS", 2)
    block = blocks_of(results.folder)["Pairwise comparisons"]
    assert len(block.tables[1].rows) == 1
    assert any("first 2 of 3 models" in note for note in block.notes)


def test_protocols_that_select_on_test_stand_apart(results):
    for model in ("vjm", "mlp"):
        results.add(model, [0.1, 0.2], protocol="paper", selects_on_test=True, warning="not fair")
    blocks = blocks_of(results.folder)
    assert "not fair" in blocks["Leaderboard (epoch picked on test part)"].tables[0].notes
    assert "not fair" in blocks["Pairwise comparisons (epoch picked on test part)"].notes
    assert "not fair" not in blocks["Leaderboard"].tables[0].notes
