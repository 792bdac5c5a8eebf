"""Check that every reader reads a damaged file or refuses it by name."""

from __future__ import annotations

import os
import resource
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

import pytest
from fuzz.readers import READERS, PreparedReader

from stiff_protocols.contract.errors import StiffBenchError, StiffBenchWarning

FEW, MANY = 8, int(os.environ.get("FUZZ_INPUTS", "200"))
"""Number of inputs per reader."""
SECONDS = 2.0
"""Limit of processor time per input; more is a hang."""
ADDRESSES = 2**31
"""Limit of reserved bytes per input; more is a blow-up."""


def _accepts(prepared: PreparedReader) -> bool:
    accepted, names = True, (prepared.path.name, *prepared.also_named)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        prepared.read(prepared.path)
    except StiffBenchError as error:
        assert any(name in str(error) for name in names), str(error)[:300]
        accepted = False
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return accepted


@contextmanager
def _limits() -> Iterator[None]:
    """Limit memory and time, and turn every warning except ours into an error."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    handler = signal.signal(signal.SIGPROF, _hang)
    try:
        resource.setrlimit(resource.RLIMIT_AS, (used_bytes + ADDRESSES, hard))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", StiffBenchWarning)
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, handler)


def _hang(number: int, frame: object) -> None:
    pytest.fail(f"took more than {SECONDS:g} s")  # no `except Exception` of a reader catches it


@pytest.mark.parametrize("n_inputs", [FEW, pytest.param(MANY, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused_by_name(name, n_inputs, tmp_path):
    """Damage valid inputs; a failing input stays in the folder."""
    reader, rng = READERS[name](tmp_path), Random(name)
    n_accepted = 0
    with _limits():
        for _ in range(n_inputs):
            reader.path.write_bytes(reader.damage(rng.choice(reader.valid), rng))
            n_accepted += _accepts(reader)
    assert n_accepted < 3 / 4 * n_inputs  # more would mean that the damage has no effect
    assert n_accepted > 0 or n_inputs == FEW
