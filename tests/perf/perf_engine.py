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
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from command_line import BENCH, peak_mib
from made_board import made_board
from made_results import ROBOT as KR10
from made_samples import samples_with
from perf_case import figure, ours, peer
from run_requests import planned
from stiff_bench.analysis.collected import collect
from stiff_bench.cli.run import execute
from stiff_bench.plan.registry import build_registry
from stiff_bench.plan.request import RunPlan
from stiff_bench.plan.words import RobotWords
from stiff_bench.store.database import FILE, ResultStore, stored_results, stored_statuses
from stiff_datasets.measured.measured import write_samples
from stiff_models.physics.kinematics import jacobian
from stiff_protocols.contract.plugin import ModelInfo

N_CELLS = 1000
ROBOT = RobotWords("kr10-r1100-2", None, "")


class Nothing:
    def fit(self, train, *, robot, validation=None, seed=0):
        return self

    def predict(self, q, wrench):
        return np.zeros((len(q), 3))


def command(*words: str | Path) -> str:
    """Run a command to its end; its standard output."""
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    return done.stdout


def seconds(benchmark) -> float:
    """The shortest round."""
    return benchmark.stats.stats.min


@pytest.mark.benchmark(group="start-up")
@pytest.mark.parametrize("words", ["pass", "import click"])
def test_start_of_python(benchmark, words):
    peer(benchmark, f"python -c '{words}'")
    benchmark.pedantic(command, (sys.executable, "-c", words), rounds=5)


@pytest.mark.benchmark(group="start-up")
@pytest.mark.parametrize(
    ("words", "at_most"),
    [
        (["--help"], 0.3),
        *((["list", what], 0.5) for what in ("models", "datasets", "protocols", "metrics")),
    ],
    ids=["--help", "models", "datasets", "protocols", "metrics"],
)
def test_start_of_bench(benchmark, words, at_most):
    ours(benchmark, " ".join(["bench", *words]))
    assert benchmark.pedantic(command, (BENCH, *words), rounds=5)
    figure(benchmark, f"bench {' '.join(words)}, wall", seconds(benchmark), "s", at_most=at_most)


@pytest.mark.benchmark(group=f"a run of {N_CELLS} cells of zero")
@pytest.mark.parametrize("isolated", [False, True], ids=["in this process", "isolated"])
def test_overhead_of_a_cell(benchmark, tmp_path, isolated):
    """The whole command: start, splits, reference model, metrics, costs, storing, tables."""
    run = (BENCH, "run", "--model", "zero", "--splits", str(N_CELLS), "--output", tmp_path / "out")
    words = (*run, "--isolate" if isolated else "--no-isolate")
    name = f"bench run --{'' if isolated else 'no-'}isolate"
    (ours if isolated else peer)(benchmark, name, work=N_CELLS, unit="cell")
    benchmark.pedantic(command, words, rounds=1)
    statuses = stored_statuses(tmp_path / "out")
    assert len(statuses) == N_CELLS and {*statuses.values()} == {"ok"}
    cost_ms = 1e3 * seconds(benchmark) / N_CELLS
    figure(benchmark, f"{name}, wall of the command / cells", cost_ms, "ms")
    if isolated:
        overhead_ms = cost_ms - COST_MS.pop("in this process")
        figure(benchmark, "isolation of a cell", overhead_ms, "ms", at_most=10)
    else:
        COST_MS["in this process"] = cost_ms


COST_MS: dict[str, float] = {}
"""Wall time of a cell that is not isolated, which the next benchmark takes off its own."""


@pytest.fixture(scope="module")
def board(tmp_path_factory) -> tuple[Path, int]:
    """A folder of results and how many records it has."""
    folder = tmp_path_factory.mktemp("board")
    n_records = made_board(folder)
    assert n_records >= 100_000
    return folder, n_records


@pytest.mark.benchmark(group="results of 100,000 records")
def test_leaderboard(benchmark, board):
    folder, n_records = board
    ours(benchmark, "bench leaderboard", work=n_records, unit="record")
    text = benchmark.pedantic(command, (BENCH, "leaderboard", "--results", folder), rounds=3)
    contests = collect(folder)
    assert f"{len(contests)} comparisons" in text and "within CD of the best" in text
    said = f"bench leaderboard of {n_records} records, wall"
    figure(benchmark, said, seconds(benchmark), "s", at_most=2.0)


@pytest.mark.benchmark(group="results of 100,000 records")
def test_compare(benchmark, board):
    folder, n_records = board
    ours(benchmark, "bench compare", work=n_records, unit="record")
    words = (BENCH, "compare", "vjm", "knn", "--results", folder)
    assert "vjm" in benchmark.pedantic(command, words, rounds=3)
    said = f"bench compare in {len(collect(folder))} contests, wall"
    figure(benchmark, said, seconds(benchmark), "s")


@pytest.fixture(scope="module")
def million(tmp_path_factory) -> tuple[Path, int]:
    """A large folder of results and how many records it has."""
    folder = tmp_path_factory.mktemp("million")
    n_records = made_board(folder, n_splits=48)
    assert n_records >= 1_000_000
    return folder, n_records


@pytest.mark.slow
@pytest.mark.benchmark(group="results of 1,000,000 records")
@pytest.mark.parametrize(
    ("words", "at_most"),
    [(["leaderboard"], 3.0), (["compare", "vjm", "knn"], None)],
    ids=["leaderboard", "compare"],
)
def test_million_records(benchmark, million, words, at_most):
    folder, n_records = million
    name = f"bench {words[0]}"
    ours(benchmark, name, work=n_records, unit="record")
    whole = (BENCH, *words, "--results", folder)
    peak = benchmark.pedantic(peak_mib, whole, rounds=1)
    figure(
        benchmark, f"{name} of {n_records} records, wall", seconds(benchmark), "s", at_most=at_most
    )
    figure(benchmark, f"{name}, peak memory", peak, "MiB", at_most=1024)


@pytest.mark.benchmark(group="storing cells")
def test_storing(benchmark, board, tmp_path):
    """A transaction a cell, each of them on the disk before the next."""
    some = list(islice(stored_results(board[0]), 300))
    store = ResultStore(tmp_path)
    ours(benchmark, "one transaction a cell", work=len(some), unit="cell")
    benchmark.pedantic(lambda: [store.write_cell(result) for result in some], rounds=3)
    size = (tmp_path / FILE).stat().st_size / len(some)
    figure(benchmark, "a stored cell", size, "bytes")


@pytest.mark.benchmark(group="storing cells")
def test_storing_bare_blobs(benchmark, board, tmp_path):
    """What SQLite alone takes for as many transactions."""
    blobs = [zlib.compress(one.prediction.predicted.tobytes()) for one in stored_results(board[0])]
    peer(benchmark, "sqlite3, a blob a transaction", work=300, unit="cell")

    def insert():
        with closing(sqlite3.connect(tmp_path / "bare.sqlite", isolation_level=None)) as db:
            db.execute("CREATE TABLE IF NOT EXISTS bare (content BLOB)")
            for blob in blobs[:300]:
                db.execute("INSERT INTO bare VALUES (?)", (blob,))

    benchmark.pedantic(insert, rounds=3)


def measurement(n: int, path: Path) -> Path:
    """Write random poses of a KR10 that bends like a VJM, with noise."""
    rng, robot = np.random.default_rng(0), KR10
    q = rng.uniform(robot.lower, robot.upper, (n, 6))
    wrench = np.column_stack([rng.uniform(-100.0, 100.0, (n, 3)), np.zeros((n, 3))])
    rows = jacobian(robot, q)
    compliance = 1e-6 * np.array([2.0, 1.6, 3.0, 20.0, 20.0, 50.0])
    deflection = np.einsum("nij,j,nkj,nk->ni", rows, compliance, rows, wrench)[:, :3]
    noise = rng.normal(scale=1e-5, size=(n, 3))
    write_samples(path, samples_with(q, wrench, deflection + noise), robot)
    return path


@pytest.fixture(scope="module")
def measurements(tmp_path_factory) -> Callable[[int], Path]:
    folder = tmp_path_factory.mktemp("measurements")
    return lambda n: measurement(n, folder / f"{n}.csv")


def of_samples(n: int, measured: Callable[[int], Path]) -> RunPlan:
    return planned(models=("zero", "vjm"), datasets=(), data=measured(n), robot=ROBOT)


def of_splits(n: int, _: object) -> RunPlan:
    return planned(models=("vjm",), splits=n)


def of_models(n: int, _: object) -> RunPlan:
    keys = tuple(f"nothing-{number}" for number in range(n))
    registry = build_registry()
    registry.add([ModelInfo(key=key, target=Nothing, summary="does nothing") for key in keys], "")
    return planned(registry, models=keys)


def cpu_seconds(plan: RunPlan, folder: Path) -> float:
    """How long a run takes this process; what it prints is not shown."""
    nowhere = io.StringIO()
    with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
        start = time.process_time()
        assert execute(replace(plan, output=folder), "github") == 0
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
def test_growth(benchmark, of, sizes, measurements, tmp_path, request):
    """The exponent over the upper three sizes, where constant cost no longer hides it."""
    what = request.node.callspec.id
    cpu_seconds(planned(models=("vjm", "zero")), tmp_path / "warm")
    plans = [of(size, measurements) for size in sizes]

    def measured() -> list[float]:
        return [
            cpu_seconds(plan, tmp_path / str(size)) for plan, size in zip(plans, sizes, strict=True)
        ]

    ours(benchmark, f"run of many {what}", work=sum(sizes), unit=what.removesuffix("s"))
    times = benchmark.pedantic(measured, rounds=1)
    exponent = np.polyfit(np.log(sizes[-3:]), np.log(times[-3:]), 1)[0]
    figure(benchmark, f"exponent, {what}", exponent, "", at_most=1.15)
