"""`bench reproduce` on the command line, with studies of a few quick models."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from stiff_bench.cli.figures import reproduce
from stiff_bench.cli.main import bench
from stiff_bench.paper import study
from stiff_bench.paper.study import StudyRun
from stiff_bench.store.names import Variant


@pytest.fixture
def small(monkeypatch):
    """The paper's study, cut down to what takes no time, on one split or on two."""

    def small_study(*, full):
        splits = 2 if full else 1
        return (
            StudyRun((Variant("vjm"),), (study.TWIN,), ("paper-holdout", "holdout"), splits),
            StudyRun((Variant("vjm"), Variant("zero")), (study.TWIN,), ("holdout",), splits),
        )

    monkeypatch.setattr(study, "paper_study", small_study)


def called(*words):
    done = CliRunner().invoke(reproduce, words, standalone_mode=False, catch_exceptions=False)
    return done.return_value, done.stdout, done.stderr


def test_a_plan_says_what_would_be_computed_and_writes_nothing(small, tmp_path):
    status, out, err = called("--plan", "--output", str(tmp_path / "out"))
    assert status == 0
    assert "| all " in out and "bench: 3 cells, 0 cached, 3 to compute; time unknown" in err
    assert not (tmp_path / "out").exists()


def test_full_asks_for_more_splits_than_quick(small, tmp_path):
    assert "bench: 6 cells" in called("--plan", "--full", "--output", str(tmp_path))[2]


def test_the_help_says_that_as_many_cells_run_at_once_as_there_are_cores():
    said = " ".join(CliRunner().invoke(reproduce, ["--help"]).output.split())
    assert "own. [default: (as many as there are cores); 1<=x<=1024]" in said
    of_run = " ".join(CliRunner().invoke(bench, ["run", "--help"]).output.split())
    assert "own. [default: 1; 1<=x<=1024]" in of_run


@pytest.mark.slow
def test_what_was_computed_is_not_computed_again_and_the_files_are_named(small, tmp_path):
    words = ["--no-isolate", "--output", str(tmp_path)]
    status, out, err = called(*words)
    assert status == 0
    assert "3 ok; stored in" in err
    assert out.splitlines()[-1] == str(tmp_path / "paper" / "README.md")
    assert "0 ok, 3 cached" in called(*words)[2]


@pytest.mark.parametrize("size", ["--quick", "--full"])
def test_the_leaderboard_has_one_size(size, tmp_path):
    done = CliRunner().invoke(reproduce, ["leaderboard", size, "--output", str(tmp_path)])
    assert done.exit_code == 2
    assert "the leaderboard has one size" in done.output
