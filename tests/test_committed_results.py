"""What is committed in results/ is what the commands beside it make of the committed cells."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from stiff_bench.paper.paper_results import PaperResults
from stiff_bench.paper.paper_tables import NEEDS_NO_RESULTS, TABLES
from stiff_bench.paper.study_file import find_study
from stiff_bench.plan.cells import cell_tasks
from stiff_bench.plan.registry import build_registry
from stiff_bench.store.database import stored_statuses
from stiff_bench.tables.render import render

RESULTS = Path(__file__).parents[1] / "results"


@pytest.fixture(scope="module")
def stored():
    return PaperResults.of(RESULTS / "paper" / "runs")


@pytest.mark.parametrize("number", [number for number in TABLES if number not in NEEDS_NO_RESULTS])
def test_a_committed_table_is_that_of_the_committed_cells(number, stored):
    parts = TABLES[number](stored)
    assert all(len(part.notes) <= 4 for part in parts)
    made = pd.read_csv(io.StringIO(render(parts, "csv", "bench table")))
    committed = pd.read_csv(RESULTS / "paper" / "tables" / f"table_{number}.csv")
    pd.testing.assert_frame_equal(made, committed, rtol=1e-9, atol=0.0)
    assert len(committed)


def test_the_committed_leaderboard_is_of_the_cells_that_are_planned_today():
    """But for the FANUC's, whose robot got its masses after it was made.

    The page is of version 1 of every model, and says so.
    """
    folder = RESULTS / "leaderboard" / "runs"
    plans = find_study("leaderboard").plans(build_registry(), output=folder, command="")
    stored = stored_statuses(folder)
    planned = [
        replace(task.cell, model_version="1")
        for task in cell_tasks(*plans)
        if task.cell.model == "vjm"
    ]
    missing = [cell for cell in planned if cell.key not in stored]
    assert {cell.dataset for cell in missing} <= {"fanuc-r2000ic"}


def test_every_picture_of_the_committed_pages_is_there():
    for page in (RESULTS / "paper" / "README.md", RESULTS / "leaderboard" / "README.md"):
        text = page.read_text(encoding="utf-8")
        pictures = [part.split(")")[0] for part in text.split("![")[1:] if "](" in part]
        names = [picture.split("](")[1] for picture in pictures]
        assert names
        assert all((page.parent / name).is_file() for name in names)
