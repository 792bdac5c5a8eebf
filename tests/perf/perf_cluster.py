"""Cells side by side: what two processes or two workers gain over one, and a plan's cost."""

from __future__ import annotations

import inspect
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from command_line import BENCH, peak_mib
from perf_case import figure, needed, ours
from stiff_bench.store.database import read_results

N_CELLS = 40
MODELS_OF_PLAN = ("zero", "mean", "knn", "knn@neighbours=1", "vjm", "vjm@congruence=true", "gp")


class Busy:
    """Computes for the same time on one core, whatever the data."""

    def fit(self, train, *, robot, validation=None, seed=0):
        matrix = np.full((256, 256), 1e-3)
        end = time.process_time() + 1.0
        while time.process_time() < end:
            matrix = matrix @ matrix * 1e-3
        return self

    def predict(self, q, wrench):
        return np.zeros((len(q), 3))


PLUGIN = f"""
import time

import numpy as np

from stiff_protocols.contract.plugin import ModelInfo

{inspect.getsource(Busy)}

MODELS = [ModelInfo(key="busy", target=Busy, summary="computes for a second")]
"""


@pytest.fixture(scope="module")
def plugin(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("plugin") / "busy.py"
    path.write_text(PLUGIN)
    return path


def seconds_of(plugin: Path, output: Path, *how: str) -> float:
    """How long the whole command takes, which must compute every cell."""
    words = ["run", "--plugin", plugin, "--model", "busy", "--splits", str(N_CELLS)]
    start = time.perf_counter()
    subprocess.run([BENCH, *words, *how, "--output", output], check=True, capture_output=True)
    taken = time.perf_counter() - start
    assert len(list(read_results(output))) == N_CELLS
    return taken


@pytest.mark.slow
@pytest.mark.benchmark(group=f"{N_CELLS} equal cells of one core-second, whole command")
@pytest.mark.parametrize(
    ("name", "one", "two"),
    [
        ("--jobs", ["--isolate"], ["--jobs", "2"]),
        ("--dask local:", ["--dask", "local:1"], ["--dask", "local:2"]),
    ],
    ids=["jobs", "dask"],
)
def test_two_side_by_side_against_one(benchmark, plugin, tmp_path, name, one, two):
    """Efficiency 1: two take half the time of one; both starts are in it."""
    needed("distributed", "Dask")
    alone = seconds_of(plugin, tmp_path / "one", *one)
    ours(benchmark, f"bench run, two by {name}", work=N_CELLS, unit="cell")
    pair = benchmark.pedantic(seconds_of, (plugin, tmp_path / "two", *two), rounds=1)
    said = f"parallel efficiency of two by {name}, time of one / (2 x time of two)"
    figure(benchmark, said, alone / (2 * pair), "")


@pytest.mark.slow
@pytest.mark.benchmark(group="a plan of 100,000 cells")
@pytest.mark.parametrize("n_splits", [1_000, 10_000])
def test_plan(benchmark, n_splits, tmp_path):
    models = [word for key in MODELS_OF_PLAN for word in ("--model", key)]
    words = [BENCH, "run", *models, "--model", "vjm-full", "--model", "vjm-gp", "--model"]
    words += ["vjm-multisegment", "--splits", str(n_splits), "--plan", "--output", tmp_path]

    ours(benchmark, f"bench run --plan of {10 * n_splits:,} cells", work=10 * n_splits, unit="cell")
    peak = benchmark.pedantic(peak_mib, words, rounds=1)
    figure(benchmark, f"peak memory of a plan of {10 * n_splits:,} cells", peak, "MiB")
