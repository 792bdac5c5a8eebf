"""Records: the committed schema, and `bench results export`."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from helpers.command_line import assert_refused, bench_here
from stiff_bench.store.database import read_results
from stiff_bench.submissions.record import SCHEMA_FILE, Record, schema_text

jsonschema = pytest.importorskip("jsonschema")
TOP = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return a folder with a fit, a fit with intervals, and a failed fit."""
    folder = tmp_path_factory.mktemp("results")
    common = ("run", "--model", "knn", "--splits", "1", "--output", folder)
    for words in (("--dataset", "fanuc-r2000ic"), ("--metric", "coverage", "--coverage", "0.8")):
        assert bench_here(*common, *words, cwd=folder).returncode == 0
    bench_here(*common, "--set", "knn.neighbours=500", cwd=folder)
    return folder


def exported(results, fmt, folder):
    file = folder / f"records.{fmt}"
    done = bench_here(
        *("results", "export", "--results", results, "--format", fmt, "--output", file), cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return file


def test_the_committed_schema_is_that_of_the_records():
    assert (TOP / SCHEMA_FILE).read_text("utf-8") == schema_text()


@pytest.mark.slow
def test_every_exported_line_follows_the_schema_and_holds_the_stored_numbers(results, tmp_path):
    lines = exported(results, "jsonl", tmp_path).read_text("utf-8").splitlines()
    validator = jsonschema.Draft202012Validator(json.loads((TOP / SCHEMA_FILE).read_text("utf-8")))
    stored = {result.cell.key: result for result in read_results(results)}
    assert len(lines) == len(stored) == 6
    for line in lines:
        validator.validate(json.loads(line))
        record = Record.model_validate_json(line)
        prediction = stored[record.key].prediction
        if prediction is None:
            assert record.status == "failed" and record.failure and not record.rows
            continue
        np.testing.assert_allclose(record.predicted, prediction.predicted, rtol=1e-14)
        np.testing.assert_allclose(record.measured, prediction.measured, rtol=1e-14)
        errors = np.linalg.norm(record.predicted - record.measured, axis=1)
        assert record.metrics["norm_mm"] == pytest.approx(1000.0 * errors.mean())
        assert (record.coverage is None) == (record.lower_mm is None)
        assert record.environment["numpy"] == np.__version__


@pytest.mark.parametrize("fmt", ["csv", "parquet"])
def test_a_table_has_a_row_for_each_fit_and_a_column_for_each_metric(fmt, results, tmp_path):
    file = exported(results, fmt, tmp_path)
    if fmt == "csv":
        with file.open(encoding="utf-8", newline="") as stream:
            rows = [dict(row) for row in csv.DictReader(stream)]
    else:
        rows = pytest.importorskip("pyarrow.parquet").read_table(file).to_pylist()
    assert len(rows) == 6
    done = [row for row in rows if row["status"] == "ok"]
    assert all(float(row["norm_mm"]) > 0.0 and float(row["fit_s"]) > 0.0 for row in done)
    assert {row["status"] for row in rows} == {"ok", "failed"}
    assert {row["model_options"] for row in rows if row["model"] == "vjm"} == {"{}"}


@pytest.mark.slow
def test_a_folder_without_results_and_a_missing_package_are_refused(results, tmp_path, monkeypatch):
    words = ("results", "export", "--output", "x.parquet", "--results")
    assert_refused(bench_here(*words, tmp_path / "no", cwd=tmp_path), "no: ")
    monkeypatch.setattr("stiff_protocols.contract.extras.importlib.util.find_spec", lambda _: None)
    done = bench_here(*words, results, "--format", "parquet", cwd=tmp_path)
    assert_refused(done, "--format parquet", "pip install 'stiffbench[data]'")
    assert not list(tmp_path.iterdir())
