"""Every reader takes a file or refuses it by name, whatever is in the file."""

from __future__ import annotations

import os
import resource
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from random import Random

import pytest
from fuzz.readers import READERS, Prepared

from stiff_protocols.contract.errors import StiffBenchError, StiffBenchWarning

FEW, MANY = 20, int(os.environ.get("FUZZ_INPUTS", "200"))
"""Inputs a reader."""
SECONDS = 2.0
"""Of processor time that an input may take: more is a hang."""
ADDRESSES = 2**31
"""Bytes that an input may reserve: more is a blow-up."""


def _accepts(prepared: Prepared) -> bool:
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
    pytest.fail(f"took more than {SECONDS:g} s")  # no `except Exception` of a reader catches it


@pytest.mark.parametrize("n_inputs", [FEW, pytest.param(MANY, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused_by_name(name, n_inputs, tmp_path):
    """The hardest cases, then damage; an input that fails lies in the folder."""
    prepared, rng = READERS[name](tmp_path), Random(name)
    damaged = (prepared.damage(rng.choice(prepared.valid), rng) for _ in range(n_inputs))
    accepted = 0
    with _limits():
        for data in islice(chain(prepared.hard, damaged), n_inputs):
            prepared.path.write_bytes(data)
            accepted += _accepts(prepared)
    assert accepted < 3 / 4 * n_inputs  # or the damage is none
    assert accepted > 0 or n_inputs == FEW
