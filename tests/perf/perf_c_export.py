"""Compare a row of an exported model in C with the same row in NumPy."""

from __future__ import annotations

import shutil
import time

import numpy as np
import pytest

from helpers.c_models import compiled
from helpers.perf_case import figure, ours_or_peer
from helpers.quick_models import fitted

ROWS, NANOMETRE = 20_000, 1e-9
OURS, NUMPY = "stiffbench: C, row by row", "NumPy, all rows at once"
MOST_US = 20.0
"""Of a row on one core; what is measured is the processor's time."""


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Return `bayes-springs` in Python and in C; every group bends, as none vanishes."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    model, rng = fitted("bayes-springs", {}), np.random.default_rng(0)
    model.coefficients_ = 0.1 * rng.normal(size=model.coefficients_.shape)
    in_c = compiled(model, tmp_path_factory.mktemp("c"), "bayes-springs")
    return model, in_c, rng.uniform(-1.5, 1.5, (ROWS, 6)), 50.0 * rng.normal(size=(ROWS, 6))


@pytest.mark.benchmark(group="bayes-springs, a row after another", timer=time.process_time)
@pytest.mark.parametrize("who", [OURS, NUMPY])
def test_rows(benchmark, case, who):
    model, in_c, *loads = case
    ways = {OURS: in_c.deflection, NUMPY: model.predict}
    np.testing.assert_allclose(*(way(*loads) for way in ways.values()), rtol=0, atol=NANOMETRE)
    ours_or_peer(benchmark, who, {NUMPY: 5.0}, work=ROWS, unit="row")
    benchmark.pedantic(ways[who], loads, rounds=5, warmup_rounds=1)
    if who == OURS:
        microseconds = 1e6 * benchmark.stats.stats.min / ROWS
        figure(benchmark, "bayes-springs in C, a row", microseconds, "us", at_most=MOST_US)
        size = in_c.library.stat().st_size / 1024
        figure(benchmark, "bayes-springs in C, library", size, "KiB", at_most=256.0)
