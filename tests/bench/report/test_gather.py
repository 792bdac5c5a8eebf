"""Content of the page of a folder of results."""

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


def part_of(folder, metric="norm", axis=None, seed=0, **choice):
    options = PageOptions(Selection(**choice), metric, axis, seed)
    key = sort_key(options.metric, options.axis)
    return gather.part_of(StoredResults.read(folder), options, key)


def blocks_of(folder, **choice):
    return {block.heading: block for block in part_of(folder, **choice).blocks}


def test_every_model_is_in_ranks_pairs_and_scores(results):
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


def test_the_page_opens_with_numbers_and_notes_and_the_answer(results):
    part = part_of(results.folder)
    assert part.facts == "runs-of-today · now · 3 models, 1 data set, 1 protocol, 12 fits, 0 failed"
    assert part.notes == ["made up, never measured"]
    assert part.answer and not part.reason
    (data,) = (block for block in part.blocks if block.heading == "Robots and data")
    first, second = data.tables[0].texts()
    tcp = "0.06, 0, 0.08"
    assert first == [TWINS[0], "simulated", "kr10_r1100_2", tcp, "12", "12"]
    assert second[:2] == [TWINS[1], "simulated"]


def test_the_first_screen_has_each_model_and_one_column_for_specimens_of_a_robot(results):
    screen = part_of(results.folder).answer
    assert [row.name for row in screen.models] == ["vjm", "gp", "mlp"]
    (part,) = screen.matrix
    assert part.datasets == [("twin", 1)] and part.conditions == []
    errors = {name: cells[0].text for name, cells in part.rows}
    assert errors == {"vjm": "0.15", "gp": "0.16", "mlp": "0.40"}
    assert [name for name, cells in part.rows if cells[0].is_best] == ["vjm"]
    assert [cells[0].style for _, cells in part.rows] == ["same", "same", "more-4"]


def test_a_chart_places_ratios_on_one_logarithmic_axis(results):
    screen = part_of(results.folder).answer
    place = {model.name: model.chart for model in screen.models}
    assert (place["vjm"].dot, "1x") in screen.ticks  # the VJM's ratio is 1
    assert place["gp"].dot < place["mlp"].dot
    assert all(chart.low <= chart.dot <= chart.high for chart in place.values())
    steps = [after - before for (before, _), (after, _) in pairwise(screen.ticks)]
    assert max(steps) - min(steps) < 0.2


def test_the_matrix_has_headings_in_levels_and_digits_enough_for_small_errors(tmp_path):
    made = MadeResults(tmp_path)
    for protocol, condition in (("holdout", ""), ("loads", "heavier"), ("loads", "other way")):
        made.add_each({"vjm": [0.1], "gp": [0.004]}, "set", protocol, condition=condition)
    (part,) = part_of(made.folder).answer.matrix
    assert (part.datasets, part.protocols) == ([("set", 3)], [("holdout", 1), ("loads", 2)])
    assert part.conditions == ["", "heavier", "other way"]
    errors = {name: cells[0].text for name, cells in part.rows}
    assert float(errors["gp"]) > 0.0 and len(errors["gp"]) > len("0.00")


def test_many_models_and_columns_are_one_click_away(tmp_path):
    made = MadeResults(tmp_path)
    for number in range(FIRST_COLUMNS + 2):
        made.add_each({"vjm": [0.1, 0.2], "gp": [0.2, 0.1]}, f"set-{number:02}")
    screen = part_of(made.folder).answer
    assert [len(part.labels) for part in screen.matrix] == [FIRST_COLUMNS, 2]
    assert f"{FIRST_COLUMNS + 2} columns" in screen.more


def test_identified_stiffnesses_are_listed_with_the_data(results):
    for result in [*read_results(results.folder)]:
        if result.presentation.model == "vjm":
            springs = {"stiffness A1 [Nm/rad]": 1000.0 + 200.0 * result.cell.split_index}
            ResultStore(results.folder).write_cells([replace(result, diagnostics=springs)])
    _, stiffnesses = blocks_of(results.folder)["Robots and data"].tables
    assert "kr10_r1100_2" in stiffnesses.title
    assert [row[2] for row in stiffnesses.texts()] == ["1,100 ± 141"] * 2


def test_runs_are_listed_with_commit_command_and_results_even_without_a_manifest(results):
    results.add("vjm", [0.1, 0.2], "other", run_id="run-lost")
    provenance = blocks_of(results.folder)["Provenance"]
    row, lost = provenance.tables[0].texts()
    assert row[0] == "run-1"
    assert {"9.9", "0123456789ab", "finished"} <= set(row)
    assert (lost[0], lost[5]) == ("a run without a manifest", "2")
    assert provenance.folds[0][1] == "bench run"
    assert "commit: 0123456789abcdef" in provenance.folds[1][1]
    assert {len(row[1]) for row in provenance.tables[1].texts()} == {64}


def test_failures_are_listed_with_reason_cause_and_log_and_equal_failures_together(results):
    keys = results.add("bad", [0.1], TWINS[0], failed=(1, 2))
    for key in keys[1:]:
        store = ResultStore(results.folder)
        (failed,) = (result for result in read_results(results.folder, {key}))
        store.write_cells([replace(failed, cause="ValueError", log=("first", "last <b>"))])
    block = blocks_of(results.folder)["Failed and skipped"]
    (row,) = block.tables[0].texts()
    assert row == ["bad", "failed", "it broke", "ValueError", TWINS[0], "holdout", "-", "1, 2"]
    assert [text for _, text in block.folds] == ["first\nlast <b>"] * 2


def test_details_are_folded_and_failures_are_mentioned_only_if_there_are_some(results):
    blocks = blocks_of(results.folder)
    folded = [heading for heading, block in blocks.items() if block.is_detail]
    assert folded == ["Robots and data", "Leaderboard", "Pairs of models", "Scores", "Provenance"]
    assert "Failed and skipped" not in blocks


def test_what_cannot_be_ranked_has_scores_and_a_reason(results):
    """A single model is compared with the VJM; missing samples prevent an answer."""
    part = part_of(results.folder, models=("mlp",))
    assert "nothing to compare" in part.reason
    assert [row.name for row in part.answer.models] == ["vjm", "mlp"]
    change(results.folder, "DELETE FROM data")
    part = part_of(results.folder)
    assert part.answer is None and part.reason.startswith("No answer: ")
    blocks = {block.heading: block for block in part.blocks}
    assert "Leaderboard" not in blocks and "Pairs of models" not in blocks
    assert len(blocks["Scores"].tables[0].rows) == 6


def test_choices_narrow_everything_and_are_part_of_the_commands(results):
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

    def drawn_figure(source):
        from matplotlib.figure import Figure

        return Prepared("drawn", "of nothing", Figure)

    figures = {"losses": broken, "springs": drawn_figure, "scores": drawn_figure}
    monkeypatch.setattr(gather, "FIGURES", figures)
    (first, second) = blocks_of(results.folder)["Figures"].pictures
    assert first.title == "drawn" and "bench figure springs " in first.command
    assert "bench figure scores " in second.command


def test_some_figures_are_drawn_for_each_data_set_and_protocol(results, monkeypatch):
    from matplotlib.figure import Figure

    drawn = []

    def of_cases(source):
        drawn.append([case.name.dataset for case in source.cases])
        return Prepared("drawn", "of something", Figure)

    monkeypatch.setattr(gather, "FIGURES", {"scores": of_cases, "errors": of_cases})
    results.add("vjm", [0.1, 0.2], "other")
    block = blocks_of(results.folder)["Figures"]
    assert drawn == [[*TWINS[:2], "other"], [TWINS[0]], ["other"]]
    assert block.choices == {"data set": ["twin", "other"], "protocol": ["holdout"]}
    assert "--dataset other --protocol holdout" in block.pictures[2].command
    monkeypatch.setattr(gather, "MOST_CASES", 1)
    block = blocks_of(results.folder)["Figures"]
    assert len(block.pictures) == 2 and "first 1 of 2" in block.notes[0]


def test_protocols_that_select_on_test_have_their_own_table(results):
    for model in ("vjm", "mlp"):
        results.add(model, [0.1, 0.2], protocol="paper", selects_on_test=True, warning="not fair")
    blocks = blocks_of(results.folder)
    assert "not fair" in blocks["Leaderboard (epoch picked on test part)"].tables[0].notes
    assert "Pairs of models (epoch picked on test part)" in blocks
    assert "not fair" not in blocks["Leaderboard"].tables[0].notes


def test_skipped_fits_are_one_line_per_reason(results):
    for model in ("realmlp", "tabm"):
        for key in results.add(model, failed=(0, 1)):
            (failed,) = read_results(results.folder, {key})
            reason = {"status": "skipped", "failure": "needs the package pytabkit"}
            ResultStore(results.folder).write_cells([replace(failed, **reason)])
    block = blocks_of(results.folder)["Failed and skipped"]
    (line,) = block.texts
    assert "realmlp, tabm (4 fits)" in line and "pytabkit" in line
    assert not block.tables
