"""The reference model is fitted, stored and compared like any other."""

from __future__ import annotations

import pytest

from helpers.command_line import bench_here
from stiff_bench.plan.options import choices
from stiff_bench.plan.registry import build_registry
from stiff_bench.plan.request import with_reference
from stiff_bench.store.database import read_results


@pytest.mark.parametrize(
    ("asked", "models"),
    [
        (("zero",), ["vjm", "zero"]),
        (("zero", "vjm"), ["vjm", "zero"]),
        (("zero", "vjm@congruence=true"), ["vjm", "vjm@congruence=True", "zero"]),
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


def test_data_without_loads_have_no_reference_model():
    registry = build_registry()
    words = {"models": ("zero",), "protocols": ("holdout",)}
    for dataset, models in {"kr10-twin": ["vjm", "zero"], "ur5-pose-error": ["zero"]}.items():
        asked = choices(registry, datasets=(dataset,), **words)
        assert [one.name for one in with_reference(asked, registry).models] == models
