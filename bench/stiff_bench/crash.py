"""How a cell's own process can end without a result, in words."""

from __future__ import annotations

import signal
from dataclasses import dataclass

TIMED_OUT, OUT_OF_MEMORY = "timed out", "out of memory"


@dataclass(frozen=True)
class Crash:
    """A process that ended without a result.

    Attributes:
        cause: in a word or two that count it: "SIGKILL", "exit status 3", "timed out".
        reason: the whole sentence.
        log: the last lines that it printed.
        server_gone: perhaps another cell's process has killed the server of all.
    """

    cause: str
    reason: str
    log: tuple[str, ...] = ()
    server_gone: bool = False


SERVER_GONE = 255
"""Exit code that multiprocessing gives where the server that forks the processes has ended."""


def ended(exit_code: int, seconds: float, log: tuple[str, ...]) -> Crash:
    """Return what became of a process with this exit code (negative: a signal's number)."""
    if exit_code >= 0:
        cause = f"exit status {exit_code}"
        if exit_code == SERVER_GONE:
            cause += ", or its server was killed"
        said = f"its process ended after {seconds:.1f} s without a result ({cause})"
        return Crash(cause, said, log, server_gone=exit_code == SERVER_GONE)
    try:
        name = signal.Signals(-exit_code).name
    except ValueError:
        name = f"signal {-exit_code}"
    hint = ", as the system does where memory runs out" if name == "SIGKILL" else ""
    return Crash(name, f"its process was ended by {name} after {seconds:.1f} s{hint}", log)


def no_result(why: str, log: tuple[str, ...]) -> Crash:
    """Return the end of a process that sent what is no result."""
    return Crash("no result", f"its process sent no result: {why}", log)


def timed_out(limit_s: float, log: tuple[str, ...]) -> Crash:
    """Return the end of a process that took too long."""
    return Crash(TIMED_OUT, f"took longer than --timeout {limit_s:g} s", log)


def out_of_memory(limit_bytes: int, taken_bytes: int, log: tuple[str, ...]) -> Crash:
    """Return the end of a process that took too much memory."""
    reason = f"took {mebibytes(taken_bytes)}, more than --memory {mebibytes(limit_bytes)}"
    return Crash(OUT_OF_MEMORY, reason, log)


def mebibytes(size: int) -> str:
    """Return a size for people."""
    return f"{size / 2**20:.0f} MiB"
