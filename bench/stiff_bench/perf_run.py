"""Runs the benchmarks of a checkout in a process of their own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from stiff_bench.perf_report import PerfReport, read_report
from stiff_protocols.errors import ConfigError, StoreError
from stiff_protocols.files import written_whole

BENCHMARKS = Path(__file__).resolve().parents[2] / "tests" / "perf"
_WRONG_WORDS = 4  # pytest's exit status


def run_benchmarks(
    only: str, *, long: bool, json_file: Path | None, folder: Path = BENCHMARKS
) -> PerfReport:
    """Run the benchmarks and return what they measured; their progress goes to standard error.

    Args:
        only: pytest's -k expression over the benchmarks' names; "" for all.
        long: those of several minutes, too.
        json_file: where pytest-benchmark's own JSON is kept.
        folder: of the benchmarks.

    Raises:
        ConfigError: this is no checkout, pytest-benchmark is missing, or `only` names nothing.
        StoreError: `json_file` cannot be written.
    """
    check_usable(json_file, folder)
    with tempfile.TemporaryDirectory() as scratch:
        benchmarks, outcomes = Path(scratch) / "benchmarks.json", Path(scratch) / "outcomes.xml"
        words = [
            *map(str, sorted(folder.glob("perf_*.py"))),
            "--benchmark-only",
            f"--benchmark-json={benchmarks}",
        ]
        words += [f"--junitxml={outcomes}", "--benchmark-quiet", "-v", "--tb=short", "-k", only]
        words += ["-W", "ignore:Not saving anything"]  # said where every benchmark was skipped
        words += ["-p", "no:cacheprovider", "-p", "no:xdist", "-m", "" if long else "not slow"]
        # One thread, as a run of many cells has it: two that wait for each other on a busy
        # machine measure the machine.
        threads = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS")}
        outer = {name: text for name, text in os.environ.items() if not name.startswith("PYTEST_")}
        status = subprocess.run(
            [sys.executable, "-m", "pytest", *words],
            cwd=folder.parents[1],
            env=outer | threads,
            stdout=sys.stderr.fileno(),
            check=False,
        ).returncode
        report = read_report(benchmarks, outcomes)
        if status == _WRONG_WORDS:
            raise ConfigError(
                f"--only {only!r}: pytest's -k cannot read it (valid: word, not a or b)"
            )
        if not (report.timings or report.skipped or report.failed):
            longer = "" if long else " (with --long there are more)"
            raise ConfigError(f"--only {only!r}: no benchmark's name matches{longer}")
        if json_file is not None and benchmarks.exists():
            with written_whole(json_file) as temporary:
                temporary.write_bytes(benchmarks.read_bytes())
        return report


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise StoreError(f"--json {path}: is a folder, expected the name of a file")
    if not path.absolute().parent.is_dir():
        raise StoreError(f"--json {path}: there is no folder {path.absolute().parent}")


def check_usable(json_file: Path | None, folder: Path = BENCHMARKS) -> None:
    """See that benchmarks can run and the file can be written; errors as `run_benchmarks`."""
    if json_file is not None:
        _check_file(json_file)
    if not folder.is_dir():
        raise ConfigError(
            "bench perf runs the benchmarks of a checkout (tests/perf), and this stiffbench is "
            "installed without one: clone its repository and pip install -e '.[perf]' there"
        )
    if find_spec("pytest_benchmark") is None:
        raise ConfigError("bench perf needs pytest-benchmark: pip install 'stiffbench[perf]'")
