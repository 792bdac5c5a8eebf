"""Runs the `bench` command for tests: in this process, or as a command of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

from click.testing import CliRunner

from stiff_bench.cli import main

BENCH = Path(sys.executable).with_name("bench")
SIGNALS = (signal.SIGTERM, signal.SIGHUP)


def bench_here(
    *words: str | Path, cwd: Path, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run the command in this process: the same code, without a second of start."""
    arguments = [str(word) for word in words]
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    status: Any = 0
    with (
        CliRunner().isolation(env=env) as (out, err, _),
        chdir(cwd),
        mock.patch.object(sys, "argv", ["bench", *arguments]),
        mock.patch.dict(os.environ),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("default")  # as in a command; pytest makes errors of them
        try:
            main(arguments)
        except SystemExit as left:
            status = left.code
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        said = [stream.getvalue().decode() for stream in (out, err)]
    return subprocess.CompletedProcess(arguments, status, *said)


def bench(*words: str, cwd: Path, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [BENCH, *words], cwd=cwd, capture_output=True, text=True, timeout=300, **options
    )


@contextmanager
def started(*words: str, cwd: Path, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A command that runs meanwhile, and is killed at the end if it still does."""
    with subprocess.Popen(
        [BENCH, *words],
        cwd=cwd,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **options,
    ) as command:
        try:
            yield command
        finally:
            command.kill()


def peak_mib(*words: str | Path) -> float:
    """Run a command to its end; the most memory that it took, MiB."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)  # it has been waited for
    assert process.returncode == 0
    return usage.ru_maxrss / 1024


def assert_refused(done: subprocess.CompletedProcess[str], *parts: str) -> None:
    """One line on standard error that names the thing, status 2, nothing on standard output."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("bench: error: ")
    for part in parts:
        assert part in lines[0]
