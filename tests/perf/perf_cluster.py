"""Cells side by side: what two processes or two workers gain over one."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest

from helpers.command_line import BENCH
from helpers.perf_case import figure, ours_or_peer
from stiff_bench.store.database import read_results

N_CELLS = 40
PLUGIN = """
import time
import numpy as np
from stiff_protocols.contract.plugin import ModelInfo

class Busy:
    def fit(self, train, *, robot, validation=None, seed=0):
        matrix, end = np.full((256, 256), 1e-3), time.process_time() + 1.0
        while time.process_time() < end:
            matrix = matrix @ matrix * 1e-3
        return self

    def predict(self, q, wrench):
        return np.zeros((len(q), 3))

MODELS = [ModelInfo(key="busy", target=Busy, summary="computes for a second on one core")]
"""


def seconds_of(folder: Path, *how: str) -> float:
    """How long the whole command takes, which must compute every cell."""
    (folder / "busy.py").write_text(PLUGIN)
    output = folder / " ".join(how)
    words = ["run", "--plugin", folder / "busy.py", "--model", "busy", "--splits", str(N_CELLS)]
    start = time.perf_counter()
    subprocess.run([BENCH, *words, *how, "--output", output], check=True, capture_output=True)
    taken = time.perf_counter() - start
    assert len(list(read_results(output))) == 2 * N_CELLS  # with the reference model
    return taken


@pytest.mark.slow
@pytest.mark.benchmark(group=f"{N_CELLS} equal fits of one core-second, whole command")
@pytest.mark.parametrize(
    ("name", "one", "two"),
    [
        ("--jobs", ["--isolate"], ["--jobs", "2"]),
        ("--dask local:", ["--dask", "local:1"], ["--dask", "local:2"]),
    ],
    ids=["jobs", "dask"],
)
def test_two_side_by_side_against_one(benchmark, tmp_path, name, one, two):
    """Efficiency 1: two take half the time of one; both starts are in it."""
    pytest.importorskip("distributed")
    alone = seconds_of(tmp_path, *one)
    ours_or_peer(benchmark, f"bench run, two by {name}", work=N_CELLS, unit="fit")
    pair = benchmark.pedantic(seconds_of, (tmp_path, *two), rounds=1)
    said = f"parallel efficiency of two by {name}, time of one / (2 x time of two)"
    figure(benchmark, said, alone / (2 * pair), "")
