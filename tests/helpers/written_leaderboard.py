"""Write the committed leaderboard again, once for all tests of it."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from helpers.command_line import bench_here
from stiff_bench.api import evaluation
from stiff_bench.page import study_page
from stiff_bench.results.fresh_robots import FILE
from stiff_bench.results.leaderboard import StudyLeaderboard
from stiff_bench.store.database import PACKED

RESULTS = Path(__file__).parents[2] / "results"


@dataclass(frozen=True)
class WrittenLeaderboard:
    """The committed leaderboard, written again.

    Attributes:
        folder: folder of the page; its folder `runs` has the results.
        planned_keys: keys of the fits that are planned today.
        missing_models: planned models that need packages that are not installed.
        board: the board of the page.
    """

    folder: Path
    planned_keys: set[str]
    missing_models: set[str]
    board: StudyLeaderboard


def write_again(study: str, folder: Path) -> Path:
    """Write a committed study from its stored results below a folder; return its own folder."""
    written = folder / "results" / study
    (written / "runs").mkdir(parents=True)
    shutil.copy(RESULTS / study / "runs" / PACKED, written / "runs")
    for entries in (RESULTS / study).glob(FILE):
        shutil.copy(entries, written)
    done = bench_here("reproduce", study, "--write-only", cwd=folder)
    assert done.returncode == 0, done.stderr
    return written


def write_leaderboard(folder: Path) -> WrittenLeaderboard:
    """Write the committed leaderboard below a folder, with the results on fresh robots."""
    fresh = folder / "results" / "fresh" / "runs"
    fresh.mkdir(parents=True)
    shutil.copy(RESULTS / "fresh" / "runs" / PACKED, fresh)
    runs, studies = list[Any](), list[study_page.StudyResults]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "reproduction", _recorded(evaluation.reproduction, runs))
        of_page = _recorded(study_page.StudyResults, studies)
        patch.setattr(study_page, "StudyResults", of_page)
        written = write_again("leaderboard", folder)
    (run,), (study,) = runs, studies
    missing = {task.fit.model for task in run.tasks if task.model.info.missing()}
    planned = {task.fit.key for task in run.tasks}
    return WrittenLeaderboard(written, planned, missing, study.leaderboard)


def _recorded(make: Any, made: list[Any]) -> Any:
    """Return the function, which appends what it returns to a list."""

    def make_and_record(*args: Any, **options: Any) -> Any:
        made.append(result := make(*args, **options))
        return result

    return make_and_record
