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


def ours(
    benchmark: Any,
    name: str = "stiffbench",
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
    benchmark.extra_info |= {
        "who": name,
        "ours": True,
        "work": work,
        "unit": unit,
        "at_least": dict(at_least or {}),
    }


def peer(benchmark: Any, name: str, *, work: float = 1.0, unit: str = "call") -> None:
    """Say that this benchmark is a peer's; arguments as of `ours`."""
    benchmark.extra_info |= {"who": name, "ours": False, "work": work, "unit": unit}


def needed(module: str, name: str) -> Any:
    """Import a peer's module, or skip the benchmark with the peer's name."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        pytest.skip(f"peer {name}: {error} (pip install 'stiffbench[perf]')")


def figure(
    benchmark: Any,
    what: str,
    value: float,
    unit: str,
    *,
    at_most: float | None = None,
    at_least: float | None = None,
) -> None:
    """Add a measured value that is no ratio of times: an error, megabytes, an exponent.

    Args:
        benchmark: pytest-benchmark's fixture.
        what: what was measured.
        value: the value.
        unit: as printed: mm, MB.
        at_most, at_least: its target; None: it has none.
    """
    found = {
        "what": what,
        "value": float(value),
        "unit": unit,
        "at_most": at_most,
        "at_least": at_least,
    }
    benchmark.extra_info.setdefault("figures", []).append(found)
