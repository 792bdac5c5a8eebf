"""Fits on a real Dask cluster on this machine: same results, lost fits computed again."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

import stiff_models
from helpers import hostile_models
from helpers.command_line import bench, bench_here, n_stored, started, wait_until
from stiff_bench.store.database import read_manifests, read_results
from stiffbench.main import INTERRUPTION

pytestmark = [
    pytest.mark.xdist_group("dask"),  # one cluster
    pytest.mark.skipif(not find_spec("distributed"), reason="needs the extra 'cluster'"),
]
PLUGIN = str(Path(hostile_models.__file__))


def free_port() -> int:
    with socket.socket() as free_socket:
        free_socket.bind(("127.0.0.1", 0))
        return int(free_socket.getsockname()[1])


class Cluster:
    """A scheduler and two workers in processes that can be killed."""

    def __init__(self, stack: ExitStack, folder: Path, workers: int):
        self.port, self._stack, self._folder = free_port(), stack, folder
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.start(workers)

    def start(self, workers: int) -> None:
        self.scheduler = self._run("dask_scheduler", "--host", "127.0.0.1", "--port", self.port)
        self.workers = [self.start_worker() for _ in range(workers)]

    def start_worker(self, **options: Any) -> subprocess.Popen[bytes]:
        words = (self.address, "--nthreads", 1, "--host", "127.0.0.1")
        return self._run("dask_worker", *words, **options)

    def _run(self, program: str, *words: object, **options: Any) -> subprocess.Popen[bytes]:
        python = [sys.executable, "-m", f"distributed.cli.{program}", "--no-dashboard"]
        command = subprocess.Popen(
            [*python, *map(str, words)],
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
        """Return the computing processes below their nannies."""
        return [
            process
            for nanny in self.workers
            for process in psutil.Process(nanny.pid).children(recursive=True)
            if "spawn_main" in command_line(process)
        ]


def command_line(process: psutil.Process) -> str:
    """Return the words of a process, or none if it has ended."""
    with suppress(psutil.NoSuchProcess):  # a zombie is one of these
        return " ".join(process.cmdline())
    return ""


def kill_family(pid: int) -> None:
    with suppress(psutil.NoSuchProcess):
        family = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
        for process in family:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        psutil.wait_procs(family, timeout=20)


@contextmanager
def a_cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    with ExitStack() as stack:
        yield Cluster(stack, folder, workers)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Start a cluster for tests that keep it running; nannies replace killed workers."""
    with a_cluster(tmp_path_factory.mktemp("cluster"), 2) as made:
        yield made


@pytest.mark.slow
def test_faults_and_killed_workers_cost_no_other_fit_and_the_rest_are_the_bits_of_one_process(
    cluster, tmp_path
):
    ours = [word for key in ("vjm", "knn", "mlp@epochs=20") for word in ("--model", key)]
    bad = ("Good", "Raises", "Hangs", "Segfaults", "Eats", "DetachesAChild")  # a kind each
    words = [word for key in ("KillsWorkers", *bad) for word in ("--model", key)]
    limits = ["--timeout", "20", "--memory", "800MiB"]  # torch has 250, in every process
    run = ["run", "--plugin", PLUGIN, *ours, *words, *limits]
    with started(*run, "--dask", cluster.address, "--output", "out", cwd=tmp_path) as command:
        wait_until(lambda: n_stored(tmp_path / "out") >= 3, running=command)
        wait_until(cluster.worker_processes, running=command)
        with suppress(psutil.NoSuchProcess):  # `KillsWorkers` was quicker
            cluster.worker_processes()[0].kill()
        _, message = command.communicate(timeout=250)
    assert not cells_below(cluster)
    results = {result.fit.model: result for result in read_results(tmp_path / "out")}
    hostile_models.assert_rows(results, ["vjm", *bad])
    lost_result = results.pop("KillsWorkers")
    assert command.returncode == 1 and "1 killed its workers" in message
    assert "4 workers ended while they computed it" in lost_result.failure
    assert bench_here("run", *ours, "--output", "here", cwd=tmp_path).returncode == 0
    local_results = read_results(tmp_path / "here")
    assert len(local_results) == 3
    for local_result in local_results:
        prediction = results[local_result.fit.model].prediction
        assert prediction.predicted.tobytes() == local_result.prediction.predicted.tobytes()
    (manifest,) = read_manifests(tmp_path / "out")
    assert len(manifest.machines) >= 2 and manifest.environment["dask"] == cluster.address
    assert all(machine["numpy"] == np.__version__ for machine in manifest.machines.values())


@pytest.mark.slow
def test_an_interrupted_run_leaves_no_cell_running_on_the_cluster(cluster, tmp_path):
    run = ["run", "--plugin", PLUGIN, "--model", "Hangs"]
    with started(*run, "--dask", cluster.address, "--output", "out", cwd=tmp_path) as command:
        wait_until(lambda: cells_below(cluster), running=command)
        command.send_signal(signal.SIGINT)
        _, message = command.communicate(timeout=60)
    assert command.returncode == 130 and INTERRUPTION in message
    wait_until(lambda: not cells_below(cluster), 30.0)


def cells_below(cluster: Cluster) -> list[psutil.Process]:
    """Return the processes of fits: session leaders below the workers."""
    processes = []
    for worker in cluster.worker_processes():
        with suppress(psutil.NoSuchProcess, ProcessLookupError):  # ended since it was listed
            below = worker.children(recursive=True)
            processes += [process for process in below if os.getsid(process.pid) == process.pid]
    return processes


@pytest.mark.slow
def test_a_run_waits_for_workers_and_ends_with_one_of_other_code_and_with_the_scheduler(tmp_path):
    stub = tmp_path / "older" / "stiff_models"
    shutil.copytree(Path(stiff_models.__file__).parent, stub)
    with (stub / "physics" / "vjm.py").open("a") as module:
        module.write("# of another version\n")
    run = ["run", "--plugin", PLUGIN, "--model", "Good@seconds=0.3", "--splits", "4"]
    with a_cluster(tmp_path, workers=0) as cluster:
        words = [*run, "--dask", cluster.address, "--output", "out"]
        paths = f"{stub.parent}:{os.environ.get('PYTHONPATH', '')}"
        with started(*words, cwd=tmp_path) as command:
            assert any("no workers yet" in line for line in command.stderr)  # the bar is first
            worker = cluster.start_worker(env={**os.environ, "PYTHONPATH": paths})
            _, message = command.communicate(timeout=100)
        assert command.returncode == 2
        assert "a different version of stiffbench or of a library" in message
        assert not n_stored(tmp_path / "out")
        kill_family(worker.pid)
        cluster.start_worker()
        with started(*words, cwd=tmp_path) as command:
            wait_until(lambda: n_stored(tmp_path / "out") >= 3, running=command)
            kill_family(cluster.scheduler.pid)
            _, message = command.communicate(timeout=100)
        assert command.returncode == 2
        last = f"--dask {cluster.address}: the scheduler has stopped; run the same command again"
        assert last in message.strip().splitlines()[-1]
        stored = n_stored(tmp_path / "out")
        cluster.start(workers=1)
        done = bench(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"bench: {8 - stored} ok, {stored} cached; " in done.stderr
    assert [len(manifest.machines) for manifest in read_manifests(tmp_path / "out")] == [0, 1, 1]


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("stiff_bench.run.dask_cluster.SECONDS_TO_CONNECT", 1.0)
    address = f"tcp://127.0.0.1:{free_port()}"
    done = bench_here("run", "--model", "vjm", "--dask", address, "--output", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert f"--dask {address}: no scheduler answers there" in done.stderr.splitlines()[-1]


IN_THE_PLACE_OF_SLURM = """
import sys
from types import ModuleType

from dask_jobqueue import SLURMCluster as Slurm
from distributed import LocalCluster


class Here(LocalCluster):
    def scale(self, jobs):
        return super().scale(min(jobs, 1))


sys.modules["dask_jobqueue"] = found = ModuleType("dask_jobqueue")


def cluster_here(**settings):
    with Slurm(**settings, scheduler_options={"dashboard_address": ":0"}) as real:
        print(real.job_script())
    return Here(n_workers=0, threads_per_worker=1, dashboard_address=":0")


found.SLURMCluster = cluster_here
"""


@pytest.mark.slow
def test_the_lines_of_the_docs_start_a_cluster_of_slurm_and_run_on_it(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "large-studies.md").read_text()
    (lines,) = (
        code for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "SLURM" in code
    )
    (tmp_path / "on_slurm.py").write_text(IN_THE_PLACE_OF_SLURM + lines)
    done = subprocess.run(
        [sys.executable, "on_slurm.py", "--model", "knn", "--output", "out"],
        cwd=tmp_path,
        env=os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr
    assert "bench: 2 ok; " in done.stderr
    for words in ("-p cpu", "-A robotics", "-t 08:00:00", "--mem=8G"):
        assert f"#SBATCH {words}" in done.stdout.splitlines()
    assert "-m distributed.cli.dask_worker tcp://" in done.stdout and "--nthreads 1" in done.stdout
    (manifest,) = read_manifests(tmp_path / "out")
    assert manifest.machines
