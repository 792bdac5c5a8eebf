"""The source paper's tables, as shipped in `results/published`."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files

MARK = "published"
NOTE = (
    "published, KR10 measured, not comparable in absolute terms; FT-MLP's epoch was picked on its "
    "test part"
)


@dataclass(frozen=True)
class PublishedRow:
    """A method of a published table.

    Attributes:
        method: its name in the paper.
        values_mm: (metric key, axis) -> value, mm.
    """

    method: str
    values_mm: Mapping[tuple[str, str], float]


def published_lines(table: str) -> list[dict[str, str]]:
    """Return the lines of a published table, column -> text as printed in the paper."""
    text = (files("stiff_published") / f"{table}.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


def published_rows(table: str) -> list[PublishedRow]:
    """Return the rows of a published error table, one a method."""
    lines = published_lines(table)
    methods = [name for name in lines[0] if name not in ("axis", "error")]
    return [
        PublishedRow(method, {(line["error"], line["axis"]): float(line[method]) for line in lines})
        for method in methods
    ]


def published_stiffness() -> dict[str, float]:
    """Return the paper's identified joint stiffnesses (its Table 3), joint -> N m/rad."""
    return {
        line["joint"]: float(line["stiffness_Nm_per_rad"]) for line in published_lines("table_3")
    }


def claimed_reductions() -> dict[tuple[str, str], float]:
    """Return how far below the VJM's FT-MLP's errors are said to be, (metric key, axis) -> %."""
    return {
        (line["error"], line["axis"]): float(line["reduction_percent"])
        for line in published_lines("claimed_reductions")
    }
