"""`bench run --study --model --against`: a new model is compared with published results."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace

import pytest

from helpers.command_line import assert_refused, bench_here
from stiff_bench.store.database import FILE, ResultStore, read_results, stored_statuses
from stiff_bench.store.merging import merge, merge_fits


@pytest.fixture(scope="module")
def published(study_file, tmp_path_factory):
    """Return a folder with the results of the study's own models."""
    folder = tmp_path_factory.mktemp("published")
    done = bench_here("run", "--study", study_file, "--output", folder, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture()
def run_against(study_file, half_springs, tmp_path):
    """A function that runs the new model against a folder of results."""

    def run(folder, *words):
        return bench_here(
            *("run", "--study", study_file, "--model", "half-springs", "--plugin", half_springs),
            *("--output", tmp_path / "mine", "--against", folder, *words),
            cwd=tmp_path,
        )

    return run


def changed(published, folder, **columns):
    """Copy published results, with other columns in the cells of the model mean."""
    merge([published], folder)
    with closing(sqlite3.connect(folder / FILE)) as db:
        cells = [result for result in read_results(published) if result.fit.model == "mean"]
        for result in cells:
            db.execute("DELETE FROM cell WHERE key = ?", (result.fit.key,))
        db.commit()
    ResultStore(folder).write_fits(
        replace(result, fit=replace(result.fit, **columns)) for result in cells
    )
    return folder


@pytest.mark.slow
def test_only_the_new_models_fits_are_computed_and_published_ones_are_shown_too(
    published, run_against, tmp_path
):
    done = run_against(published, "--no-isolate", "--format", "json")
    assert done.returncode == 0, done.stderr
    assert "bench: 4 ok, 8 cached" in done.stderr  # vjm and mean on two robots with two seeds
    tables = json.loads(done.stdout)["tables"]
    assert len(tables) == 4
    assert all({"half-springs", "vjm", "mean"} <= set(str(result).split("'")) for result in tables)
    assert len(stored_statuses(tmp_path / "mine")) == 12
    compared = bench_here(
        "compare", "half-springs", "mean", "--results", tmp_path / "mine", cwd=tmp_path
    )
    assert compared.returncode == 0, compared.stderr


@pytest.mark.slow
def test_the_short_version_takes_the_published_results_of_its_splits_only(
    published, run_against, tmp_path
):
    done = run_against(published, "--no-isolate", "--lite")
    assert done.returncode == 0 and "bench: 2 ok, 4 cached" in done.stderr, done.stderr
    assert {result.fit.seed for result in read_results(tmp_path / "mine")} == {0}


@pytest.mark.slow
def test_a_complete_study_shows_the_new_model_on_its_board_and_page(
    board_study, half_springs, tmp_path
):
    published, runs = tmp_path / "published", tmp_path / "out" / "board" / "runs"
    ran = bench_here("run", "--study", board_study, "--output", published, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    done = bench_here(
        *("run", "--study", board_study, "--model", "half-springs", "--plugin", half_springs),
        *("--no-isolate", "--output", runs, "--against", published, "--format", "json"),
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    board = json.loads(done.stdout)["tables"][0]
    assert {row["model"] for row in board["rows"]} == {"half-springs", "vjm", "mean"}
    page = bench_here(
        "reproduce", board_study, "--output", tmp_path / "out", "--write-only", cwd=tmp_path
    )
    assert page.returncode == 0, page.stderr
    lines = (tmp_path / "out" / "board" / "README.md").read_text().splitlines()
    names = {parts[1].strip() for line in lines if len(parts := line.split("|")) > 7}
    assert {"half-springs", "vjm", "mean"} <= names


@pytest.mark.slow
@pytest.mark.parametrize(
    ("column", "reason"),
    [
        ("data_sha256", "kr10-twin under holdout (seed 0, split 0): other data (0123"),
        ("split_sha256", "kr10-twin under holdout (seed 0, split 0): other rows (0123"),
        ("model_version", "other versions of mean"),
    ],
)
def test_other_data_splits_and_versions_are_refused_before_anything_is_computed(
    column, reason, published, run_against, tmp_path
):
    columns = {column: "0123456789" if column == "model_version" else "0123456789abcdef"}
    done = run_against(changed(published, tmp_path / "other", **columns))
    assert_refused(done, "--against", str(tmp_path / "other"), reason)
    assert not (tmp_path / "mine").exists()


@pytest.mark.slow
def test_results_on_none_of_the_splits_and_missing_folders_are_refused(
    published, run_against, study_file, tmp_path
):
    assert_refused(run_against(tmp_path / "nowhere"), "nowhere: ")
    elsewhere = changed(published, tmp_path / "elsewhere", seed=9)
    keys = [result.fit.key for result in read_results(elsewhere) if result.fit.seed == 9]
    only = tmp_path / "only"
    merge_fits([elsewhere], only, keys)
    assert_refused(run_against(only), "no results on the splits of this run: kr10-twin")
    shutil.rmtree(only)
    assert_refused(run_against("published"), "--against published", "--against DIR")


def test_short_version_and_published_results_require_a_study_and_a_model(study_file, tmp_path):
    for words, reason in (
        (("--lite",), "--lite requires --study"),
        (("--against", "published"), "--against requires --study"),
        (("--study", study_file, "--against", "published"), "requires --model"),
    ):
        assert_refused(bench_here("run", *words, cwd=tmp_path), reason)
