"""Feeds one reader damaged input and counts: each is accepted, or refused by one clear line."""

from __future__ import annotations

import resource
import signal
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from random import Random

from fuzz.readers import Reader
from stiff_protocols.errors import StiffBenchError, StiffBenchWarning

SECONDS = 2.0
"""Of processor time that an input may take: more is a hang."""
MEMORY = 2**30
"""Bytes of address space that an input may add: more is a blow-up."""


class Hang(BaseException):
    """An input took too long; no reader may catch it."""


class Broken(AssertionError):
    """A reader did with an input what it must not."""


@dataclass(frozen=True)
class Count:
    """What a reader did with its inputs."""

    reader: str
    inputs: int
    accepted: int
    refused: int
    seconds: float


def fuzz(reader: Reader, folder: Path, n_inputs: int, seed: int) -> Count:
    """Give a reader its hard cases and then damaged input, `n_inputs` in all.

    Raises:
        Broken: it raised what is no StiffBenchError, said more than one line or did not name the
            file, took too long or too much memory; the input lies in the folder.
    """
    prepared = reader.prepare(folder)
    rng = Random(f"{reader.name} {seed}")
    damaged = (prepared.damage(rng.choice(prepared.valid), rng) for _ in range(n_inputs))
    accepted, start = 0, time.process_time()
    with _limits():
        for number, data in enumerate(islice(chain(prepared.hard, damaged), n_inputs)):
            prepared.path.write_bytes(data)
            try:
                accepted += _accepts(prepared.read, prepared.path)
            except Broken as error:
                raise Broken(f"{reader.name}, input {number} of seed {seed}: {error}") from error
    seconds = time.process_time() - start
    return Count(reader.name, n_inputs, accepted, n_inputs - accepted, seconds)


def _accepts(read, path: Path) -> bool:
    try:
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        read(path)
    except StiffBenchError as error:
        _check_refusal(error, path)
        return False
    except (Hang, Exception) as error:
        raise Broken(f"{path}: {type(error).__name__}: {str(error)[:300]}") from error
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return True


def _check_refusal(error: StiffBenchError, path: Path) -> None:
    message = str(error)
    if len(" ".join(message.split())) == 0 or path.name not in message:
        raise Broken(f"{path}: is not named by {message[:300]!r}") from error
    cause = error.__context__
    while cause is not None:
        if isinstance(cause, MemoryError):
            raise Broken(f"{path}: asked for too much memory: {message[:300]!r}") from error
        cause = cause.__context__


@contextmanager
def _limits() -> Iterator[None]:
    """Bound memory and time, and make every warning but ours an error."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    handler = signal.signal(signal.SIGPROF, _hang)
    try:
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, hard))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", StiffBenchWarning)
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, handler)


def _hang(number: int, frame: object) -> None:
    raise Hang(f"took more than {SECONDS:g} s")
