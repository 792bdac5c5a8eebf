"""Runs the `bench` command for tests: in this process, or as a command of its own."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, chdir, contextmanager
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from unittest import mock

import click
from click.testing import CliRunner
from threadpoolctl import ThreadpoolController

from stiff_bench.api.registered import registry
from stiff_bench.cli import main as cli
from stiff_bench.store.database import stored_statuses

BENCH = Path(sys.executable).with_name("bench")
SIGNALS = (signal.SIGTERM, signal.SIGHUP)
HIDDEN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""Warnings that Python shows to no user."""
PLUGIN_MODULE = "stiffbench_plugin_"
WITH_THREADS = ("numpy", "scipy", "sklearn", "torch")
"""Libraries that bring thread pools of their own."""


def bench_here(
    *words: str | Path, cwd: Path, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run the command in this process: the same code, without a second of start.

    Args:
        words: the command's.
        cwd: its working directory.
        env: variables of its environment besides this process's.
    """
    arguments = [str(word) for word in words]
    with CliRunner().isolation(env=env) as (out, err, _), chdir(cwd), _all_put_back(arguments):
        try:
            cli.main(arguments)
        except SystemExit as left:
            status: Any = left.code
        said = [stream.getvalue().decode() for stream in (out, err)]
    return subprocess.CompletedProcess(arguments, status, *said)


@contextmanager
def _all_put_back(arguments: list[str]) -> Iterator[None]:
    """What a command changes of its process is as before at the end."""
    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(sys, "argv", ["bench", *arguments]))
        stack.enter_context(mock.patch.dict(os.environ))
        stack.enter_context(mock.patch("stiff_bench.plan.registry.entry_points", _installed))
        stack.enter_context(_warnings_as_in_a_command())
        for number in SIGNALS:
            stack.callback(signal.signal, number, signal.getsignal(number))
        if (torch := sys.modules.get("torch")) is not None:
            stack.callback(torch.set_num_threads, torch.get_num_threads())
        pools = _thread_pools(*(name in sys.modules for name in WITH_THREADS))
        stack.enter_context(mock.patch("threadpoolctl.ThreadpoolController", lambda: pools))
        stack.enter_context(pools.limit())
        stack.callback(_forget_plugins_but, set(sys.modules))
        registry.cache_clear()
        stack.callback(registry.cache_clear)
        yield


def _forget_plugins_but(known: set[str]) -> None:
    for name in sys.modules.keys() - known:
        if name.startswith(PLUGIN_MODULE):
            del sys.modules[name]


_installed = functools.cache(entry_points)  # 50 ms a command


@functools.cache  # 10 ms a command
def _thread_pools(*_: bool) -> ThreadpoolController:
    """The thread pools of the libraries that are loaded."""
    return ThreadpoolController()


@contextmanager
def _warnings_as_in_a_command() -> Iterator[None]:
    """Printed, where pytest makes errors of them."""
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


@contextmanager
def started(*words: str, cwd: Path, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A command that runs meanwhile, and is killed at the end if it still does.

    SIGINT interrupts it also where our own process ignores it, as in a CI that was started in the
    background, and would bequeath that.
    """
    with subprocess.Popen(
        [BENCH, *words],
        cwd=cwd,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
        **options,
    ) as command:
        try:
            yield command
        finally:
            command.kill()


def n_stored(folder: Path) -> int:
    """How many cells a folder of results has."""
    return len(stored_statuses(folder))


def wait_until(
    true: Callable[[], object],
    seconds: float = 120.0,
    *,
    running: subprocess.Popen[str] | None = None,
) -> None:
    """Wait for what a command that runs is to do."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        assert running is None or running.poll() is None, running.stderr.read()
        time.sleep(0.02)


def assert_refused(done: subprocess.CompletedProcess[str], *parts: str) -> None:
    """One line on standard error that names the thing, status 2, nothing on standard output."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("bench: error: ")
    for part in parts:
        assert part in lines[0]


@dataclass(frozen=True)
class Leaf:
    """A command that does something, with the words that call it."""

    words: tuple[str, ...]
    command: click.Command

    @property
    def name(self) -> str:
        return " ".join(self.words)


def leaves(command: click.Command, words: tuple[str, ...] = ()) -> Iterator[Leaf]:
    if not isinstance(command, click.Group):
        yield Leaf(words, command)
        return
    for name, below in command.commands.items():
        yield from leaves(below, (*words, name))


LEAVES = list(leaves(cli.bench))
