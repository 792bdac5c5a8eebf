"""Compute fits of a third-party model in a sealed process.

Each process gets the samples to learn from and the rows to predict, never a label that is scored.
It runs under bubblewrap: without network and without the robots, data and results that are shipped.
Of the machine it sees read-only files of Python and stiffbench. Its answer is a file of arrays,
which is checked as third-party data.

    python -m stiff_bench.submissions.sealed_fit FOLDER
"""

from __future__ import annotations

import io
import os
import pickle
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from stiff_bench.model_tools.plugins import model_checks
from stiff_bench.plan.options import Choice, chosen
from stiff_bench.plan.registry import KEY, registry, use_plugin
from stiff_bench.run.fit import FitOutcome, Fitted, fit_and_predict
from stiff_bench.run.fit_process import Limits, bytes_beyond, family, kill
from stiff_bench.submissions.submission import Submission
from stiff_protocols.contract.errors import ConfigError, StiffBenchError, describe_error
from stiff_protocols.contract.evaluation import FitInput
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.record import Cost
from stiff_protocols.contract.types import BenchmarkData, Interval

MODULE = "stiff_bench.submissions.sealed_fit"
BUBBLEWRAP = "bwrap"
INPUT, OUTPUT, LOG, CODE = "input", "output", "log", "code"
"""Names in the folder of a fit."""
ROOT = "/fit"
"""The folder of a fit, as its process sees it."""
SYSTEM = ("/usr", "/lib", "/lib64", "/bin", "/etc/ld.so.cache")
PACKAGES = ("stiff_protocols", "stiff_datasets", "stiff_models", "stiff_bench")
HIDDEN = {"stiff_datasets": ("data", "twins")}
"""Folders of packages that a model does not see: measured data, constants of simulated robots."""
LARGEST_OUTPUT, LARGEST_TMP = 2**24, 2**28
"""Bytes of a file that the process writes, and of its temporary folder."""
MOST_PROCESSES = 64
SECONDS_BETWEEN_LOOKS = 0.05
LOG_LINES, LONGEST_LINE = 10, 300
ARRAYS = ("predicted", "lower", "upper", "path_commands")


class About(BaseModel):
    """Texts and numbers of a sealed process on a model or its fit."""

    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="constants")

    key: Annotated[str, Field(pattern=f"^{KEY.pattern}$", max_length=100)] = "model"
    name: Annotated[str, Field(max_length=200)] = ""
    uses_validation: bool = False
    failed_checks: list[Annotated[str, Field(max_length=2000)]] = []
    failure: Annotated[str, Field(max_length=4000)] = ""
    cause: Annotated[str, Field(max_length=200)] = ""
    warnings: list[Annotated[str, Field(max_length=4000)]] = []
    coverage: float | None = None
    calibration_samples: int = 0
    diagnostics: dict[str, float] = {}


@dataclass(frozen=True)
class SealedModel:
    """A third-party model, run in sealed processes only.

    Attributes:
        submission: its folder.
        limits: limits of each process.
        trust: run without bubblewrap, where it is missing.

    Raises:
        ConfigError: bubblewrap is missing or cannot run, and `trust` is false.
    """

    submission: Submission
    limits: Limits
    trust: bool = False

    def __post_init__(self) -> None:
        if not self.trust and (reason := why_not_sealed()):
            raise ConfigError(
                f"{reason} (valid: a machine with bubblewrap, or --trust, which runs the code as "
                "any program of yours)"
            )

    def described(self, data: BenchmarkData) -> About:
        """Return key and checks of the model, run on some data; its failure if it has one."""
        return self._answer(data)[0]

    def fit(self, given: FitInput) -> FitOutcome:
        """Return the outcome of a fit; its time is the time of the whole process."""
        about, arrays, seconds = self._answer(given)
        if about.failure or about.cause or "predicted" not in arrays:
            failure = about.failure or "the model left no predictions"
            return FitOutcome(failure=failure, cause=about.cause or "no outcome")
        interval = None
        if about.coverage is not None and {"lower", "upper"} <= arrays.keys():
            interval = Interval(arrays["lower"], arrays["upper"], about.coverage)
        fitted = Fitted(
            predicted=arrays["predicted"],
            commands=given.q,
            cost=Cost(seconds, 0.0, 0.0, 0.0, 0),
            interval=interval,
            calibration_samples=about.calibration_samples,
            diagnostics=about.diagnostics,
            path_commands=arrays.get("path_commands"),
        )
        return FitOutcome(fitted, warnings=tuple(about.warnings))

    def _answer(self, given: Any) -> tuple[About, dict[str, Any], float]:
        """Return what a process answers to an input, and its wall time, s."""
        with tempfile.TemporaryDirectory(prefix="bench-sealed-") as name:
            folder = Path(name)
            shutil.copytree(self.submission.code, folder / CODE)
            card = self.submission.card
            words = {"plugin": card.plugin, "model": card.model, "threads": self.limits.threads}
            (folder / INPUT).write_bytes(pickle.dumps((words, given)))
            (folder / OUTPUT).touch()
            start = time.monotonic()
            failure = self._run(folder)
            seconds = time.monotonic() - start
            if failure:
                return About(failure=failure, cause="sealed process"), {}, seconds
            try:
                return *read_answer(folder / OUTPUT), seconds
            except (ValueError, KeyError, OSError, zipfile.BadZipFile) as error:
                reason = f"its answer cannot be read: {describe_error(error)[:500]}"
                return About(failure=reason, cause="no outcome"), {}, seconds

    def _run(self, folder: Path) -> str:
        """Run the process of a folder to its end; return why it failed, or ""."""
        root = str(folder) if self.trust else ROOT
        words = [sys.executable, "-P", "-m", MODULE, root]
        if not self.trust:
            words = [BUBBLEWRAP, *_seal(folder), "--", *words]
        with (folder / LOG).open("wb") as log:
            process = subprocess.Popen(
                words,
                cwd=folder,
                env=_environment(root, self.limits.threads),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=_lower_limits,
            )
            try:
                failure = self._watched(process)
            finally:
                kill(family(process.pid))
                process.wait()
        if not failure and process.returncode:
            failure = f"its process ended with status {process.returncode}"
        lines = (folder / LOG).read_bytes()[-20_000:].decode(errors="replace").splitlines()
        last_lines = [line[:LONGEST_LINE] for line in lines[-LOG_LINES:]]
        return "\n".join([failure, *last_lines]) if failure else ""

    def _watched(self, process: subprocess.Popen[bytes]) -> str:
        """Wait for a process within its limits; return which one it broke, or ""."""
        limits, start = self.limits, time.monotonic()
        while process.poll() is None:
            if limits.timeout_s is not None and time.monotonic() - start > limits.timeout_s:
                return f"took longer than {limits.timeout_s:g} s"
            alive = family(process.pid)
            if len(alive) > MOST_PROCESSES:
                return f"started more than {MOST_PROCESSES} processes"
            if bytes_beyond(limits, alive):
                return f"took more than {(limits.memory_bytes or 0) / 2**20:.0f} MiB of memory"
            time.sleep(SECONDS_BETWEEN_LOOKS)
        return ""


def why_not_sealed() -> str:
    """Return why bubblewrap cannot run here; "" if it can."""
    if shutil.which(BUBBLEWRAP) is None:
        return f"{BUBBLEWRAP} is not installed, so code of others cannot be sealed"
    words = [BUBBLEWRAP, "--unshare-all", "--ro-bind", "/", "/", "true"]
    tried = subprocess.run(words, capture_output=True, text=True, check=False)
    return "" if not tried.returncode else f"{BUBBLEWRAP} cannot run here: {tried.stderr.strip()}"


def _seal(folder: Path) -> Iterator[str]:
    """Yield the options of bubblewrap."""
    yield from ("--unshare-all", "--die-with-parent", "--new-session", "--proc", "/proc")
    yield from ("--dev", "/dev")
    for place in ("/dev/shm", "/tmp"):
        yield from ("--size", str(LARGEST_TMP), "--tmpfs", place)
    for path in map(Path, SYSTEM):
        if path.is_symlink():
            yield from ("--symlink", os.readlink(path), str(path))
        elif path.exists():
            yield from ("--ro-bind", str(path), str(path))
    packages = {name: _folder_of(name) for name in PACKAGES}
    for place in dict.fromkeys((sys.base_prefix, sys.prefix, *map(str, packages.values()))):
        yield from ("--ro-bind", place, place)
    for name, hidden in HIDDEN.items():
        for part in hidden:
            yield from ("--tmpfs", str(packages[name] / part))
    yield from ("--ro-bind", str(folder), ROOT)
    yield from ("--bind", str(folder / OUTPUT), f"{ROOT}/{OUTPUT}", "--chdir", "/tmp")
    yield from ("--remount-ro", "/")


def _folder_of(package: str) -> Path:
    spec = find_spec(package)
    assert spec is not None and spec.submodule_search_locations is not None
    return Path(next(iter(spec.submodule_search_locations))).resolve()


def _environment(root: str, threads: int) -> dict[str, str]:
    """Return the variables of the process; it gets no other, such as a token."""
    home = root if root != ROOT else "/tmp"
    paths = dict.fromkeys(str(_folder_of(name).parent) for name in PACKAGES)
    numbers = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(threads))
    about_python = {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": os.pathsep.join(paths)}
    return {"PATH": "/usr/bin:/bin", "HOME": home, "TMPDIR": home, **numbers, **about_python}


def _lower_limits() -> None:
    """Limit the files of the process before any code of others runs."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST_OUTPUT, LARGEST_OUTPUT))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def read_answer(file: Path) -> tuple[About, dict[str, Any]]:
    """Read the answer of a sealed process: a text and arrays of numbers.

    Raises:
        ValueError, KeyError, OSError, BadZipFile: it is another file, or too large.
    """
    if file.stat().st_size > LARGEST_OUTPUT:
        raise ValueError(f"larger than {LARGEST_OUTPUT} bytes")
    with zipfile.ZipFile(file) as parts:
        if sum(part.file_size for part in parts.infolist()) > LARGEST_OUTPUT:
            raise ValueError(f"unpacks to more than {LARGEST_OUTPUT} bytes")
    with np.load(file, allow_pickle=False) as answer:
        about = About.model_validate_json(str(answer["about"]))
        arrays = {name: answer[name] for name in ARRAYS if name in answer}
    for name, values in arrays.items():
        if values.dtype != np.float64 or values.ndim != 2:
            raise ValueError(f"{name} is {values.dtype} of {values.ndim} dimensions")
    return about, arrays


# in the sealed process


def answer(root: Path) -> None:
    """Compute what a folder asks for, and write the answer."""
    words, given = pickle.loads((root / INPUT).read_bytes())  # from the verifier
    arrays: Mapping[str, Any] = {}
    try:
        plugin = root / CODE / words["plugin"]
        use_plugin(plugin)
        ((choice,),) = chosen({"model": (words["model"],)}, (), registry()).values()
        if registry().origins.get(choice.info.key) != str(plugin):
            raise ConfigError(f"{words['model']}: is not a model of {words['plugin']}")
        if isinstance(given, BenchmarkData):
            about = _described(choice, given)
        else:
            about, arrays = _computed(choice, given)
    except StiffBenchError as error:
        about = About(failure=str(error)[:4000], cause=type(error).__name__)
    buffer = io.BytesIO()
    np.savez(buffer, about=np.array(about.model_dump_json()), **arrays)
    (root / OUTPUT).write_bytes(buffer.getvalue())


def _described(choice: Choice[ModelInfo], data: BenchmarkData) -> About:
    info = choice.info
    if reason := choice.missing():
        return About(failure=reason, cause="missing")
    quick = replace(choice, params={**info.quick, **choice.params})
    failed = [str(check) for check in model_checks(quick, data) if check.status == "failed"]
    return About(
        key=info.key,
        name=choice.name,
        uses_validation=info.uses_validation,
        failed_checks=[text[:2000] for text in failed],
    )


def _computed(choice: Choice[ModelInfo], given: FitInput) -> tuple[About, dict[str, Any]]:
    outcome = fit_and_predict(choice, given)
    failure, cause = outcome.failure[:4000], outcome.cause[:200]
    if (fitted := outcome.fitted) is None:
        return About(failure=failure, cause=cause), {}
    if not np.array_equal(fitted.commands, given.q):
        return About(failure="the protocol corrects commands", cause="protocol"), {}
    arrays = {"predicted": fitted.predicted, "path_commands": fitted.path_commands}
    if (interval := fitted.interval) is not None:
        arrays |= {"lower": interval.lower, "upper": interval.upper}
    about = About(
        warnings=[text[:4000] for text in outcome.warnings],
        coverage=None if interval is None else interval.coverage,
        calibration_samples=fitted.calibration_samples,
        diagnostics=dict(fitted.diagnostics),
    )
    return about, {name: values for name, values in arrays.items() if values is not None}


if __name__ == "__main__":
    answer(Path(sys.argv[1]))
