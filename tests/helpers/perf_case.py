"""Facts that a benchmark stores with its time: its name, its work and its targets.

A group of benchmarks does the same work: stiffbench and its peers. The page of `make perf` shows
the speed ratio to each peer (`tests/perf/write_page.py`). Targets are ratios within one run,
never times: machines differ, and are shared.
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
    """Store a benchmark's name and work; "stiffbench" or "bench ..." is ours.

    Args:
        benchmark: pytest-benchmark's fixture.
        name: tool, and its variant if a group has several.
        at_least: peer's name -> least ratio of our rate to the peer's.
        work: amount per call, in `unit`: samples, epochs, FLOP. Rates are compared.
        unit: of the work, singular.
    """
    about = {"ours": name.startswith((OURS, "bench ")), "at_least": dict(at_least or {})}
    benchmark.extra_info |= {"who": name, "work": work, "unit": unit} | about


def figure(benchmark: Any, what: str, value: float, unit: str, **target: float) -> None:
    """Add a measured value other than a ratio of times: error, memory, exponent.

    Args:
        benchmark: pytest-benchmark's fixture.
        what: name of the value.
        value: the value.
        unit: as printed: mm, MB.
        **target: `at_most` or `at_least`.
    """
    figure_record = {"what": what, "value": float(value), "unit": unit} | target
    benchmark.extra_info.setdefault("figures", []).append(figure_record)
