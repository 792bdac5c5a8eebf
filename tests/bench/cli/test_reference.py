"""The reference model is fitted, stored and compared like any other."""

from __future__ import annotations

import pytest

from helpers.command_line import bench_here
from stiff_bench.store.database import read_results


@pytest.mark.parametrize(
    ("asked", "models"),
    [
        (("zero",), ["vjm", "zero"]),
        (("zero", "vjm"), ["vjm", "zero"]),
        (("zero", "vjm@tcp=fit"), ["vjm", "vjm@tcp=fit", "zero"]),
    ],
)
def test_the_reference_model_is_stored_once_beside_what_is_asked_for(tmp_path, asked, models):
    words = [word for model in asked for word in ("--model", model)]
    words = ["run", *words, "--dataset", "fanuc-r2000ic", "--splits", "2", "--output", "out"]
    done = bench_here(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    stored = [one.shown.model for one in read_results(tmp_path / "out")]
    assert sorted(stored) == [name for name in models for _ in range(2)]
    assert done.stdout.count("| vjm ") == 1
    compared = bench_here("compare", "zero", "vjm", "--results", "out", cwd=tmp_path)
    assert compared.returncode == 0 and "vjm is better than zero" in compared.stdout
