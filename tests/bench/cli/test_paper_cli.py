"""`bench table N`; `bench run --study` and `bench reproduce` with a quick study."""

from __future__ import annotations

import csv
import io

import pytest
from click.testing import CliRunner

from helpers.made_results import MadeResults
from stiff_bench.cli.result_commands import table
from stiff_bench.cli.run_commands import reproduce, run
from stiff_bench.paper.paper_results import PAPER_RESULTS
from stiff_protocols.contract.errors import ConfigError


def printed(*words: str) -> str:
    """Return the output of `bench table`."""
    done = CliRunner().invoke(table, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def test_it_reads_the_named_folder_and_prints_the_requested_format(tmp_path):
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


def test_tables_2_and_3_are_fitted_on_the_spot_and_refuse_results(monkeypatch):
    monkeypatch.setattr("stiff_bench.paper.paper_tables.SPECIMENS", range(1))  # to save time
    assert "| A6 " in printed("3")
    for folder in ("some", str(PAPER_RESULTS)):
        with pytest.raises(ConfigError, match="table 3 is fitted here and reads none"):
            printed("3", "--results", folder)


@pytest.fixture
def small(monkeypatch, tmp_path):
    """Write the file of a quick study."""
    monkeypatch.setattr("stiff_bench.analysis.forecast.LONGEST_S", 0.0)  # a plan times no fit
    file = tmp_path / "small.toml"
    file.write_text(
        'title = "small"\nmodels = ["vjm", "zero"]\ndatasets = ["fanuc-r2000ic"]\nsplits = 2\n'
        '[[run]]\n[[run]]\nmodels = ["vjm"]\nprotocols = ["paper-holdout"]\n'
    )
    return str(file)


def called(command, *words):
    done = CliRunner().invoke(command, words, standalone_mode=False, catch_exceptions=False)
    return done.return_value, done.stdout, done.stderr


def test_a_plan_lists_the_fits_to_compute_and_writes_nothing(small, tmp_path):
    status, out, err = called(reproduce, small, "--plan", "--output", str(tmp_path / "out"))
    assert status == 0
    assert "| all " in out and "bench: 6 fits, 0 cached, 6 to compute; time unknown" in err
    assert not (tmp_path / "out").exists()
    in_csv = called(reproduce, small, "--plan", "--format", "csv", "--output", str(tmp_path))[1]
    assert "all" in {row["model"] for row in csv.DictReader(in_csv.splitlines())}


def test_a_study_is_run_once_and_its_page_written_of_what_is_stored(small, plugin_file, tmp_path):
    runs, plugin = str(tmp_path / "small" / "runs"), str(plugin_file("mine"))
    status, out, err = called(run, "--study", small, "--plugin", plugin, "--output", runs)
    assert status == 0 and "bench: 6 ok; " in err and "warning: paper-holdout" in err
    assert "| zero " in out and "paper-holdout, 2 splits" in out
    status, out, err = called(reproduce, small, "--no-isolate", "--output", str(tmp_path))
    assert status == 0 and "bench: 6 cached; " in err
    assert out.splitlines()[-1] == str(tmp_path / "small" / "README.md")
