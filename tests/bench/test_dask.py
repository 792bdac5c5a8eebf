"""Cells on a real Dask cluster on this machine: the same results, and what it loses is computed."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

import hostile_models
import stiff_models
from command_line import assert_refused, bench, started
from stiff_bench.slurm_file import read_slurm_file
from stiff_bench.store import read_manifests, read_results
from stiff_protocols.errors import ConfigError

pytest.importorskip("distributed", reason="needs the extra 'cluster'")
PLUGIN = str(Path(hostile_models.__file__))
MODELS = [word for key in ("vjm", "knn", "gp", "mlp@epochs=20") for word in ("--model", key)]


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class Cluster:
    """A scheduler and two workers, each a process of its own that can be killed."""

    def __init__(self, stack: ExitStack, folder: Path, workers: int = 2):
        self.port, self._stack, self._folder = free_port(), stack, folder
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.start(workers)

    def start(self, workers: int = 2) -> None:
        self.scheduler = self._run("dask_scheduler", "--host", "127.0.0.1", "--port", self.port)
        self.workers = [self.start_worker() for _ in range(workers)]

    def start_worker(self, **options: Any) -> subprocess.Popen[bytes]:
        words = (self.address, "--nthreads", 1, "--host", "127.0.0.1")
        return self._run("dask_worker", *words, **options)

    def _python(self, program: str) -> list[str]:
        return [sys.executable, "-m", f"distributed.cli.{program}"]

    def _run(self, program: str, *words: object, **options: Any) -> subprocess.Popen[bytes]:
        command = subprocess.Popen(
            [*self._python(program), *map(str, words), "--no-dashboard"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=self._folder,
            start_new_session=True,
            **options,
        )
        self._stack.callback(command.wait)
        self._stack.callback(kill_family, command.pid)
        return command

    def worker_processes(self) -> list[psutil.Process]:
        """The processes that compute, below the nannies that start them again."""
        return [
            process
            for nanny in self.workers
            for process in psutil.Process(nanny.pid).children(recursive=True)
            if "spawn_main" in " ".join(process.cmdline())
        ]


def kill_family(pid: int) -> None:
    try:
        family = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    except psutil.NoSuchProcess:
        return
    for process in family:
        try:
            process.kill()
        except psutil.NoSuchProcess:
            continue
    psutil.wait_procs(family, timeout=20)


@contextmanager
def a_cluster(folder: Path) -> Iterator[Cluster]:
    with ExitStack() as stack:
        yield Cluster(stack, folder)


def predictions(folder: Path) -> dict[tuple[str, int], bytes]:
    found = {}
    for one in read_results(folder):
        assert one.status == "ok", one.failure
        found[one.shown.model, one.cell.split_index] = one.prediction.predicted.tobytes()
    return found


def wait_until(true: Callable[[], object], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.1)


def n_stored(folder: Path) -> int:
    return len(list((folder / "cells").glob("[!.]*.json")))


@pytest.mark.slow
def test_a_cluster_two_jobs_and_one_process_give_the_same_bits(tmp_path):
    run = ["run", *MODELS, "--splits", "2"]
    with a_cluster(tmp_path) as cluster:
        for name, how in {
            "serial": [],
            "two jobs": ["--jobs", "2"],
            "dask": ["--dask", cluster.address],
            "local": ["--dask", "local:2"],
        }.items():
            done = bench(*run, *how, "--output", name, cwd=tmp_path)
            assert done.returncode == 0, done.stderr
            assert "bench: 8 ok; " in done.stderr
    serial = predictions(tmp_path / "serial")
    assert len(serial) == 8
    for name in ("two jobs", "dask", "local"):
        assert predictions(tmp_path / name) == serial
    (manifest,) = read_manifests(tmp_path / "dask")
    assert len(manifest.machines) == 2 and manifest.environment["dask"] == cluster.address
    assert all(one["numpy"] == np.__version__ for one in manifest.machines.values())
    assert {path.name for path in (tmp_path / "local").iterdir()} == {
        *(".lock", "cells", "runs", "data")
    }


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_no_result(tmp_path):
    run = ["run", "--plugin", PLUGIN, "--model", "Good@seconds=0.5", "--splits", "20"]
    with (
        a_cluster(tmp_path) as cluster,
        started(*run, "--dask", cluster.address, "--output", "out", cwd=tmp_path) as command,
    ):
        for stored in (2, 8):
            wait_until(lambda stored=stored: n_stored(tmp_path / "out") >= stored)
            cluster.worker_processes()[0].kill()
        _, said = command.communicate(timeout=200)
    assert command.returncode == 0, said
    assert "bench: 20 ok; " in said
    assert len(predictions(tmp_path / "out")) == 20


@pytest.mark.slow
def test_a_cell_that_kills_every_worker_it_meets_costs_that_cell_alone(tmp_path):
    models = ["--model", "KillsWorkers", "--model", "Good@seconds=0.2"]
    run = ["run", "--plugin", PLUGIN, *models, "--splits", "3"]
    with a_cluster(tmp_path) as cluster:
        done = bench(*run, "--dask", cluster.address, "--output", "out", cwd=tmp_path)
    assert done.returncode == 1
    assert "bench: 3 ok, 3 failed (killed its workers); " in done.stderr
    results = list(read_results(tmp_path / "out"))
    good = [one for one in results if one.cell.model == "Good"]
    bad = [one for one in results if one.cell.model == "KillsWorkers"]
    assert len(good) == len(bad) == 3 and all(one.status == "ok" for one in good)
    assert all("3 workers ended while they computed it" in one.failure for one in bad)


@pytest.mark.slow
def test_a_run_waits_for_workers_and_gives_none_to_one_of_other_code(tmp_path):
    stub = tmp_path / "older" / "stiff_models"
    shutil.copytree(Path(stiff_models.__file__).parent, stub)
    (stub / "vjm.py").write_text((stub / "vjm.py").read_text() + "# of another version\n")
    run = ["run", "--model", "vjm", "--model", "knn", "--splits", "4"]
    with ExitStack() as stack:
        cluster = Cluster(stack, tmp_path, workers=0)
        command = stack.enter_context(
            started(*run, "--dask", cluster.address, "--output", "out", cwd=tmp_path)
        )
        wait_until(lambda: (tmp_path / "out" / "runs").is_dir())
        time.sleep(3.0)
        cluster.start_worker(env={**os.environ, "PYTHONPATH": str(stub.parent)})
        time.sleep(8.0)
        assert n_stored(tmp_path / "out") == 0 and command.poll() is None
        cluster.start_worker()
        _, said = command.communicate(timeout=120)
    assert command.returncode == 0, said
    assert "is given no cells: it has another version of stiffbench or of a library" in said
    assert "bench: 8 ok; " in said
    (manifest,) = read_manifests(tmp_path / "out")
    assert len(manifest.machines) == 1


@pytest.mark.slow
def test_a_run_goes_on_when_its_scheduler_comes_back(tmp_path):
    run = ["run", "--plugin", PLUGIN, "--model", "Good@seconds=0.5", "--splits", "16"]
    with (
        a_cluster(tmp_path) as cluster,
        started(*run, "--dask", cluster.address, "--output", "out", cwd=tmp_path) as command,
    ):
        wait_until(lambda: n_stored(tmp_path / "out") >= 3)
        kill_family(cluster.scheduler.pid)
        time.sleep(2.0)
        cluster.start()
        _, said = command.communicate(timeout=200)
    assert command.returncode == 0, said
    assert (
        "the scheduler is gone; waiting for another, and for workers" in said
        and "bench: 16 ok; " in said
    )
    assert len(predictions(tmp_path / "out")) == 16


@pytest.mark.slow
def test_an_interrupted_run_leaves_no_cell_running_on_the_cluster(tmp_path):
    run = ["run", "--plugin", PLUGIN, "--model", "Hangs"]
    with (
        a_cluster(tmp_path) as cluster,
        started(*run, "--dask", cluster.address, "--output", "out", cwd=tmp_path) as command,
    ):
        wait_until(lambda: cells_below(cluster))
        command.send_signal(signal.SIGINT)
        _, said = command.communicate(timeout=60)
        assert command.returncode == 130 and "the same command again computes the rest" in said
        wait_until(lambda: not cells_below(cluster), 30.0)


def cells_below(cluster: Cluster) -> list[psutil.Process]:
    """The processes of cells: leaders of a session, below the workers."""
    return [
        process
        for worker in cluster.worker_processes()
        for process in worker.children(recursive=True)
        if os.getsid(process.pid) == process.pid
    ]


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_refused(tmp_path):
    address = f"tcp://127.0.0.1:{free_port()}"
    done = bench("run", "--model", "vjm", "--dask", address, "--output", "out", cwd=tmp_path)
    assert_refused(done, f"--dask {address}: no scheduler answers there")


SLURM = """
workers = 20
queue = "cpu"
account = "robotics"
walltime = "08:00:00"
memory = "8GiB"
setup = ["module load python"]
directives = ["--constraint=avx512"]
python = "/opt/bench/bin/python"
"""


def test_a_job_of_slurm_starts_one_worker_of_one_thread(tmp_path):
    (tmp_path / "cluster.toml").write_text(SLURM)
    words = ["run", "--model", "vjm", "--threads", "2", "--plan", "--output", "out"]
    done = bench(*words, "--dask", "slurm:cluster.toml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    for line in (
        "#SBATCH -p cpu",
        "#SBATCH -A robotics",
        "#SBATCH -n 1",
        "#SBATCH --cpus-per-task=2",
        "#SBATCH --mem=8G",
        "#SBATCH -t 08:00:00",
        f"#SBATCH --output={tmp_path}/out/slurm/%j.out",
        "#SBATCH --constraint=avx512",
        "module load python",
    ):
        assert line in lines
    (start,) = [line for line in lines if "dask_worker" in line]
    assert start.startswith("/opt/bench/bin/python -m distributed.cli.dask_worker tcp://")
    assert "--nthreads 1 " in start and f"--local-directory {tmp_path}/out/dask" in start
    assert "with 20 jobs" in done.stderr and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("workers = 0", "workers 0: Input should be greater than or equal to 1"),
        (SLURM.replace("08:00:00", "8 hours"), "walltime '8 hours': String should match"),
        (SLURM + "cores = 3", "cores 3: Extra inputs are not permitted (settings: workers, wallti"),
        ('walltime = "1:00:00"\nmemory = "1GiB"', "workers: Field required"),
        ("workers = ", "no TOML: Invalid value"),
    ],
)
def test_a_file_for_slurm_that_is_wrong_is_refused(tmp_path, text, part):
    (tmp_path / "cluster.toml").write_text(text)
    with pytest.raises(ConfigError, match="^--dask slurm:.*" + re.escape(part)):
        read_slurm_file(tmp_path / "cluster.toml")
