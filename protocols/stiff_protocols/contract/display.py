"""Short texts of objects: one line of fields, or facts and a small table, also as HTML."""

from __future__ import annotations

import reprlib
import textwrap
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from html import escape
from typing import Any

WIDTH = 100
"""Most characters of a line of text."""
CELL_WIDTHS = (40, 30, 20, 12)
"""Characters of a heading or a cell of text; the first value that fits the width is used."""
MOST_ROWS = 8
"""Most rows of a table; the last line counts the others."""
MAX_RUNS_SHOWN = 10
_NO_FORMULAS = "tex2jax_ignore mathjax_ignore"
"""Classes of HTML in which a notebook does not read `$` as a formula."""


def printable(text: str) -> str:
    """Return a text with all but its printable characters, line breaks and tabs escaped.

    Names in third-party files may hold characters that move a terminal's cursor or reverse text.
    """
    if text.isprintable():
        return text
    return "".join(
        sign if sign.isprintable() or sign in "\n\t" else ascii(sign)[1:-1] for sign in text
    )


def one_line(text: str) -> str:
    """Return a `printable` text with spaces instead of line breaks."""
    return printable(" ".join(text.splitlines()))


def row_ranges(rows: Iterable[int], most: int | None = MAX_RUNS_SHOWN) -> str:
    """Return row numbers as text: runs as "2-152", and at most ten runs, or `most`."""
    runs: list[list[int]] = []
    for row in rows:
        if runs and row == runs[-1][-1] + 1:
            runs[-1][1:] = [row]
        else:
            runs.append([row])
    listed = ", ".join("-".join(map(str, run)) for run in runs[:most])
    hidden = sum(run[-1] - run[0] + 1 for run in runs[len(runs) if most is None else most :])
    return listed + (f" and {hidden} more" if hidden else "")


@dataclass(frozen=True)
class Screen:
    """The view of one object; every text is escaped where it is rendered.

    Attributes:
        title: first line.
        facts: names with values and their units.
        columns: headings of the table; none: without a table.
        rows: texts of the table's cells, row by row.
        notes: sentences below.
        in_text: False: the table is shown in a notebook only.
    """

    title: str
    facts: Sequence[tuple[str, str]] = ()
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    notes: Sequence[str] = ()
    in_text: bool = True

    def text(self) -> str:
        """Return lines of at most `WIDTH` characters for a terminal."""
        width = max((len(name) for name, _ in self.facts), default=0) + 2
        lines = [_wrapped(self.title)]
        lines += [_wrapped(value, f"  {name:<{width}}") for name, value in self.facts]
        if self.columns and self.in_text:
            tables = (self._table("plain", most) for most in CELL_WIDTHS)
            narrowest = (line[:WIDTH] for line in self._table("plain", CELL_WIDTHS[-1]))
            lines += ["", *next(filter(_fits, tables), narrowest), *[""] * bool(self.notes)]
        return "\n".join([*lines, *(_wrapped(note, "  ") for note in self.notes)])

    def html(self) -> str:
        """Return a block of HTML for a notebook."""
        parts = [f"<p><strong>{escape(one_line(self.title))}</strong></p>"]
        if self.facts:
            parts += _table("html", (), self.facts, ("left", "left"))
        if self.columns:
            parts += self._table("html", None)
        parts += [f"<p>{escape(one_line(note))}</p>" for note in self.notes]
        return html_block("\n".join(parts))

    def _table(self, fmt: str, most: int | None) -> list[str]:
        """Return the lines of the table with cells of `most` characters; see `MOST_ROWS`."""
        rows, n_more = self.rows[:MOST_ROWS], len(self.rows[MOST_ROWS:])
        columns = zip(*rows, strict=True) if rows else [()] * len(self.columns)
        lines = _table(fmt, self.columns, rows, [*map(_alignment, columns)], most)
        more = f"... and {n_more} more"
        lines += [f"<p>{more}</p>" if fmt == "html" else more] * bool(n_more)
        return lines if fmt == "html" else [f"  {line.rstrip()}" for line in lines]


def _table(
    fmt: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    alignments: Sequence[str],
    most: int | None = None,
) -> list[str]:
    """Return the lines of a table in a format of tabulate's, which escapes HTML."""
    from tabulate import tabulate  # 50 ms, which a command's help does not need

    limits = [most if alignment == "left" else None for alignment in alignments]
    cells = [
        [shorten(one_line(cell), limit) for cell, limit in zip(row, limits, strict=True)]
        for row in rows
    ]
    heads = [shorten(one_line(heading), most) for heading in headings]
    if fmt != "html":  # tabulate pads headings of a text
        cells, heads = [heads, *cells], []
    text = tabulate(
        cells, heads, fmt, disable_numparse=True, colalign=alignments if cells else None
    )
    return text.splitlines()


def shorten(text: str, most: int | None) -> str:
    """Return the first characters of a text; None: all of them."""
    return text if most is None or len(text) <= most else f"{text[: max(most - 3, 1)]}..."


def _fits(lines: Sequence[str]) -> bool:
    return max(map(len, lines), default=0) <= WIDTH


def html_block(content: str) -> str:
    """Return HTML with left-aligned text, in which a notebook does not read `$` as a formula."""
    for tag in ("th", "td"):  # a notebook aligns them right
        content = content.replace(f"<{tag}>", f'<{tag} style="text-align: left;">')
    return f'<div class="{_NO_FORMULAS}">\n{content}\n</div>'


def _wrapped(text: str, start: str = "") -> str:
    """Return a text in lines of at most `WIDTH` characters, below each other after `start`."""
    start = one_line(start)
    below = " " * len(start) or "  "
    lines = textwrap.wrap(
        one_line(text), WIDTH, initial_indent=start, subsequent_indent=below, break_on_hyphens=False
    )
    return "\n".join(lines) or start.rstrip()


def _alignment(cells: Sequence[str]) -> str:
    """Return "right" for a column of numbers, with or without units, else "left"."""
    is_number = all(cell[:1].isdigit() or cell[:1] in "+-." for cell in cells)
    return "right" if is_number else "left"


class ShownObject:
    """Mixin of objects with a `Screen` for terminals and notebooks."""

    @abstractmethod
    def view(self) -> Screen:
        """Return the view of the object."""

    def __repr__(self) -> str:
        return self.view().text()

    def _repr_html_(self) -> str:
        return self.view().html()


class _Brief(reprlib.Repr):
    """Shorten values to a few characters, arrays to their shape."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxother, self.maxstring = 2, 60, 60
        self.maxdict = self.maxtuple = self.maxlist = 3

    def repr_ndarray(self, array: Any, level: int) -> str:
        """Return the shape."""
        return f"<array {'x'.join(map(str, array.shape))}>"

    def repr_instance(self, x: Any, level: int) -> str:
        """Return the first line of the object's own text, shortened."""
        return super().repr_instance(x, level).partition("\n")[0]


class BriefFields:
    """Mixin: print a dataclass (with `repr=False`) in one line, with arrays as shapes."""

    def __repr__(self) -> str:
        brief = _Brief()
        record: Any = self
        parts = [f"{item.name}={brief.repr(getattr(self, item.name))}" for item in fields(record)]
        return f"{type(self).__name__}({', '.join(parts)})"
