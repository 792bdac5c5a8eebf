"""What `--dask` can name: a scheduler that runs, workers of our own here, or jobs of Slurm."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from stiff_bench.cell_process import Limits
from stiff_bench.slurm_file import job_script, read_slurm_file, slurm_cluster
from stiff_protocols.errors import ConfigError

VALID = "tcp://HOST:PORT, local:N, slurm:FILE.toml"


class Cluster(NamedTuple):
    """A cluster that is not there yet.

    Attributes:
        entered: once entered, gives its scheduler's address.
        workers: how many there will be; 1 where that is not known.
        job_script: returns the script of a job that would be submitted; "" where there is none.
    """

    entered: AbstractContextManager[str]
    workers: int = 1
    job_script: Callable[[], str] = str


def cluster_of(words: str, limits: Limits, output: Path) -> Cluster:
    """Return what --dask names.

    Args:
        words: of --dask.
        limits: of every cell's process.
        output: folder for what a cluster of our own writes.

    Raises:
        ConfigError: the words name no cluster, or the file of one is wrong.
    """
    kind, _, rest = words.partition(":")
    if kind in ("tcp", "tls") and re.fullmatch(r"//[^/:]+:\d+", rest):
        return Cluster(nullcontext(words))
    if kind == "local" and rest.isdecimal() and int(rest) > 0:
        return Cluster(_local(int(rest), output), int(rest))
    if kind == "slurm" and rest:
        settings = read_slurm_file(Path(rest))
        script = partial(job_script, settings, limits, output)
        return Cluster(slurm_cluster(settings, limits, output), settings.workers, script)
    raise ConfigError(f"--dask {words!r}: no cluster (valid: {VALID})")


@contextmanager
def _local(n_workers: int, output: Path) -> Iterator[str]:
    """Start a scheduler in this process, and workers in processes of their own."""
    from distributed import LocalCluster

    with (
        TemporaryDirectory(dir=output, prefix=".dask-") as scratch,
        LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=":0",
            local_directory=scratch,
        ) as cluster,
    ):
        yield cluster.scheduler_address
