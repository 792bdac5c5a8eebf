"""Content of the report of folders of results, and its command."""

from __future__ import annotations

from dataclasses import replace

import pytest

import stiffbench as sb
from helpers.compared_results import fifths, spread, steady, store_results, task_in
from helpers.made_results import TWINS, MadeResults, change
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.page import report
from stiff_bench.page.report import PageOptions, folder_section, pair_table
from stiff_bench.results.comparison import compare
from stiff_bench.results.leaderboard import build_leaderboard
from stiff_bench.results.load import StoredResults
from stiff_bench.results.scored_task import sort_key
from stiff_bench.results.selection import Selection
from stiff_bench.results.significance import Question
from stiff_bench.store.database import ResultStore, read_results
from stiff_protocols.contract.errors import ConfigError, StoreError

pytestmark = pytest.mark.usefixtures("no_figures")
MODELS = {
    "good": spread(1e-5, 2e-6, seed=1),
    "bad": spread(5e-4, 1e-4, seed=2),
    "nearly": steady(1.0e-5, 1.1e-5, 1.2e-5, 1.1e-5, 1.0e-5),
}
WON = {"a": "1 : 0", "b": "0 : 1", "equivalent": "0 : 0", "open": "0 : 0"}


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


def section_of(folder, metric="norm", axis=None, seed=0, **choice):
    options = PageOptions(Selection(**choice), metric, axis, seed)
    key = sort_key(options.metric, options.axis)
    return folder_section(StoredResults.read(folder), options, key)


def parts_of(folder, **choice):
    return {part.heading: part for part in section_of(folder, **choice).sections}


def test_the_page_opens_with_facts_the_answer_the_models_and_the_matrix(results):
    section = section_of(results.folder)
    assert section.about.startswith(
        "runs-of-today · now · 3 models, 2 data sets, 1 protocol, 12 fits, 0 failed · 2 simulated"
    )
    assert section.heading and section.texts and not section.notes
    models, matrix = section.tables
    assert [str(row[0]) for row in models.rows] == ["vjm", "gp", "mlp"]
    (number,) = (n for n, column in enumerate(models.columns) if column.is_chart)
    charts = [row[number] for row in models.rows]
    assert charts[0].ratio == pytest.approx(1.0)
    assert all(cell.low <= cell.ratio <= cell.high for cell in charts)
    ratios = {str(name): cell.ratio for name, cell in matrix.rows}  # one column of specimens
    assert ratios["mlp"] == pytest.approx(charts[2].ratio) and ratios["vjm"] == pytest.approx(1.0)


def test_every_model_is_in_ranks_pairs_and_scores(results):
    parts = parts_of(results.folder)
    assert parts["Notes on the data"].notes == ["made up, never measured"]
    assert [row[0] for row in parts["Leaderboard"].tables[0].texts()] == ["vjm", "gp", "mlp"]
    (pairs,) = parts["Pairs of models"].tables
    assert [row[0] for row in pairs.texts()] == ["1 vjm", "2 gp", "3 mlp"]
    (scores,) = parts["Scores"].tables
    rows = {tuple(row[:2]): row for row in scores.texts()}
    assert len(rows) == 6
    assert rows["vjm", TWINS[0]][5:7] == ["2/2", "0.1500 ± 0.0707"]
    data = {row[0]: row for row in parts["Robots and data"].tables[0].texts()}
    assert data[TWINS[0]][1:6] == ["simulated", "kr10_r1100_2", "0.06, 0, 0.08", "12", "12"]
    assert {len(row[-1]) for row in data.values()} == {64}


def test_details_are_folded_and_failures_are_mentioned_only_if_there_are_some(results):
    parts = parts_of(results.folder)
    assert all(part.is_folded for part in parts.values())
    assert "Failed and skipped" not in parts


def test_identified_stiffnesses_are_listed_with_the_data(results):
    for result in [*read_results(results.folder)]:
        if result.presentation.model == "vjm":
            springs = {"stiffness A1 [Nm/rad]": 1000.0 + 200.0 * result.cell.split_index}
            ResultStore(results.folder).write_cells([replace(result, diagnostics=springs)])
    _, stiffnesses = parts_of(results.folder)["Robots and data"].tables
    assert [row[3:] for row in stiffnesses.texts()] == [["A1 [Nm/rad]", "1,100 ± 141"]] * 2


def test_runs_are_listed_with_commit_command_and_results_even_without_a_manifest(results):
    results.add("vjm", [0.1, 0.2], "other", run_id="run-lost")
    provenance = parts_of(results.folder)["Provenance"]
    row, lost = provenance.tables[0].texts()
    assert row[0] == "run-1" and {"bench run", "finished"} <= set(row)
    assert "stiffbench 9.9 at 01234567" in row[-1]
    assert (lost[0], lost[-2]) == ("a run without a manifest", "2")
    assert "commit: 0123456789abcdef" in provenance.sections[0].log


def test_failures_are_listed_with_reason_cause_and_log_and_equal_failures_together(results):
    keys = results.add("bad", [0.1], TWINS[0], failed=(1, 2))
    for key in keys[1:]:
        store = ResultStore(results.folder)
        (failed,) = (result for result in read_results(results.folder, {key}))
        store.write_cells([replace(failed, cause="ValueError", log=("first", "last <b>"))])
    part = parts_of(results.folder)["Failed and skipped"]
    (row,) = part.tables[0].texts()
    assert row == ["bad", TWINS[0], "holdout", "-", "it broke", "ValueError", "1, 2"]
    assert [log.log for log in part.sections] == ["first\nlast <b>"]


def test_skipped_fits_are_one_line_per_reason(results):
    for model in ("realmlp", "tabm"):
        for key in results.add(model, failed=(0, 1)):
            (failed,) = read_results(results.folder, {key})
            reason = {"status": "skipped", "failure": "needs the package pytabkit"}
            ResultStore(results.folder).write_cells([replace(failed, **reason)])
    part = parts_of(results.folder)["Failed and skipped"]
    (line,) = part.notes
    assert "realmlp, tabm (4 fits)" in line and "pytabkit" in line
    assert not part.tables


def test_what_cannot_be_ranked_has_scores_and_a_reason(results):
    """A single model is compared with the VJM; missing samples prevent an answer."""
    section = section_of(results.folder, models=("mlp",))
    assert "nothing to compare" in section.notes[0]
    assert [str(row[0]) for row in section.tables[0].rows] == ["vjm", "mlp"]
    change(results.folder, "DELETE FROM data")
    section = section_of(results.folder)
    assert not section.tables and section.notes[0].startswith("No summary: ")
    parts = {part.heading: part for part in section.sections}
    assert "Leaderboard" not in parts and "Pairs of models" not in parts
    assert len(parts["Scores"].tables[0].rows) == 6


def test_choices_narrow_everything_and_are_part_of_the_commands(results):
    parts = parts_of(
        results.folder, models=("vjm", "mlp"), datasets=(TWINS[1],), metric="mae", axis="z"
    )
    assert len(parts["Scores"].tables[0].rows) == 2
    assert parts["Leaderboard"].command == (
        f"bench leaderboard --results {results.folder} --model vjm --model mlp --dataset "
        f"{TWINS[1]} --metric mae --axis z"
    )


def test_figures_are_of_all_results_or_of_one_comparison_and_broken_ones_are_left_out(
    results, monkeypatch
):
    drawn = []

    def figure(source):
        from matplotlib.figure import Figure

        drawn.append([task.name.dataset for task in source.tasks])
        return Prepared("drawn", "of something", Figure)

    def broken(source):
        raise StoreError("no curves")

    figures = {"losses": broken, "scores": figure, "errors": figure}
    monkeypatch.setattr(report, "FIGURES", figures)
    results.add("vjm", [0.1, 0.2], "other")
    part = parts_of(results.folder)["Figures"]
    assert sorted(drawn, key=len) == [[TWINS[0]], ["other"], [*TWINS[:2], "other"]]
    assert [figure.title for figure in part.figures] == ["drawn"]
    assert "bench figure scores " in part.figures[0].command
    (_, of_other) = part.sections
    assert "--dataset other --protocol holdout" in of_other.figures[0].command
    monkeypatch.setattr(report, "MOST_TASKS", 1)
    part = parts_of(results.folder)["Figures"]
    assert len(part.sections) == 1 and "first 1 of 2" in part.notes[0]


@pytest.mark.parametrize(("n_splits", "options"), [(5, {}), (1, {}), (5, {"pooled": True})])
def test_every_pair_has_the_verdict_that_compare_has_among_all_and_its_mirror_image(
    tmp_path, n_splits, options
):
    folder = store_results(tmp_path, MODELS, tests=fifths(5)[:n_splits], **options)
    task, data = task_in(folder)
    board = build_leaderboard(StoredResults.read(folder), sort_key("norm", None))
    table = pair_table(board.scores)
    names = [row[0].split()[1] for row in table.texts()]
    cells = {row[0].split()[1]: dict(zip(names, row[1:], strict=True)) for row in table.texts()}
    for a in MODELS:
        for b in MODELS:
            verdict = "-" if a == b else WON[compare(task, a, b, data, Question()).among_all]
            assert cells[a][b] == verdict
    if n_splits > 1:  # five poses cannot show a difference among that number of pairs
        assert cells["good"]["bad"] == "1 : 0"


def test_several_folders_are_parts_of_one_page_and_each_has_every_model_named(results, tmp_path):
    second_results, page = MadeResults(tmp_path / "others"), tmp_path / "page.html"
    second_results.add("gp", [0.1])
    folders = [sb.open_results(folder) for folder in (results.folder, second_results.folder)]
    sb.report(page, folders)
    text = page.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>") and text.count("<h2") == 2
    with pytest.raises(ConfigError, match="'vjm'"):
        sb.report(page, [folder.select(models=["vjm"]) for folder in folders])
