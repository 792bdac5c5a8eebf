"""Run the `bench` command for tests: in this process, or in its own process."""

from __future__ import annotations

import functools
import io
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, chdir, contextmanager, redirect_stderr, redirect_stdout
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from unittest import mock

from threadpoolctl import ThreadpoolController

from stiff_bench.plan.registry import registry
from stiff_bench.store.database import stored_statuses
from stiffbench.main import main

BENCH = Path(sys.executable).with_name("bench")
SIGNALS = (signal.SIGTERM, signal.SIGHUP)
HIDDEN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""Warnings that Python hides from users."""
PLUGIN_MODULE = "stiffbench_plugin_"
WITH_THREADS = ("numpy", "scipy", "sklearn", "torch")
"""Libraries with their own thread pools."""


def bench_here(
    *words: str | Path, cwd: Path, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run the command in this process: the same code without the second of start-up.

    Args:
        words: words of the command.
        cwd: its working directory.
        env: environment variables to add to this process's.
    """
    arguments = [str(word) for word in words]
    status: Any = None
    out, err = Stream(), Stream()
    with (
        redirect_stdout(out),
        redirect_stderr(err),
        chdir(cwd),
        _all_put_back(arguments, env or {}),
    ):
        try:
            main(arguments)
        except SystemExit as exit_error:
            status = exit_error.code
    output = [stream.bytes.getvalue().decode() for stream in (out, err)]
    return subprocess.CompletedProcess(arguments, status, *output)


class Stream(io.TextIOWrapper):
    """A text stream in memory; what cannot be encoded is escaped, as on standard error."""

    def __init__(self) -> None:
        self.bytes = io.BytesIO()
        super().__init__(self.bytes, "utf-8", "backslashreplace", write_through=True)


@contextmanager
def _all_put_back(arguments: list[str], env: Mapping[str, str]) -> Iterator[None]:
    """Undo what a command changes in its process."""
    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(sys, "argv", ["bench", *arguments]))
        stack.enter_context(mock.patch.dict(os.environ, env))
        stack.enter_context(mock.patch("stiff_bench.plan.registry.entry_points", _installed))
        stack.enter_context(_warnings_as_in_a_command())
        for number in SIGNALS:
            stack.callback(signal.signal, number, signal.getsignal(number))
        if (torch := sys.modules.get("torch")) is not None:
            stack.callback(torch.set_num_threads, torch.get_num_threads())
        pools = _thread_pools(*(name in sys.modules for name in WITH_THREADS))
        stack.enter_context(mock.patch("threadpoolctl.ThreadpoolController", lambda: pools))
        stack.enter_context(pools.limit())
        stack.callback(_forget_plugins_since, set(sys.modules))
        registry.cache_clear()
        stack.callback(registry.cache_clear)
        yield


def _forget_plugins_since(modules_before: set[str]) -> None:
    for name in sys.modules.keys() - modules_before:
        if name.startswith(PLUGIN_MODULE):
            del sys.modules[name]


_installed = functools.cache(entry_points)  # 50 ms per command


@functools.cache  # 10 ms per command
def _thread_pools(*_: bool) -> ThreadpoolController:
    """Return the thread pools of the loaded libraries."""
    return ThreadpoolController()


@contextmanager
def _warnings_as_in_a_command() -> Iterator[None]:
    """Print warnings; pytest would raise them as errors."""
    with warnings.catch_warnings():
        warnings.resetwarnings()
        for hidden in HIDDEN:
            warnings.simplefilter("ignore", hidden)
        warnings.showwarning = lambda message, category, name, line, *_: sys.stderr.write(
            warnings.formatwarning(message, category, name, line)
        )
        yield


def bench(*words: str, cwd: Path, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [BENCH, *words], cwd=cwd, capture_output=True, text=True, timeout=300, **options
    )


def _stoppable() -> None:
    for number in (signal.SIGINT, signal.SIGQUIT):
        signal.signal(number, signal.SIG_DFL)


@contextmanager
def started(*words: str, cwd: Path, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Run a command in the background and kill it at the end if it still runs.

    SIGINT and SIGQUIT stop it even if this process ignores them, as a CI job in the background.
    """
    with subprocess.Popen(
        [BENCH, *words],
        cwd=cwd,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=_stoppable,
        **options,
    ) as command:
        try:
            yield command
        finally:
            command.kill()


def n_stored(folder: Path) -> int:
    """Return the number of cells in a folder of results."""
    return len(stored_statuses(folder))


def wait_until(
    true: Callable[[], object],
    seconds: float = 120.0,
    *,
    running: subprocess.Popen[str] | None = None,
) -> None:
    """Wait until a condition is true; `running` must run until then."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        assert running is None or running.poll() is None, running.stderr.read()
        time.sleep(0.02)


def assert_refused(done: subprocess.CompletedProcess[str], *parts: str) -> None:
    """Check for status 2, one line on standard error, and nothing on standard output."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("bench: error: ")
    for part in parts:
        assert part in lines[0]
