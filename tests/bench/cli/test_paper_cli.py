"""`bench table N`, and `bench reproduce` with studies of a few quick models."""

from __future__ import annotations

import csv
import io

import pytest
from click.testing import CliRunner

from helpers.command_line import assert_refused, bench_here
from helpers.made_results import MadeResults
from stiff_bench.cli.compare import table
from stiff_bench.cli.figures import reproduce
from stiff_bench.paper import PAPER_RESULTS, study
from stiff_bench.paper.study import StudyRun
from stiff_bench.paper.tables import TABLES
from stiff_bench.store.names import Variant
from stiff_protocols.contract.errors import ConfigError


def printed(*words: str) -> str:
    """What the command prints."""
    done = CliRunner().invoke(table, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def test_every_number_that_can_be_made_is_a_choice_and_no_other(tmp_path):
    done = CliRunner().invoke(table, ["--help"])
    assert "1 to 10" in done.output
    for number in range(12):
        done = CliRunner().invoke(table, [str(number), "--results", str(tmp_path / "none")])
        assert ("is not one of" in done.output) == (number not in TABLES)


def test_it_reads_the_folder_that_is_named_and_prints_the_format_that_is_asked_for(tmp_path):
    MadeResults(tmp_path).add("vjm", [0.125], "kr10-twin", "paper-holdout")
    assert printed("10", "--results", str(tmp_path)).startswith("**Table 10.")
    text = printed("10", "--results", str(tmp_path), "--format", "csv")
    (line,) = (
        line
        for line in csv.DictReader(io.StringIO(text))
        if (line["axis"], line["error"], line["column"]) == ("Z", "MAE", "VJM")
        and line["protocol"] == "paper-holdout"
    )
    assert float(line["value"]) == pytest.approx(0.125)


def test_tables_2_and_3_are_fitted_on_the_spot_and_refuse_results():
    assert "| A6 " in printed("3")
    for folder in ("some", str(PAPER_RESULTS)):
        with pytest.raises(ConfigError, match="table 3 is fitted here and reads none"):
            printed("3", "--results", folder)


def test_the_papers_plan_its_grid_and_its_wrenches_are_printed_without_any_results():
    assert "| cartesian " in printed("1")
    assert "| A3 " in printed("4")
    assert "fz [N]" in printed("5")


def test_the_command_refuses_in_one_line_with_status_2_and_prints_nothing(tmp_path):
    done = bench_here("table", "9", "--results", "none", cwd=tmp_path)
    assert_refused(
        done, "--results none: there is no such folder", "`bench reproduce` makes the results"
    )


@pytest.fixture
def small(monkeypatch):
    """The paper's study, cut down to what takes no time, on one split or on two."""

    def small_study(*, full):
        splits = 2 if full else 1
        return (
            StudyRun(
                (Variant("vjm"),),
                (study.TWIN,),
                (study.PAPER_PROTOCOL, study.FAIR_PROTOCOL),
                splits,
            ),
            StudyRun(
                (Variant("vjm"), Variant("zero")), (study.TWIN,), (study.FAIR_PROTOCOL,), splits
            ),
        )

    monkeypatch.setattr(study, "paper_study", small_study)
    monkeypatch.setattr("stiff_bench.analysis.forecast.LONGEST_S", 0.0)  # a plan times no fit


def called(*words):
    done = CliRunner().invoke(reproduce, words, standalone_mode=False, catch_exceptions=False)
    return done.return_value, done.stdout, done.stderr


def test_a_plan_says_what_would_be_computed_and_writes_nothing(small, tmp_path):
    status, out, err = called("--plan", "--output", str(tmp_path / "out"))
    assert status == 0
    assert "| all " in out and "bench: 3 fits, 0 cached, 3 to compute; time unknown" in err
    assert not (tmp_path / "out").exists()
    in_csv = called("--plan", "--format", "csv", "--output", str(tmp_path))[1]
    assert "all" in {row["model"] for row in csv.DictReader(in_csv.splitlines())}
    assert "bench: 6 fits" in called("--plan", "--full", "--output", str(tmp_path))[2]


def test_the_papers_recipe_is_asked_for_apart(small, tmp_path):
    """Two trainings in two readings, on the first split, whatever the size of the rest."""
    words = ["--plan", "--paper-recipe", "--output", str(tmp_path)]
    assert "bench: 7 fits" in called(*words)[2]
    assert "bench: 10 fits" in called(*words, "--full")[2]


@pytest.mark.slow
def test_what_was_computed_is_not_computed_again_and_the_files_are_named(small, tmp_path):
    words = ["--no-isolate", "--output", str(tmp_path)]
    status, out, err = called(*words)
    assert status == 0
    assert "bench: 3 ok; " in err
    assert out.splitlines()[-1] == str(tmp_path / "paper" / "README.md")
    assert "0 ok, 3 cached" in called(*words)[2]


def test_the_papers_recipe_is_of_the_paper_alone(tmp_path):
    done = bench_here("reproduce", "effects", "--paper-recipe", cwd=tmp_path)
    assert_refused(done, "--paper-recipe is of the paper, not of effects")


@pytest.mark.parametrize("size", ["--quick", "--full"])
def test_the_leaderboard_has_one_size(size, tmp_path):
    done = bench_here("reproduce", "leaderboard", size, cwd=tmp_path)
    assert_refused(done, "--quick and --full", "leaderboard has one size")
