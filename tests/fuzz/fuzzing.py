"""Feeds one reader damaged input and counts: each is accepted, or refused by one clear line."""

from __future__ import annotations

import re
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

from fuzz.readers import READERS, Prepared

from stiff_protocols.contract.errors import StiffBenchError, StiffBenchWarning

SECONDS = 2.0
"""Of processor time that an input may take: more is a hang."""
MEMORY = 2**29
"""Bytes of memory that an input may fill: more is a blow-up."""
ADDRESSES = 4 * 2**30
"""Bytes that an input may reserve, so that a blow-up ends before the machine's memory does."""


class Hang(BaseException):
    """An input took too long; no reader may catch it."""


class Broken(AssertionError):
    """A reader did with an input what it must not."""


@dataclass(frozen=True)
class Count:
    """What a reader did with its inputs."""

    inputs: int
    accepted: int
    refused: int
    seconds: float


def fuzz(name: str, folder: Path, n_inputs: int, seed: int) -> Count:
    """Give a reader its hard cases and then damaged input, `n_inputs` in all.

    Raises:
        Broken: it raised what is no StiffBenchError, said more than one line or did not name the
            file, took too long or too much memory; the input lies in the folder.
    """
    prepared = READERS[name](folder)
    rng = Random(f"{name} {seed}")
    damaged = (prepared.damage(rng.choice(prepared.valid), rng) for _ in range(n_inputs))
    accepted, start = 0, time.process_time()
    with _limits():
        for number, data in enumerate(islice(chain(prepared.hard, damaged), n_inputs)):
            prepared.path.write_bytes(data)
            try:
                accepted += _accepts(prepared)
            except Broken as error:
                raise Broken(f"{name}, input {number} of seed {seed}: {error}") from error
    seconds = time.process_time() - start
    return Count(n_inputs, accepted, n_inputs - accepted, seconds)


def _accepts(prepared: Prepared) -> bool:
    path = prepared.path
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    before = _memory("VmRSS")
    try:
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        prepared.read(path)
    except StiffBenchError as error:
        names = (path.name, *prepared.also_named)
        if not any(name in str(error) for name in names):
            raise Broken(f"names none of {names}: {str(error)[:300]!r}") from error
        return False
    except (Hang, Exception) as error:
        raise Broken(f"{path}: {type(error).__name__}: {str(error)[:300]}") from error
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        if _memory("VmHWM") - before > MEMORY:
            raise Broken(f"{path}: filled {_memory('VmHWM') - before} bytes of memory")
    return True


def _memory(name: str) -> int:
    (found,) = re.findall(rf"^{name}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.M)
    return int(found) * 1024


@contextmanager
def _limits() -> Iterator[None]:
    """Bound memory and time, and make every warning but ours an error."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    handler = signal.signal(signal.SIGPROF, _hang)
    try:
        resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESSES, hard))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", StiffBenchWarning)
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, handler)


def _hang(number: int, frame: object) -> None:
    raise Hang(f"took more than {SECONDS:g} s")
