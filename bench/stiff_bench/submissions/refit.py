"""Compute fits of a submission again, in a process that the verifier starts.

The plugin is imported here and in the processes of the fits, never by the verifier. The verifier
reads the results from a SQLite file, so nothing of the plugin's is unpickled there either.

    python -m stiff_bench.submissions.refit REQUEST.json
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from pydantic import BaseModel

from stiff_bench.paper.study_file import Study, find_study
from stiff_bench.plan.cells import CellTask, cell_tasks
from stiff_bench.plan.registry import Registry, build_registry
from stiff_bench.run.fit_process import Limits
from stiff_bench.run.isolate import LocalProcesses
from stiff_bench.run.machine import prepare
from stiff_bench.run.runner import run_cells
from stiff_bench.store.database import FILE, ResultStore, read_results
from stiff_bench.submissions.published_results import Place, place_of
from stiff_bench.submissions.submission import Scope
from stiff_models.io.cache_folder import OFF, VARIABLE
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.record import CellResult

MODULE = "stiff_bench.submissions.refit"
START_S = 120.0
"""Time in addition to the fits: start, import of the plugin, data sets."""
SECONDS_PER_DATASET = 5.0
PASSED_ON = ("PATH", "PYTHONPATH", "LANG", "LC_ALL", "TZ", "VIRTUAL_ENV")
"""Environment variables that the process gets; it gets no other, such as a token."""
SET = {VARIABLE: OFF, "PYTHONDONTWRITEBYTECODE": "1"}
"""Environment variables that it gets in addition: no cache of trainings is shared with it."""
LONGEST_OUTPUT = 2000


class Request(BaseModel):
    """Fits to compute.

    Attributes:
        study: name, or file.
        scope: "lite" or "full".
        model: name, with options.
        plugin: file.
        places: splits of the fits.
        output: folder of the results.
        timeout_s, memory_bytes: limits per fit.
        jobs: number of parallel fits.
    """

    study: str
    scope: Scope
    model: str
    plugin: Path
    places: list[Place]
    output: Path
    timeout_s: float
    memory_bytes: int
    jobs: int = 1

    @property
    def longest_s(self) -> float:
        """Wall time after which the process is killed, s."""
        n_datasets = len({dataset for dataset, *_ in self.places})
        fits = self.timeout_s * (1 + len(self.places) // self.jobs)
        return START_S + SECONDS_PER_DATASET * n_datasets + fits


def study_tasks(
    study: Study, scope: Scope, model: str, registry: Registry, places: Sequence[Place] = ()
) -> list[CellTask]:
    """Return the fits of one model in a study.

    Args:
        study: that is shipped, or of a file.
        scope: "lite" for its short version.
        model: name, with options.
        registry: with the model.
        places: only these splits, and the data sets that they need; none: all.
    """
    version = study.lite_version() if scope == "lite" else study
    plans = version.with_models([model]).plans(registry, output=Path(), command="")
    if places:
        names = {dataset for dataset, *_ in places}
        plans = [
            replace(
                plan, datasets=tuple(dataset for dataset in plan.datasets if dataset.name in names)
            )
            for plan in plans
        ]
    tasks = cell_tasks(*plans)
    return [
        task for task in tasks if not places or place_of(task.cell, task.presentation) in places
    ]


def recompute(request: Request) -> list[CellResult]:
    """Return the fits of a request, computed in a process without our environment.

    Raises:
        StiffBenchError: the process ended without results; the message has its last words.
    """
    with tempfile.TemporaryDirectory(prefix="bench-verify-") as folder:
        home = Path(folder) / "home"
        home.mkdir()
        code = Path(folder) / "code"  # the plugin does not see the submission
        shutil.copytree(request.plugin.parent, code)
        copied = request.model_copy(update={"plugin": code / request.plugin.name})
        file = Path(folder) / "request.json"
        file.write_text(copied.model_dump_json(), encoding="utf-8")
        passed = {name: os.environ[name] for name in PASSED_ON if name in os.environ}
        words = [sys.executable, "-P", "-m", MODULE, str(file)]
        # what it prints goes to a file: a pipe would be filled
        with (Path(folder) / "output").open("w+b") as output:
            process = subprocess.Popen(
                words,
                cwd=home,
                env={**passed, **SET, "HOME": str(home), "TMPDIR": folder},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                status = process.wait(request.longest_s)
            except subprocess.TimeoutExpired:
                raise StiffBenchError(f"took longer than {request.longest_s:.0f} s") from None
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            output.seek(max(output.tell() - LONGEST_OUTPUT, 0))
            lines = output.read().decode(errors="replace").splitlines()
        if status != 0:
            raise StiffBenchError(lines[-1] if lines else f"exit status {status}")
        file = request.output / FILE
        if file.is_symlink() or not file.is_file():
            raise StiffBenchError("the code left no results")
        try:
            return read_results(request.output)
        except (KeyError, TypeError, ValueError) as error:  # written by the code itself
            raise StiffBenchError(f"its results cannot be read: {error}") from error


def main(file: Path) -> None:
    """Compute the fits of a request."""
    prepare()
    request = Request.model_validate_json(file.read_bytes())
    registry = build_registry()
    registry.add_file(request.plugin)
    study = find_study(request.study)
    tasks = study_tasks(study, request.scope, request.model, registry, request.places)
    limits = Limits(timeout_s=request.timeout_s, memory_bytes=request.memory_bytes)
    execution = LocalProcesses(at_once=request.jobs, limits=limits)
    run_cells(tasks, "bench verify", ResultStore(request.output), execution)


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except StiffBenchError as error:
        print(error)
        sys.exit(2)
