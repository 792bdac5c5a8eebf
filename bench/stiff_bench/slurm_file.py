"""Workers that are jobs of Slurm, as a TOML file describes them; dask-jobqueue submits the jobs.

::

    workers = 20              # jobs, and so cells at once
    queue = "cpu"             # partition
    account = "robotics"
    walltime = "08:00:00"
    memory = "8GiB"           # of a job
    setup = ["module load python", "source ~/bench/bin/activate"]
    directives = ["--constraint=avx512"]
    python = "~/bench/bin/python"
    interface = "ib0"         # network on which scheduler and workers meet
    logs = "slurm"            # folder, in --output
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ByteSize, ConfigDict, Field, ValidationError

from stiff_bench.cell_process import Limits
from stiff_protocols.errors import ConfigError
from stiff_protocols.files import make_folder
from stiff_protocols.toml_file import read_toml

if TYPE_CHECKING:
    from dask_jobqueue import SLURMCluster


class SlurmFile(BaseModel):
    """The file's settings.

    Attributes:
        workers: number of jobs.
        walltime: of a job, as Slurm writes it.
        memory: of a job.
        queue, account: of Slurm; None: its defaults.
        setup: lines of the job script before the worker starts.
        directives: further `#SBATCH` lines.
        python: that has stiffbench; None: the one that runs now.
        interface: of the network; None: the default route's.
        logs: folder of the jobs' output.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    workers: Annotated[int, Field(ge=1, le=10_000)]
    walltime: Annotated[str, Field(pattern=r"^(\d+-)?\d+:\d\d:\d\d$")]
    memory: ByteSize
    queue: str | None = None
    account: str | None = None
    setup: list[str] = []
    directives: list[str] = []
    python: str | None = None
    interface: str | None = None
    logs: str = "slurm"


def read_slurm_file(path: Path) -> SlurmFile:
    """Read the file.

    Raises:
        ConfigError: it cannot be read, or a setting is unknown, missing or wrong.
    """
    said = f"--dask slurm:{path}"
    try:
        return SlurmFile(**read_toml(path))
    except OSError as error:
        raise ConfigError(f"{said}: cannot be read: {error.strerror or error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"]))
        found = "" if first["type"] == "missing" else f" {first['input']!r}"
        valid = ", ".join(SlurmFile.model_fields)
        raise ConfigError(f"{said}: {name}{found}: {first['msg']} (settings: {valid})") from error
    except ValueError as error:
        raise ConfigError(f"{said}: no TOML: {error}") from error


@contextmanager
def slurm_cluster(settings: SlurmFile, limits: Limits, output: Path) -> Iterator[str]:
    """Submit the jobs; they end with the block. The scheduler is in this process.

    Raises:
        ConfigError: there is no Slurm here.
    """
    if shutil.which("sbatch") is None:
        raise ConfigError("--dask slurm: no sbatch here; --plan shows the script of a job")
    make_folder(_logs(settings, output))
    with _jobs(settings, limits, output) as cluster:
        cluster.scale(jobs=settings.workers)
        yield cluster.scheduler_address


def job_script(settings: SlurmFile, limits: Limits, output: Path) -> str:
    """Return the script of one job, as it would be submitted."""
    with _jobs(settings, limits, output) as cluster:
        script: str = cluster.job_script()
        return script


def _logs(settings: SlurmFile, output: Path) -> Path:
    """Return the folder of the jobs' output; dask-jobqueue would make it though none is sent."""
    return output.resolve() / settings.logs


def _jobs(settings: SlurmFile, limits: Limits, output: Path) -> SLURMCluster:
    from dask_jobqueue import SLURMCluster

    options: dict[str, Any] = {
        "queue": settings.queue,
        "account": settings.account,
        "walltime": settings.walltime,
        "memory": f"{settings.memory / 2**30:g}GiB",
        "job_script_prologue": settings.setup,
        "job_extra_directives": [
            f"--output={_logs(settings, output)}/%j.out",
            *settings.directives,
        ],
        "interface": settings.interface,
        "local_directory": str(output.resolve() / "dask"),
    }
    if settings.python is not None:
        options["python"] = str(Path(settings.python).expanduser())
    return SLURMCluster(
        cores=1,  # of Dask's: threads of the worker, which runs one cell at once
        processes=1,
        job_cpu=limits.threads,
        scheduler_options={"dashboard": False, "dashboard_address": ":0"},
        **options,
    )
