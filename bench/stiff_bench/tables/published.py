"""Read the source paper's tables from `results/published`."""

from __future__ import annotations

import csv
import tomllib
from importlib.resources import files
from typing import Any

MARK = "published"
NOTE = (
    "source paper, measured KR10, not comparable in absolute terms; most likely computed on all "
    "samples, including training samples"
)


def published_lines(table: str) -> list[dict[str, str]]:
    """Return the lines of a published table, with the texts of the paper by column."""
    text = (files("stiff_published") / f"{table}.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


def about_table(table: str) -> dict[str, Any]:
    """Return the entry of a table in `results/published/tables.toml`: caption, notes and so on."""
    text = (files("stiff_published") / "tables.toml").read_text(encoding="utf-8")
    return dict(tomllib.loads(text)[table])


def published_errors(table: str) -> dict[str, dict[tuple[str, str], float]]:
    """Return the numbers of a published table by column and (metric key, axis); errors in mm."""
    lines = published_lines(table)
    return {
        method: {(line["error"], line["axis"]): float(line[method]) for line in lines}
        for method in lines[0]
        if method not in ("axis", "error")
    }
