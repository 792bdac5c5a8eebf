"""The engine itself: start-up, overhead of a cell, a large leaderboard, growth of cost."""

from __future__ import annotations

import contextlib
import io
import sqlite3
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from helpers.command_line import BENCH, peak_mib
from helpers.made_board import made_board
from helpers.perf_case import OURS, figure, ours_or_peer
from helpers.run_requests import planned
from stiff_bench.api.run import Run
from stiff_bench.cli.run import execute
from stiff_bench.plan.registry import build_registry
from stiff_bench.plan.request import RunPlan
from stiff_bench.plan.words import RobotWords
from stiff_bench.run.execution import Execution
from stiff_bench.store.database import FILE, ResultStore, read_results, stored_statuses
from stiff_datasets.twin.constants import shipped_constants
from stiff_datasets.twin.simulate import simulate
from stiff_datasets.twin.twin import TwinExperiment
from stiff_models.model_catalog import model_info

N_CELLS = 1000


def command(*words: str | Path) -> str:
    """Run a command to its end; its standard output."""
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    return done.stdout


def seconds(benchmark) -> float:
    """The shortest round."""
    return benchmark.stats.stats.min


LISTS = [f"bench list {what}" for what in ("models", "datasets", "protocols", "metrics")]
PYTHON = {f"python -c '{words}'": words for words in ("pass", "import click")}


@pytest.mark.benchmark(group="start-up")
@pytest.mark.parametrize("who", ["bench --help", *LISTS, *PYTHON])
def test_start(benchmark, who):
    ours_or_peer(benchmark, who)
    if who in PYTHON:
        benchmark.pedantic(command, (sys.executable, "-c", PYTHON[who]), rounds=5)
    else:
        assert benchmark.pedantic(command, (BENCH, *who.split()[1:]), rounds=5)
        at_most = 0.5 if who in LISTS else 0.3
        figure(benchmark, f"{who}, wall", seconds(benchmark), "s", at_most=at_most)


@pytest.mark.benchmark(group=f"a run of {N_CELLS} fits of zero and vjm")
def test_overhead_of_a_cell(benchmark, tmp_path):
    """The whole command: start, splits, metrics, costs, storing, tables; vjm is run, too."""

    def run_s(how: str) -> float:
        start, output = time.perf_counter(), tmp_path / how
        words = ("--model", "zero", "--splits", str(N_CELLS // 2), how, "--output", output)
        command(BENCH, "run", *words)
        statuses = stored_statuses(output)
        assert len(statuses) == N_CELLS and {*statuses.values()} == {"ok"}
        return time.perf_counter() - start

    ours_or_peer(benchmark, "bench run --isolate", work=N_CELLS, unit="fit")
    isolated_s, alone_s = benchmark.pedantic(run_s, ("--isolate",), rounds=1), run_s("--no-isolate")
    figure(benchmark, "a fit with --no-isolate", 1e3 * alone_s / N_CELLS, "ms")
    overhead_ms = 1e3 * (isolated_s - alone_s) / N_CELLS
    figure(benchmark, "isolation of a fit", overhead_ms, "ms", at_most=10)


@pytest.fixture(scope="module")
def board(tmp_path_factory) -> Callable[[int], tuple[Path, int]]:
    """A function that gives a folder of results of so many splits, and its number of values."""

    @cache
    def made(n_splits: int) -> tuple[Path, int]:
        folder = tmp_path_factory.mktemp("board")
        return folder, made_board(folder, n_splits=n_splits)

    return made


@pytest.mark.parametrize(
    ("n_splits", "values", "at_most"),
    [(5, 100_000, 2.0), pytest.param(45, 1_000_000, 8.0, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("words", [["leaderboard"], ["compare", "vjm", "knn"]], ids=lambda w: w[0])
def test_results(benchmark, board, n_splits, values, at_most, words):
    folder, n_values = board(n_splits)
    assert n_values >= values
    name = f"bench {words[0]}"
    benchmark.group = f"results of {values:,} values"
    ours_or_peer(benchmark, name, work=n_values, unit="value")
    peak = benchmark.pedantic(peak_mib, (BENCH, *words, "--results", folder), rounds=3)
    target = {"at_most": at_most} if words == ["leaderboard"] else {}
    figure(benchmark, f"{name} of {n_values} values, wall", seconds(benchmark), "s", **target)
    figure(benchmark, f"{name}, peak memory", peak, "MiB", at_most=1024)


@pytest.mark.benchmark(group="storing results")
@pytest.mark.parametrize(
    "who", ["stiffbench, a result per transaction", "sqlite3, a blob per transaction"]
)
def test_storing(benchmark, board, tmp_path, who):
    """Transactions, each on the disk before the next; and what SQLite alone takes for as many."""
    some = read_results(board(5)[0])[:300]
    ours_or_peer(benchmark, who, work=len(some), unit="result")
    if who.startswith(OURS):
        store = ResultStore(tmp_path)
        benchmark.pedantic(lambda: [store.write_cells([result]) for result in some], rounds=3)
        size = (tmp_path / FILE).stat().st_size / len(some)
        figure(benchmark, "a stored result", size, "bytes")
        return
    blobs = [zlib.compress(one.prediction.predicted.tobytes()) for one in some]

    def insert():
        with closing(sqlite3.connect(tmp_path / "bare.sqlite", isolation_level=None)) as db:
            db.execute("CREATE TABLE IF NOT EXISTS bare (content BLOB)")
            for blob in blobs:
                db.execute("INSERT INTO bare VALUES (?)", (blob,))

    benchmark.pedantic(insert, rounds=3)


def of_samples(n: int, folder: Path) -> RunPlan:
    path = folder / f"{n}.csv"
    constants = shipped_constants("kr10_r1100_2")
    simulate(path, TwinExperiment(constants, loads="omni", specimen=0, seed=0), n)
    robot = RobotWords("kr10-r1100-2")
    return planned(models=("zero", "vjm"), datasets=(), data=(path,), robot=robot)


def of_splits(n: int, _: Path) -> RunPlan:
    return planned(models=("vjm",), splits=n)


def of_models(n: int, _: Path) -> RunPlan:
    models = [replace(model_info("zero"), key=f"zero-{number}") for number in range(n)]
    registry = build_registry()
    registry.add(models, "")
    return planned(registry, models=tuple(model.key for model in models))


def cpu_seconds(plan: RunPlan, folder: Path) -> float:
    """How long a run takes this process; what it prints is not shown."""
    nowhere = io.StringIO()
    with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
        start = time.process_time()
        assert execute(Run([replace(plan, output=folder)], Execution()), "github") == 0
        return time.process_time() - start


@pytest.mark.parametrize(
    ("of", "sizes"),
    [
        (of_samples, (151, 1_000, 10_000, 30_000, 100_000)),
        (of_splits, (2, 10, 100, 400, 1_600)),
        (of_models, (2, 10, 100, 400, 1_600)),
    ],
    ids=["samples", "splits", "models"],
)
@pytest.mark.benchmark(group="growth of a run's cost")
def test_growth(benchmark, of, sizes, tmp_path, request):
    """The exponent over the upper three sizes, where constant cost no longer hides it."""
    what = request.node.callspec.id
    cpu_seconds(planned(models=("vjm", "zero")), tmp_path / "warm")
    plans = {size: of(size, tmp_path) for size in sizes}
    ours_or_peer(benchmark, f"run of many {what}", work=sum(sizes), unit=what.removesuffix("s"))
    times = benchmark.pedantic(
        lambda: [cpu_seconds(plan, tmp_path / str(size)) for size, plan in plans.items()], rounds=1
    )
    exponent = np.polyfit(np.log(sizes[-3:]), np.log(times[-3:]), 1)[0]
    figure(benchmark, f"exponent, {what}", exponent, "", at_most=1.15)
