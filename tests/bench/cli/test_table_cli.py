"""`bench table N` on the command line."""

from __future__ import annotations

import csv
import io

import pytest
from click.testing import CliRunner

from command_line import assert_refused, bench_here
from made_results import MadeResults
from stiff_bench.cli.compare import table
from stiff_bench.paper.study import PAPER_RESULTS
from stiff_bench.paper.tables import TABLES
from stiff_protocols.contract.errors import ConfigError, StoreError


def printed(*words: str) -> str:
    """What the command prints."""
    done = CliRunner().invoke(table, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def test_every_number_that_can_be_made_is_a_choice_and_no_other(tmp_path):
    done = CliRunner().invoke(table, ["--help"])
    assert "2, 3, 6, 7, 8, 9 or 10" in done.output
    for number in range(1, 12):
        done = CliRunner().invoke(table, [str(number), "--results", str(tmp_path / "none")])
        assert ("is not one of" in done.output) == (number not in TABLES)


@pytest.mark.parametrize("kind", ["is not there", "is empty"])
def test_a_folder_without_results_is_refused_naming_the_command_that_makes_them(tmp_path, kind):
    if kind == "is empty":
        (tmp_path / "runs").mkdir()
    with pytest.raises(StoreError, match="runs: holds no results; `bench reproduce` makes them"):
        CliRunner().invoke(
            table, ["6", "--results", str(tmp_path / "runs")], catch_exceptions=False
        )


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


def test_the_help_names_the_folder_that_is_read_by_default():
    done = CliRunner().invoke(table, ["--help"])
    assert f"[default: {PAPER_RESULTS}]" in " ".join(done.output.split())


def test_the_command_refuses_in_one_line_with_status_2_and_prints_nothing(tmp_path):
    done = bench_here("table", "9", "--results", "none", cwd=tmp_path)
    assert_refused(done, "--results none: holds no results", "`bench reproduce` makes them")
