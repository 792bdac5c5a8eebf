"""Content of the report of folders of results, and its command."""

from __future__ import annotations

from dataclasses import replace

import pytest

import stiffbench as sb
from helpers.made_results import TWINS, MadeResults, change
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.page import report
from stiff_bench.page.report import folder_section
from stiff_bench.store.database import ResultStore, read_results
from stiff_protocols.contract.errors import ConfigError, StoreError

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


def section_of(folder, **choice):
    return folder_section(sb.open_results(folder).select(**choice))


def parts_of(folder, **choice):
    return {part.heading: part for part in section_of(folder, **choice).sections}


def test_the_page_opens_with_facts_the_answer_the_models_and_the_matrix(results):
    section = section_of(results.folder)
    assert section.about.startswith(
        "runs-of-today · now · 3 models, 2 data sets, 1 protocol, 12 fits · score: "
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


def test_every_model_is_ranked_and_has_its_metrics_on_each_data_set(results):
    parts = parts_of(results.folder)
    assert parts["Notes on the data"].notes == ["made up, never measured"]
    assert [row[0] for row in parts["Leaderboard"].tables[0].texts()] == ["vjm", "gp", "mlp"]
    first, second = parts["Metrics of each data set"].tables
    assert first.title.startswith(TWINS[0]) and second.title.startswith(TWINS[1])
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
            springs = {"stiffness A1 [Nm/rad]": 1000.0 + 200.0 * result.fit.split_index}
            ResultStore(results.folder).write_fits([replace(result, diagnostics=springs)])
    _, stiffnesses = parts_of(results.folder)["Robots and data"].tables
    assert [row[3:] for row in stiffnesses.texts()] == [["A1 [Nm/rad]", "1,100 ± 141"]] * 2


def test_runs_are_listed_with_their_commit_and_command(results):
    provenance = parts_of(results.folder)["Provenance"]
    (row,) = provenance.tables[0].texts()
    assert row[0] == "run-1" and {"bench run", "finished"} <= set(row)
    assert "stiffbench 9.9 at 01234567" in row[-1]
    assert "commit: 0123456789abcdef" in provenance.sections[0].log


def test_failures_have_a_line_per_reason_and_equal_logs_are_shown_once(results):
    keys = results.add("bad", [0.1], TWINS[0], failed=(1, 2))
    for key in keys[1:]:
        store = ResultStore(results.folder)
        (failed,) = (result for result in read_results(results.folder, {key}))
        store.write_fits([replace(failed, cause="ValueError", log=("first", "last <b>"))])
    for key in results.add("tabm", failed=(0, 1)):
        (failed,) = read_results(results.folder, {key})
        reason = {"status": "skipped", "failure": "needs the package pytabkit"}
        ResultStore(results.folder).write_fits([replace(failed, **reason)])
    part = parts_of(results.folder)["Failed and skipped"]
    assert sorted(part.notes) == [
        "FAILED: bad (2 fits): it broke",
        "SKIPPED: tabm (2 fits): needs the package pytabkit",
    ]
    (log,) = part.sections
    assert log.log == "first\nlast <b>" and log.heading == f"Log of bad | {TWINS[0]} | holdout"


def test_what_cannot_be_ranked_has_metrics_and_a_reason(results):
    """A single model is compared with the VJM; missing samples prevent an answer."""
    section = section_of(results.folder, models=("mlp",))
    assert "nothing to compare" in section.notes[0]
    assert [str(row[0]) for row in section.tables[0].rows] == ["vjm", "mlp"]
    change(results.folder, "DELETE FROM data")
    section = section_of(results.folder)
    assert not section.tables and section.notes[0].startswith("No summary: ")
    parts = {part.heading: part for part in section.sections}
    assert "Leaderboard" not in parts and len(parts["Metrics of each data set"].tables) == 2


def test_figures_are_of_the_selected_results_and_broken_ones_are_left_out(results, monkeypatch):
    drawn = []

    def figure(source):
        from matplotlib.figure import Figure

        drawn.append([task.name.dataset for task in source.tasks])
        return Prepared("drawn", "of something", Figure)

    def broken(source):
        raise StoreError("no curves")

    monkeypatch.setattr(report, "FIGURES", {"losses": broken, "scores": figure})
    (drawn_figure,) = parts_of(results.folder, datasets=(TWINS[1],))["Figures"].figures
    assert drawn == [[TWINS[1]]] and drawn_figure.title == "drawn"
    options = f"--results {results.folder} --dataset {TWINS[1]}"
    assert drawn_figure.command == f"bench figure scores {options}"


def test_a_selection_without_results_is_refused(results):
    results.add("vjm", [0.1], "other", "paper")
    with pytest.raises(ConfigError, match="dataset other, protocol holdout"):
        section_of(results.folder, datasets=("other",), protocols=("holdout",))


def test_several_folders_are_parts_of_one_page_and_each_has_every_model_named(results, tmp_path):
    second_results, page = MadeResults(tmp_path / "others"), tmp_path / "page.html"
    second_results.add("gp", [0.1])
    folders = [sb.open_results(folder) for folder in (results.folder, second_results.folder)]
    sb.report(page, folders)
    text = page.read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>") and text.count("<h2") == 2
    with pytest.raises(ConfigError, match="'vjm'"):
        sb.report(page, [folder.select(models=["vjm"]) for folder in folders])
    with pytest.raises(ConfigError, match="given twice"):
        sb.report(page, [folders[0], folders[0]])
