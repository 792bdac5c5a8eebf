"""Check that committed tables and pages in results/ follow from the committed fits."""

from __future__ import annotations

import io
import math
from pathlib import Path

import pandas as pd
import pytest

from helpers.written_leaderboard import write_again
from stiff_bench.page.site import submission_cards
from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.paper_tables import NEEDS_NO_RESULTS, TABLES
from stiff_bench.paper.study_file import find_study
from stiff_bench.results.leaderboard import leaderboard_tables
from stiff_bench.results.load import StoredResults
from stiff_bench.results.scored_task import sort_key
from stiff_bench.store.database import read_results
from stiff_bench.tables.writers import render

RESULTS = Path(__file__).parents[1] / "results"


@pytest.fixture(scope="module")
def stored():
    return PaperResults.of(RESULTS / "paper" / "runs")


@pytest.mark.parametrize("number", [number for number in TABLES if number not in NEEDS_NO_RESULTS])
def test_a_committed_table_is_that_of_the_committed_cells(number, stored):
    parts = TABLES[number](stored)
    assert all(len(part.notes) <= 4 for part in parts)
    computed_table = pd.read_csv(io.StringIO(render(parts, "csv", "bench table")))
    committed_table = pd.read_csv(RESULTS / "paper" / "tables" / f"table_{number}.csv")
    pd.testing.assert_frame_equal(computed_table, committed_table, rtol=1e-9, atol=0.0)
    assert len(committed_table)


of_leaderboard = pytest.mark.xdist_group("leaderboard")  # written once


@pytest.mark.slow
@of_leaderboard
def test_the_committed_leaderboard_is_of_cells_that_are_planned_today(written_leaderboard):
    """Outdated models, data sets or protocols would leave fits that no plan has."""
    of_submissions = submission_cards(RESULTS)
    stored_keys = {
        result.fit.key
        for result in read_results(written_leaderboard.folder / "runs")
        if result.fit.model not in {*written_leaderboard.missing_models, *of_submissions}
    }
    assert stored_keys and stored_keys <= written_leaderboard.planned_keys


def rows_of(text: str) -> dict[str, dict[str, str]]:
    """Return the rows of the first table of a page, by model."""
    lines = text[text.index("| model ") :].partition("\n\n")[0].splitlines()
    heading, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return {row[0]: dict(zip(heading, row, strict=True)) for row in rows}


@pytest.mark.slow
@of_leaderboard
def test_the_leaderboard_of_the_committed_results_has_the_rows_of_its_page(written_leaderboard):
    page = rows_of((RESULTS / "leaderboard" / "README.md").read_text(encoding="utf-8"))
    settings = find_study("leaderboard").board
    stored = StoredResults.read(written_leaderboard.folder / "runs")
    fits = [fit for fit in stored.every if fit.presentation.model in page]
    # variants have one split: with them only this one counts
    main_models = StoredResults.of_results(stored.folder, fits)
    printed_rows = rows_of(
        render(leaderboard_tables(main_models, sort_key(settings.metric)), "github", "bench")
    )
    assert [*printed_rows] == [*page]
    columns = ["error / VJM's", "95 % interval", "worst robot", "fit"]
    for name, row in page.items():
        printed_row = printed_rows[name]
        assert [printed_row[column] for column in columns] == [row[column] for column in columns]


WORLDS = ("clean", "friction", "structure", "workshop", "all")
KEYS = {
    **{"error / VJM's": "ratio", "won": "won", "worst robot": "worst", "fit": "fit_s"},
    **{"95th percentile": "p95", "tool paths": "path", "readings": "readings"},
    **{"without clean": "without clean"},
    **{heading: ("few", heading) for heading in ("5 poses", "20 poses", "60 poses")},
    **{world: ("world", world) for world in WORLDS},
    "fanuc-r2000ic (measured)": ("measured", "fanuc-r2000ic"),
}
"""Column of the committed table -> column of a `model_frame`."""
BOUNDS = {
    "95 % interval": ("low", "high"),
    "without any one robot": ("without low", "without high"),
}


@pytest.mark.slow
@of_leaderboard
def test_the_frame_of_models_has_the_numbers_of_the_committed_table(written_leaderboard):
    board_frame = written_leaderboard.board.board_frame
    models = {row["model"]: row for row in board_frame.to_dict("records")}
    committed = pd.read_csv(RESULTS / "leaderboard" / "tables" / "table_leaderboard.csv")
    lines = committed[committed["table"].isin(["board", "worlds", "more", "certainty"])]
    assert {*lines["model"]} == {*models} and {*lines["column"]} == {*KEYS, *BOUNDS}
    for line in lines.to_dict("records"):
        row, column = models[line["model"]], line["column"]
        expected = [line["low"], line["high"]] if column in BOUNDS else [line["value"]]
        if column == "won":
            expected = [line["part"]]
        numbers = [row[key] for key in BOUNDS.get(column, [KEYS.get(column)])]
        if line["model"] == "vjm" and column == "worst robot":
            numbers = [math.nan]  # the baseline has no worst robot
        assert numbers == pytest.approx(expected, rel=1e-9, nan_ok=True), (line["model"], column)
        if column == "worst robot" and line["model"] != "vjm":
            assert row["worst robot"] == line["mark"]


def test_every_picture_of_the_committed_pages_is_there():
    for page in (RESULTS / "paper" / "README.md", RESULTS / "leaderboard" / "README.md"):
        text = page.read_text(encoding="utf-8")
        pictures = [part.split(")")[0] for part in text.split("![")[1:] if "](" in part]
        names = [picture.split("](")[1] for picture in pictures]
        assert names
        assert all((page.parent / name).is_file() for name in names)


@pytest.mark.slow
@pytest.mark.parametrize("study", ["paper", "intervals", "fresh"])
def test_a_study_written_again_gives_its_committed_files(study, tmp_path):
    assert_same_files(write_again(study, tmp_path), RESULTS / study)


@pytest.mark.slow
@of_leaderboard
def test_the_leaderboard_written_again_gives_its_committed_files(written_leaderboard):
    assert_same_files(written_leaderboard.folder, RESULTS / "leaderboard")


def assert_same_files(written: Path, committed: Path) -> None:
    """Compare bytes, except for numbers in CSV: the last of their 17 digits is the processor's."""
    assert page_files(written) == page_files(committed)
    for name in page_files(committed):
        new, old = written / name, committed / name
        if name.suffix == ".csv":
            frames = pd.read_csv(new), pd.read_csv(old)
            pd.testing.assert_frame_equal(*frames, rtol=1e-9, atol=0.0, obj=str(name))
        else:
            assert new.read_bytes() == old.read_bytes(), name


def page_files(folder: Path) -> set[Path]:
    """Return the files of a study's page, relative to its folder."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.parent.name != "runs"]
    return {path.relative_to(folder) for path in files}
