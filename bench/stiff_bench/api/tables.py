"""Tables and texts that print themselves in a terminal and in a notebook."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from textwrap import fill
from typing import TYPE_CHECKING, ClassVar

from stiff_bench.console import one_line, printable
from stiff_bench.tables.render import html_text, of_format, render
from stiff_bench.tables.table import SCREEN
from stiff_bench.tables.terminal import screen_console, screen_text
from stiff_protocols.contract.screen import MOST_ROWS, WIDTH, html_block

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.tables.table import Table


_COLUMNS = re.compile(r"\S  +\S")
"""Spaces between the columns of a table."""


class Text(str):
    """A text that a notebook prints line by line."""

    def __repr__(self) -> str:
        """Return the text, with sentences wrapped to the width of a screen."""
        lines = printable(self).splitlines()
        is_table = [_COLUMNS.search(line) for line in lines]
        return "\n".join(
            line if columns else fill(line, WIDTH, break_long_words=False, break_on_hyphens=False)
            for line, columns in zip(lines, is_table, strict=True)
        )

    def _repr_html_(self) -> str:
        """Return the text with its columns, long lines wrapped."""
        return html_block(f'<pre style="white-space: pre-wrap;">{escape(printable(self))}</pre>')


def filled_table(table: Table, without: Collection[str] = ()) -> Table:
    """Return the printed table, without empty columns and columns in `without`."""
    table = table.visible_table()
    texts = [*zip(*table.texts(), strict=True)]
    numbers = [
        number
        for number, column in enumerate(table.columns)
        if column.name not in without and (not table.rows or {*texts[number]} != {"-"})
    ]
    rows = [[row[number] for number in numbers] for row in table.rows]
    return replace(table, columns=[table.columns[number] for number in numbers], rows=rows)


def short_table(table: Table, without: Collection[str] = ()) -> Table:
    """Return the first rows of a `filled_table`, with the number of the others."""
    table = filled_table(table, without)
    n_more = len(table.rows) - MOST_ROWS
    notes = [*[f"... and {n_more} more rows"] * (n_more > 0), *table.notes]
    return replace(table, rows=table.rows[:MOST_ROWS], notes=notes)


@dataclass(frozen=True, eq=False, repr=False)
class Tables:
    """Tables that print themselves, in a terminal and in a notebook.

    Attributes:
        tables: typed values, with titles and notes.
        command: command that made them.
        text: sentence above them; "" for none.
        about: facts about all tables, for json.
    """

    tables: Sequence[Table]
    command: str
    text: str = ""
    about: Mapping[str, object] = field(default_factory=dict)
    _details: ClassVar[Collection[str]] = ()

    def frame(self) -> DataFrame:
        """Return the numbers as tidy data with a row per number."""
        from pandas import DataFrame  # slow import (0.5 s), not needed for a leaderboard

        return DataFrame(
            [line for table in of_format(self.tables, "github") for line in table.lines()]
        )

    def text_as(self, fmt: str) -> str:
        """Return the tables as "github", "latex", "csv", "html" or "json"."""
        return render(self.tables, fmt, self.command, text=self.text, about=self.about)

    def __repr__(self) -> str:
        """Return the tables for a terminal."""
        return screen(of_format(self.tables, "github"), self.text)

    def _repr_html_(self) -> str:
        """Return the text and the tables, with titles no larger than a notebook's text."""
        tables = [filled_table(table, self._details) for table in of_format(self.tables, "html")]
        page = render(tables, "html", "")
        for tag, small in (("<h2>", "<p><strong>"), ("</h2>", "</strong></p>"), ("<ul></ul>", "")):
            page = page.replace(tag, small)
        text = f"<p><strong>{html_text(one_line(self.text))}</strong></p>\n" if self.text else ""
        return html_block(text + page)


class Comparison(Tables):
    """A comparison of two models; a terminal shows only the differences."""

    _details = ("splits", "p", "P(A better)", "P(equivalent)", "P(B better)", "interval over poses")
    """Columns that only files have."""

    def __repr__(self) -> str:
        """Return the verdict and the differences for a terminal."""
        return screen([*map(short_table, of_format(self.tables, SCREEN))], self.text)


def screen(tables: Sequence[Table], text: str = "") -> str:
    """Return tables in the width of a screen, below a `text`."""
    return screen_text(tables, text=text, console=screen_console(WIDTH, colors=False))
