"""What a benchmark says besides its time: who it is, and what it must reach.

A group of benchmarks does one piece of work; some of them are ours, the others are peers. The page
of `make perf` shows how many times as fast as each peer ours is (`tests/perf/write_page.py`).
Targets are ratios of one run, never times: machines differ, and are shared.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import pytest

OURS = "stiffbench"


def ours(
    benchmark: Any,
    name: str = OURS,
    *,
    work: float = 1.0,
    unit: str = "call",
    at_least: Mapping[str, float] | None = None,
) -> None:
    """Say that this benchmark is ours.

    Args:
        benchmark: pytest-benchmark's fixture.
        name: which way of ours, where a group holds several.
        work: how much a call does, in `unit`: samples, epochs, FLOP. Rates are compared.
        unit: of the work, singular.
        at_least: peer's name -> how many times its rate ours is to reach.
    """
    benchmark.extra_info |= {"who": name, "ours": True, "work": work, "unit": unit}
    benchmark.extra_info["at_least"] = dict(at_least or {})


def peer(benchmark: Any, name: str, *, work: float = 1.0, unit: str = "call") -> None:
    """Say that this benchmark is a peer's; arguments as of `ours`."""
    benchmark.extra_info |= {"who": name, "ours": False, "work": work, "unit": unit}


def ours_or_peer(
    benchmark: Any, name: str, at_least: Mapping[str, float] | None = None, **work: Any
) -> None:
    """Say whose benchmark this is: ours where the name begins with "stiffbench"."""
    if name.startswith(OURS):
        ours(benchmark, name, at_least=at_least, **work)
    else:
        peer(benchmark, name, **work)


def needed(module: str, name: str) -> Any:
    """Import a peer's module, or skip the benchmark with the peer's name."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        pytest.skip(f"peer {name}: {error} (pip install 'stiffbench[perf]')")


def figure(benchmark: Any, what: str, value: float, unit: str, **target: float | None) -> None:
    """Add a measured value that is no ratio of times: an error, megabytes, an exponent.

    Args:
        benchmark: pytest-benchmark's fixture.
        what: what was measured.
        value: the value.
        unit: as printed: mm, MB.
        **target: `at_most` or `at_least`.
    """
    found = {"what": what, "value": float(value), "unit": unit, "at_most": None, "at_least": None}
    benchmark.extra_info.setdefault("figures", []).append(found | target)
