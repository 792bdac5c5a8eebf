"""Texts of a table -> cells that know what their column is sorted by."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import islice

from stiff_bench.render import TextTable
from stiff_bench.report.content import Cell, Kind, PageTable

MOST_ROWS = 2000
"""So many rows of a table are embedded; the page says where there are more."""
_NUMBER = re.compile(
    r"[<>]?\s*([+-]?\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?)(?:\s(us|ms|s)\b)?"
    r"(?=$|/\d|\s(?:±|\*|≈|to\b|of\b|MiB\b|\(|:))"
)
"""How a cell begins that is sorted by a number; a date, a commit and a version are none."""
_MISSING = re.compile(r"-?|FAILED.*|SKIPPED.*", re.DOTALL)
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, None: 1.0}
_DIGITS = re.compile(r"\d+")
_LONGEST_ORDER = 60  # characters of a text that it is sorted by
_LONG = 40  # characters of a text that needs room


def page_table(table: TextTable, *, command: str = "", widget: bool = True) -> PageTable:
    """Return a table of texts as one of the page, cut to `MOST_ROWS`."""
    rows = [*islice(table.rows, MOST_ROWS)]
    columns = [[row[column] for row in rows] for column in range(len(table.header))]
    kinds = tuple(_kind(column) if number else "text" for number, column in enumerate(columns))
    notes = [*table.notes]
    if len(rows) < len(table.rows):
        notes.append(
            f"The first {len(rows)} of {len(table.rows)} rows are shown; name fewer models, data "
            "sets or protocols for the others."
        )
    return PageTable(
        caption=table.title,
        header=tuple(table.header),
        kinds=kinds,
        rows=tuple(
            tuple(_cell(text, kind) for text, kind in zip(row, kinds, strict=True)) for row in rows
        ),
        notes=tuple(notes),
        command=command,
        widget=widget,
    )


def number_in(text: str) -> float | None:
    """Return the number that a text begins with, times in s; None where it begins with none.

    >>> number_in("1.5 ms (1.2 to 2)"), number_in("12,300"), number_in("< 0.001"), number_in("-")
    (0.0015, 12300.0, 0.001, None)
    """
    found = _NUMBER.match(text)
    if found is None:
        return None
    return float(found[1].replace(",", "")) * _SECONDS[found[2]]


def natural_order(text: str) -> str:
    """Return a text that sorts as people count: "n = 5" stands before "n = 10".

    >>> sorted(["n = 10", "n = 5"], key=natural_order)
    ['n = 5', 'n = 10']
    """
    return _DIGITS.sub(lambda found: found[0].zfill(6), text.lower())[:_LONGEST_ORDER]


def _kind(texts: Sequence[str]) -> Kind:
    present = [text for text in texts if not _MISSING.fullmatch(text)]
    if present and all(number_in(text) is not None for text in present):
        return "number"
    return "long" if any(len(text) > _LONG for text in present) else "text"


def _cell(text: str, kind: Kind) -> Cell:
    if kind != "number":
        return Cell(text, natural_order(text))
    number = number_in(text)
    return Cell(text, "" if number is None else f"{number:.12g}")
