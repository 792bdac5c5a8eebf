"""`bench table N`; `bench run --study` and `bench reproduce` with a quick study."""

from __future__ import annotations

import csv

import pytest

from helpers.command_line import bench_here


def test_table_3_is_fitted_on_the_spot(monkeypatch, tmp_path):
    monkeypatch.setattr("stiff_bench.paper.paper_tables.SPECIMENS", range(1))  # to save time
    assert "| A6 " in bench_here("table", "3", cwd=tmp_path).stdout


@pytest.fixture
def small(tmp_path):
    """Write the file of a quick study."""
    file = tmp_path / "small.toml"
    file.write_text(
        'title = "small"\nmodels = ["vjm", "zero"]\ndatasets = ["fanuc-r2000ic"]\nsplits = 2\n'
        '[[run]]\n[[run]]\nmodels = ["vjm"]\nprotocols = ["paper-holdout"]\n'
    )
    return str(file)


def test_a_plan_lists_the_fits_to_compute_and_writes_nothing(small, tmp_path):
    done = bench_here("reproduce", small, "--plan", "--output", "out", cwd=tmp_path)
    assert done.returncode == 0 and "| all " in done.stdout
    assert "6 fits, 0 cached, 6 to compute" in done.stdout
    assert not (tmp_path / "out").exists()
    in_csv = bench_here("reproduce", small, "--plan", "--format", "csv", cwd=tmp_path).stdout
    assert "all" in {row["model"] for row in csv.DictReader(in_csv.splitlines())}


@pytest.mark.slow
def test_a_study_is_run_once_and_its_page_written_of_what_is_stored(small, plugin_file, tmp_path):
    words = ["--study", small, "--plugin", plugin_file("mine"), "--output", "small/runs"]
    done = bench_here("run", *words, cwd=tmp_path)
    assert done.returncode == 0 and "bench: 6 ok; " in done.stderr
    assert "warning: paper-holdout" in done.stderr
    assert "| zero " in done.stdout and "paper-holdout, 2 splits" in done.stdout
    done = bench_here("reproduce", small, "--no-isolate", "--output", ".", cwd=tmp_path)
    assert done.returncode == 0 and "bench: 6 cached; " in done.stderr
    assert done.stdout.splitlines()[-1] == "small/README.md"
