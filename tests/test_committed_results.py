"""What is committed in results/ is what the commands beside it make of the committed cells."""

from __future__ import annotations

import io
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


@pytest.mark.slow
def test_the_committed_leaderboard_is_of_cells_that_are_planned_today():
    """An outdated model, data set or protocol would have cells that nobody asks for."""
    folder = RESULTS / "leaderboard" / "runs"
    plans = find_study("leaderboard").plans(build_registry(), output=folder, command="")
    stored = stored_statuses(folder)
    planned = {task.cell.key: task.cell for task in cell_tasks(*plans)}
    assert stored.keys() <= planned.keys()
    missing = [cell.model for key, cell in planned.items() if key not in stored]
    assert not {"vjm", "vjm-full", "vjm-multisegment", "gp-springs"}.intersection(missing)


def test_every_picture_of_the_committed_pages_is_there():
    for page in (RESULTS / "paper" / "README.md", RESULTS / "leaderboard" / "README.md"):
        text = page.read_text(encoding="utf-8")
        pictures = [part.split(")")[0] for part in text.split("![")[1:] if "](" in part]
        names = [picture.split("](")[1] for picture in pictures]
        assert names
        assert all((page.parent / name).is_file() for name in names)
