"""`bench table N`, and `bench reproduce` with studies of a few quick models."""

from __future__ import annotations

import pytest

from helpers.command_line import assert_refused, bench_here
from helpers.made_results import MadeResults
from stiff_bench.paper import study
from stiff_bench.paper.study import StudyRun
from stiff_bench.store.names import Variant


def printed(folder, *words: object) -> str:
    """What `bench table` prints."""
    done = bench_here("table", *map(str, words), cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_table_reads_the_folder_that_is_named_in_the_format_that_is_asked_for(tmp_path):
    MadeResults(tmp_path).add("vjm", [0.125], "kr10-twin", "paper-holdout")
    assert "Table 10." in printed(tmp_path, "10", "--results", tmp_path)
    text = printed(tmp_path, "10", "--results", tmp_path, "--format", "csv")
    assert "0.125" in text and "paper-holdout" in text


def test_the_papers_plan_its_grid_its_wrenches_and_its_springs_are_printed_without_any_results(
    tmp_path,
):
    for number, part in {"1": "| cartesian ", "3": "| A6 ", "4": "| A3 ", "5": "fz [N]"}.items():
        assert part in printed(tmp_path, number)


@pytest.fixture
def small(monkeypatch):
    """The paper's study, cut down to what takes no time, on one split or on two."""

    def small_study(*, full):
        both = (study.PAPER_PROTOCOL, study.FAIR_PROTOCOL)
        fair, splits = (study.FAIR_PROTOCOL,), 2 if full else 1
        return (
            StudyRun((Variant("vjm"),), (study.TWIN,), both, splits),
            StudyRun((Variant("vjm"), Variant("zero")), (study.TWIN,), fair, splits),
        )

    monkeypatch.setattr(study, "paper_study", small_study)
    monkeypatch.setattr("stiff_bench.analysis.forecast.LONGEST_S", 0.0)  # a plan times no fit


@pytest.mark.parametrize(
    ("words", "fits"),
    [([], 3), (["--full"], 6), (["--paper-recipe"], 7), (["--full", "--paper-recipe"], 10)],
)
def test_a_plan_says_what_would_be_computed_and_writes_nothing(small, tmp_path, words, fits):
    """The paper's recipe is two trainings in two readings, on the first split, of any size."""
    done = bench_here("reproduce", "--plan", *words, "--output", "out", cwd=tmp_path)
    assert done.returncode == 0
    assert "| all " in done.stdout and f"bench: {fits} fits" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_what_was_computed_is_not_computed_again_and_the_files_are_named(small, tmp_path):
    words = ["reproduce", "--no-isolate", "--output", "out"]
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 0 and "bench: 3 ok; " in done.stderr
    assert done.stdout.splitlines()[-1] == "out/paper/README.md"
    assert "0 ok, 3 cached" in bench_here(*words, cwd=tmp_path).stderr


@pytest.mark.parametrize("size", ["--quick", "--full"])
def test_the_leaderboard_has_one_size(size, tmp_path):
    done = bench_here("reproduce", "leaderboard", size, cwd=tmp_path)
    assert_refused(done, "leaderboard has one size")
