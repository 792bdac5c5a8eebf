"""Measure the engine: start-up, overhead of a cell, a large leaderboard, growth of cost."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from helpers.command_line import BENCH
from helpers.perf_case import figure, ours_or_peer
from helpers.run_requests import planned
from stiff_bench.api.data_sets import Dataset
from stiff_bench.api.evaluation import Run
from stiff_bench.plan.fits import FitTask, RunPlan, fit_tasks
from stiff_bench.run.execution import Execution
from stiff_bench.store.database import ResultStore, stored_statuses
from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.twin.experiment import TwinExperiment
from stiff_datasets.twin.simulate import simulate
from stiff_datasets.twin.twin_file import shipped_constants
from stiff_protocols.contract.record import Cost, FitResult, RunManifest
from stiff_protocols.contract.types import Prediction
from stiff_protocols.scoring.metrics import METRICS
from stiffbench.commands import execute

N_CELLS = 1000


def command(*words: str | Path) -> None:
    """Run a command to its end."""
    subprocess.run(words, check=True, capture_output=True)


def peak_mib(*words: str | Path) -> float:
    """Run a command to its end and return its peak memory, MiB."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)  # it has been waited for
    assert process.returncode == 0
    return usage.ru_maxrss / 1024


def seconds(benchmark) -> float:
    """Return the time of the shortest round."""
    return benchmark.stats.stats.min


AT_MOST_S = {"bench --help": 0.3, "bench list models": 0.5}
CYCLOPTS = "python -c 'import cyclopts'"


@pytest.mark.benchmark(group="start-up")
@pytest.mark.parametrize("who", [*AT_MOST_S, CYCLOPTS])
def test_start(benchmark, who):
    ours_or_peer(benchmark, who)
    python = (sys.executable, "-c", "import cyclopts")
    words = python if who == CYCLOPTS else (BENCH, *who.split()[1:])
    benchmark.pedantic(command, words, rounds=5)
    if who in AT_MOST_S:
        figure(benchmark, f"{who}, wall", seconds(benchmark), "s", at_most=AT_MOST_S[who])


@pytest.mark.benchmark(group=f"a run of {N_CELLS} fits of zero and vjm")
def test_overhead_of_a_cell(benchmark, tmp_path):
    """Time the whole command: start, splits, metrics, costs, storing and tables; vjm runs too."""

    def run_s(how: str) -> float:
        start, output = time.perf_counter(), tmp_path / how
        words = ("--model", "zero", "--splits", str(N_CELLS // 2), how, "--output", output)
        command(BENCH, "run", *words)
        statuses = stored_statuses(output)
        assert len(statuses) == N_CELLS and {*statuses.values()} == {"ok"}
        return time.perf_counter() - start

    ours_or_peer(benchmark, "bench run --isolate", work=N_CELLS, unit="fit")
    isolated_s = benchmark.pedantic(run_s, ("--isolate",), rounds=1)
    unisolated_s = run_s("--no-isolate")
    figure(benchmark, "a fit with --no-isolate", 1e3 * unisolated_s / N_CELLS, "ms")
    overhead_ms = 1e3 * (isolated_s - unisolated_s) / N_CELLS
    figure(benchmark, "isolation of a fit", overhead_ms, "ms", at_most=100)


MODELS = (
    *("zero", "mean", "knn", "knn@neighbours=1", "knn@neighbours=2"),
    *("vjm", "vjm-multisegment", "vjm-full", "gp", "vjm-gp"),
)
DATASETS = tuple(f"kr10-twin@specimen={number}" for number in range(6))
PROTOCOLS = ("holdout", "kfold", "sample-efficiency", "space-transfer", "load-extrapolation")


def invented_result(task: FitTask, seed: int) -> FitResult:
    """Return an invented result; errors grow with the model's position in `MODELS`."""
    rng, measured = np.random.default_rng(seed), task.data.samples.deflection[task.split.test]
    scale = 1e-4 * (1 + MODELS.index(task.presentation.model))
    errors = rng.normal(scale=scale, size=(2, *measured.shape))
    predicted, reference = measured + errors
    prediction = Prediction(task.split.test, predicted, measured, reference=reference)
    cost = Cost(*rng.uniform(1e-4, 1e-3, 4).tolist(), 2**20)
    return FitResult(
        *(task.fit, task.presentation, "20261121T120000Z-made00", "ok", prediction, cost),
        n_train=len(task.split.train) + len(task.split.validation),
        n_splits=task.n_splits,
    )


@pytest.fixture(scope="module")
def board(tmp_path_factory) -> Callable[[int], tuple[Path, int]]:
    """Return a function that makes a folder of n splits and counts its values."""

    @cache
    def make_board(n_splits: int) -> tuple[Path, int]:
        protocols = [f"kfold@folds={n_splits}" if key == "kfold" else key for key in PROTOCOLS]
        options = {"datasets": DATASETS, "protocols": tuple(protocols), "splits": n_splits}
        tasks = list(fit_tasks(planned(models=MODELS, **options)))
        store = ResultStore(tmp_path_factory.mktemp("board"))
        for data in {task.fit.data_sha256: task.data for task in tasks}.values():
            store.write_data(data)
        results = [invented_result(task, number) for number, task in enumerate(tasks)]
        store.write_fits(results)
        environment = {"stiffbench": "9.9", "commit": "", "dirty": ""}
        keys = tuple(task.fit.key for task in tasks)
        manifest = RunManifest(results[0].run_id, "bench run", "now", "finished", environment, keys)
        store.write_manifest(manifest)
        return store.folder, sum(
            len(metric.of_result(result)) for result in results for metric in METRICS.values()
        )

    return make_board


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


def plan_of_samples(n: int, folder: Path) -> RunPlan:
    path = folder / f"{n}.csv"
    constants = shipped_constants("kr10_r1100_2")
    simulate(path, TwinExperiment(constants, loads="omni", specimen=0, seed=0), n)
    data = Dataset.of_file(path, "kr10-r1100-2", FileOptions())
    return planned(models=("zero", "vjm"), datasets=(data.choice,))


def plan_of_splits(n: int, _: Path) -> RunPlan:
    return planned(models=("vjm",), splits=n)


def cpu_seconds(plan: RunPlan, folder: Path) -> float:
    """Return the processor time of a run in this process; hide its output."""
    hidden_output = io.StringIO()
    with contextlib.redirect_stdout(hidden_output), contextlib.redirect_stderr(hidden_output):
        start = time.process_time()
        assert execute(Run([replace(plan, output=folder)], Execution()), "github") == 0
        return time.process_time() - start


@pytest.mark.parametrize(
    ("make_plan", "sizes"),
    [
        (plan_of_samples, (151, 1_000, 10_000, 30_000, 100_000)),
        (plan_of_splits, (2, 10, 100, 400, 1_600)),
    ],
    ids=["samples", "splits"],
)
@pytest.mark.benchmark(group="growth of a run's cost")
def test_growth(benchmark, make_plan, sizes, tmp_path, request):
    """Fit the exponent to the upper three sizes, where constant costs are small."""
    size_name = request.node.callspec.id
    cpu_seconds(planned(models=("vjm", "zero")), tmp_path / "warm")
    plans = {size: make_plan(size, tmp_path) for size in sizes}
    ours_or_peer(
        benchmark, f"run of many {size_name}", work=sum(sizes), unit=size_name.removesuffix("s")
    )
    times = benchmark.pedantic(
        lambda: [cpu_seconds(plan, tmp_path / str(size)) for size, plan in plans.items()], rounds=1
    )
    exponent = np.polyfit(np.log(sizes[-3:]), np.log(times[-3:]), 1)[0]
    figure(benchmark, f"exponent, {size_name}", exponent, "", at_most=1.15)
