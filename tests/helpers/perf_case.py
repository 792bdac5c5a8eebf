"""What a benchmark says besides its time: who it is, and what it must reach.

A group of benchmarks does one piece of work; some of them are ours, the others are peers. The page
of `make perf` shows how many times as fast as each peer ours is (`tests/perf/write_page.py`).
Targets are ratios of one run, never times: machines differ, and are shared.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

OURS = "stiffbench"


def ours_or_peer(
    benchmark: Any,
    name: str = OURS,
    at_least: Mapping[str, float] | None = None,
    *,
    work: float = 1.0,
    unit: str = "call",
) -> None:
    """Say whose benchmark this is: ours where the name begins with "stiffbench" or "bench".

    Args:
        benchmark: pytest-benchmark's fixture.
        name: which way, where a group holds several.
        at_least: peer's name -> how many times its rate ours is to reach.
        work: how much a call does, in `unit`: samples, epochs, FLOP. Rates are compared.
        unit: of the work, singular.
    """
    about = {"ours": name.startswith((OURS, "bench ")), "at_least": dict(at_least or {})}
    benchmark.extra_info |= {"who": name, "work": work, "unit": unit} | about


def figure(benchmark: Any, what: str, value: float, unit: str, **target: float) -> None:
    """Add a measured value that is no ratio of times: an error, megabytes, an exponent.

    Args:
        benchmark: pytest-benchmark's fixture.
        what: what was measured.
        value: the value.
        unit: as printed: mm, MB.
        **target: `at_most` or `at_least`.
    """
    found = {"what": what, "value": float(value), "unit": unit} | target
    benchmark.extra_info.setdefault("figures", []).append(found)
