"""What a benchmark tells `bench perf` besides its time: who it is, and what it must reach.

A group of benchmarks does one piece of work; one of them is ours, the others are peers. `bench
perf` prints how many times faster than each peer ours is. Targets are ratios of one run, never
times: machines differ, and are shared.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
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


def curve(
    benchmark: Any,
    picture: str,
    x: Sequence[float],
    y: Sequence[float],
    *,
    x_label: str,
    y_label: str,
    note: str = "",
) -> None:
    """Add a curve to a picture that `bench perf` draws with logarithmic axes.

    Args:
        benchmark: pytest-benchmark's fixture.
        picture: name of the picture's file; all curves of that name share it. The curve's own
            name is the benchmark's (`ours` or `peer`).
        x, y: of the points, positive.
        x_label, y_label: with units.
        note: stands beside the curve's name.
    """
    benchmark.extra_info["curve"] = {
        "picture": picture,
        "x": [float(one) for one in x],
        "y": [float(one) for one in y],
        "x_label": x_label,
        "y_label": y_label,
        "note": note,
    }
