"""Make results/performance.md from pytest-benchmark's JSON, for `make perf`.

Usage: python tests/perf/write_page.py JSON PAGE

`extra_info` has each benchmark's name and targets: see `helpers/perf_case.py`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pytest_benchmark.utils import time_unit
from tabulate import tabulate

HEAD = """\
# Performance

Measured {date} by `make perf`: {cpu}, {cores} cores, one thread a process; commit {commit};
{versions}.

Times are medians over rounds, ± half the interquartile range where there are several rounds. Ratios
compare medians: above 1, ours is faster. More in [docs/performance.md](../docs/performance.md).
"""
PACKAGES = ("torch", "numpy", "scipy", "scikit-learn", "pin")

Entry = dict[str, Any]
"""One benchmark in the JSON."""


def page(report: dict[str, Any]) -> str:
    machine, commit = report["machine_info"], report["commit_info"]
    head = HEAD.format(
        date=report["datetime"][:10],
        cpu=machine["cpu"].get("brand_raw", "unknown processor"),
        cores=machine["cpu"].get("count", "?"),
        commit=commit.get("id", "unknown") + (" with changes" if commit.get("dirty") else ""),
        versions=f"Python {machine['python_version']}, "
        + ", ".join(f"{name} {version(name)}" for name in PACKAGES),
    )
    groups: dict[str, list[Entry]] = {}
    for entry in report["benchmarks"]:
        groups.setdefault(entry["group"], []).append(entry)
    return "\n".join([head, *(section(name, entries) for name, entries in groups.items())])


def section(name: str, entries: list[Entry]) -> str:
    """Return one group: a table of comparisons, and a table of other figures."""
    ours = [entry for entry in entries if entry["extra_info"]["ours"]]
    peers = [entry for entry in entries if not entry["extra_info"]["ours"]]
    if ours and peers:
        header = ("ours", "median", "peer", "median", "ratio", "target")
        rows = [comparison_row(mine, peer) for mine in ours for peer in peers]
    else:
        header = ("", "median")
        rows = [(who(entry), time_text(entry)) for entry in entries]
    parts = [f"## {name}", table(header, rows)]
    if figures := [row for entry in entries for row in other_figures(entry)]:
        parts.append(table(("figure", "value", "target"), figures))
    return "\n\n".join(parts) + "\n"


def comparison_row(mine: Entry, peer: Entry) -> tuple[str, ...]:
    """Return one row: ours, its peer, the ratio of their times, and the target."""
    ratio = seconds(peer) / seconds(mine)
    target = target_text(ratio, at_least=mine["extra_info"]["at_least"].get(who(peer)))
    return who(mine), time_text(mine), who(peer), time_text(peer), f"{ratio:.3g}", target


def other_figures(entry: Entry) -> list[tuple[str, ...]]:
    """Return a row per figure that is not a ratio of times, such as an error."""
    rows = []
    for figure in entry["extra_info"].get("figures", []):
        name = figure["what"]
        name = name if who(entry) in name else f"{who(entry)}: {name}"
        target = target_text(figure["value"], figure.get("at_least"), figure.get("at_most"))
        rows.append((name, f"{figure['value']:.3g} {figure['unit']}".strip(), target))
    return rows


def target_text(value: float, at_least: float | None = None, at_most: float | None = None) -> str:
    """Return the bound and whether the value meets it; "" without a bound."""
    if at_least is not None:
        return f"≥ {at_least:g}: {'met' if value >= at_least else 'missed'}"
    if at_most is not None:
        return f"≤ {at_most:g}: {'met' if value <= at_most else 'missed'}"
    return ""


def who(entry: Entry) -> str:
    return str(entry["extra_info"]["who"])


def seconds(entry: Entry) -> float:
    """Return the median time of one unit of work, s."""
    return float(entry["stats"]["median"] / entry["extra_info"]["work"])


def time_text(entry: Entry) -> str:
    """Return the median time of one unit of work and its spread."""
    value, stats = seconds(entry), entry["stats"]
    prefix, factor = time_unit(value)
    spread = f" ± {stats['iqr'] / stats['median'] / 2:.0%}" if stats["rounds"] > 1 else ""
    return f"{value * factor:.3g} {prefix}s a {entry['extra_info']['unit']}{spread}"


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return tabulate(rows, header, tablefmt="github", disable_numparse=True)


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    target.write_text(page(json.loads(source.read_text("utf-8"))), encoding="utf-8")
