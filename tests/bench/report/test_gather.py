"""What the page says of a folder of results."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from helpers.made_results import TWINS, MadeResults, change
from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.selection import Selection
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.report import report_content as gather
from stiff_bench.report.first_screen import FIRST_COLUMNS
from stiff_bench.report.report_content import PageOptions
from stiff_bench.store.database import ResultStore, read_results
from stiff_protocols.contract.errors import StoreError

pytestmark = pytest.mark.usefixtures("no_figures")


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


def blocks_of(folder, metric="norm", axis=None, seed=0, **choice):
    asked = PageOptions(Selection(**choice), metric, axis, seed)
    key = sort_key(asked.metric, asked.axis)
    blocks = gather.blocks_of(StoredResults.read(folder), asked, key)
    return {block.heading: block for block in blocks}


def test_every_model_stands_in_ranks_pairs_and_scores(results):
    blocks = blocks_of(results.folder)
    ranks = blocks["Leaderboard"].tables[0]
    assert [row[0] for row in ranks.texts()] == ["vjm", "gp", "mlp"]
    (matrix,) = blocks["Pairs of models"].tables
    assert [row[0] for row in matrix.texts()] == ["1 vjm", "2 gp", "3 mlp"]
    (scores,) = blocks["Scores"].tables
    assert len(scores.rows) == 6
    assert [scores.heading(column) for column in scores.columns[:7]] == [
        *("model", "data set", "protocol", "condition", "seed", "splits", "3-D error [mm]"),
    ]
    assert scores.texts()[2][5:7] == ["2/2", "0.1500 ± 0.0707"]
    assert "made up, never measured" in blocks["Leaderboard"].tables[1].notes


def test_the_page_opens_with_the_answer_and_what_the_folder_holds(results):
    first, *_ = blocks_of(results.folder).values()
    counts, screen = first.heading, first.screen
    assert "3 models, 1 data set, 1 protocol, 12 fits, 0 failed" in counts
    assert "made up, never measured" in screen.notes
    assert {model.name for model in screen.models} == {"vjm", "gp", "mlp"}
    (part,) = screen.matrix
    assert part.groups == [("twin", 1)]  # specimens of a robot are one column
    errors = {name: cells[0].text for name, cells in part.rows}
    assert errors == {"vjm": "0.15", "gp": "0.16", "mlp": "0.40"}
    best = {name for name, cells in part.rows if cells[0].is_best}
    assert best == {"vjm"}


def test_a_chart_places_ratios_on_one_logarithmic_axis(results):
    first, *_ = blocks_of(results.folder).values()
    screen = first.screen
    place = {model.name: model.chart for model in screen.models}
    assert place["vjm"].dot == screen.reference_x  # the VJM's ratio is 1
    assert place["gp"].dot < place["mlp"].dot
    assert all(chart.low <= chart.dot <= chart.high for chart in place.values())
    x, labels = zip(*screen.ticks, strict=True)
    steps = [b - a for a, b in pairwise(x)]
    assert max(steps) - min(steps) < 0.2 and labels[x.index(screen.reference_x)].startswith("1")


def test_many_models_and_columns_are_one_click_away(tmp_path):
    made = MadeResults(tmp_path)
    for number in range(FIRST_COLUMNS + 2):
        made.add_each({"vjm": [0.1, 0.2], "gp": [0.2, 0.1]}, f"set-{number:02}")
    first, *_ = blocks_of(made.folder).values()
    assert [len(part.headings) for part in first.screen.matrix] == [FIRST_COLUMNS, 2]
    assert f"{FIRST_COLUMNS + 2} columns" in first.screen.more


def test_robots_and_data_have_a_row_a_data_set_and_hashes_are_provenance(results):
    blocks = blocks_of(results.folder)
    first, second = blocks["Robots and data"].tables[0].texts()
    assert first == [TWINS[0], "simulated", "kr10_r1100_2", "0.06, 0, 0.08", "12", "12"]
    assert second[:2] == [TWINS[1], "simulated"]
    hashes = blocks["Provenance"].tables[1].texts()
    assert [row[0] for row in hashes] == [*TWINS[:2]] and {len(row[1]) for row in hashes} == {64}


def test_identified_stiffnesses_stand_with_the_data(results):
    for result in [*read_results(results.folder)]:
        if result.shown.model == "vjm":
            springs = {"stiffness A1 [Nm/rad]": 1000.0 + 200.0 * result.cell.split_index}
            ResultStore(results.folder).write_cells([replace(result, diagnostics=springs)])
    _, stiffnesses = blocks_of(results.folder)["Robots and data"].tables
    assert [row[2] for row in stiffnesses.texts()] == ["1,100 ± 141"] * 2


def test_runs_stand_with_commit_command_and_results_also_of_one_without_a_manifest(results):
    results.add("vjm", [0.1, 0.2], "other", run_id="run-lost")
    provenance = blocks_of(results.folder)["Provenance"]
    row, lost = provenance.tables[0].texts()
    assert row[0] == "run-1"
    assert {"9.9", "0123456789ab", "finished"} <= set(row)
    assert (lost[0], lost[5]) == ("a run without a manifest", "2")
    assert provenance.folds[0][1] == "bench run"
    assert "commit: 0123456789abcdef" in provenance.folds[1][1]


def test_failures_stand_with_reason_cause_and_log_and_alike_ones_together(results):
    keys = results.add("bad", [0.1], TWINS[0], failed=(1, 2))
    for key in keys[1:]:
        store = ResultStore(results.folder)
        (failed,) = (one for one in read_results(results.folder, {key}))
        store.write_cells([replace(failed, cause="ValueError", log=("first", "last <b>"))])
    block = blocks_of(results.folder)["Failed and skipped"]
    (row,) = block.tables[0].texts()
    assert row == ["bad", "failed", "it broke", "ValueError", TWINS[0], "holdout", "-", "1, 2"]
    assert [text for _, text in block.folds] == ["first\nlast <b>"] * 2


def test_what_cannot_be_ranked_has_scores_and_a_reason(results):
    """One model alone, or samples that are missing."""
    blocks = blocks_of(results.folder, models=("vjm",))
    first, *_ = blocks.values()
    assert [model.name for model in first.screen.models] == ["vjm"]
    assert "Leaderboard" not in blocks and "Pairs of models" not in blocks
    assert len(blocks["Scores"].tables[0].rows) == 2
    change(results.folder, "DELETE FROM data")
    blocks = blocks_of(results.folder)
    first, *_ = blocks.values()
    assert first.screen is None and first.texts[0].startswith("No answer: ")
    assert "Leaderboard" not in blocks
    assert len(blocks["Scores"].tables[0].rows) == 6


def test_choices_narrow_everything_and_stand_in_the_commands(results):
    blocks = blocks_of(
        results.folder, models=("vjm", "mlp"), datasets=(TWINS[1],), metric="mae", axis="z"
    )
    assert len(blocks["Scores"].tables[0].rows) == 2
    ranks = blocks["Leaderboard"]
    assert ranks.command == (
        f"bench leaderboard --results {results.folder} --model vjm --model mlp --dataset "
        f"{TWINS[1]} --metric mae --axis z"
    )


@pytest.mark.parametrize("error", [StoreError("no curves"), ZeroDivisionError(), ValueError()])
def test_a_figure_that_cannot_be_drawn_is_left_out(results, monkeypatch, error):
    def broken(source):
        raise error

    def whole(source):
        from matplotlib.figure import Figure

        return Prepared("drawn", "of nothing", Figure)

    figures = {"losses": broken, "springs": whole, "errors": whole}
    monkeypatch.setattr(gather, "FIGURES", figures)
    pictures = blocks_of(results.folder)["Figures"].pictures
    general, *by_data = pictures
    assert general.dataset == "" and "bench figure springs " in general.command
    assert [picture.dataset for picture in by_data] == [*TWINS[:2]]
    assert all("bench figure errors " in one.command for one in by_data)
    assert all(f"--dataset {one.dataset}" in one.command for one in by_data)


def test_measured_data_come_first_and_few_comparisons_have_figures_of_their_own(
    tmp_path, monkeypatch
):
    from matplotlib.figure import Figure

    made = MadeResults(tmp_path)
    for number in range(gather.MOST_CASES + 3):
        made.add("vjm", [0.1], f"set-{number:02}")
    made.add("vjm", [0.1], "own", kind="measured")
    monkeypatch.setattr(gather, "FIGURES", {"errors": lambda _: Prepared("t", "c", Figure)})
    shown = [picture.dataset for picture in blocks_of(made.folder)["Figures"].pictures]
    assert shown[0] == "own" and len(shown) == gather.MOST_CASES


def test_protocols_that_select_on_test_stand_apart(results):
    for model in ("vjm", "mlp"):
        results.add(model, [0.1, 0.2], protocol="paper", selects_on_test=True, warning="not fair")
    blocks = blocks_of(results.folder)
    assert "not fair" in blocks["Leaderboard (epoch picked on test part)"].tables[0].notes
    assert "Pairs of models (epoch picked on test part)" in blocks
    assert "not fair" not in blocks["Leaderboard"].tables[0].notes
