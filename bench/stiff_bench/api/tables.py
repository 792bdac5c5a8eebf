"""What shows itself in a terminal and in a notebook: tables, and texts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.tables.table import Table


class Text(str):
    """A text that a notebook shows as it is printed, line by line."""

    def __repr__(self) -> str:
        """Return the text itself."""
        return str(self)


@dataclass(frozen=True, eq=False)
class Tables:
    """Tables that print themselves, in a terminal and in a notebook.

    Attributes:
        text: a sentence above them; "" for none.
    """

    _make: Callable[[], Iterable[Table]]
    _text_as: Callable[[str], str]
    text: str = ""

    @cached_property
    def tables(self) -> tuple[Table, ...]:
        """Typed values, with titles and notes; made when asked for, as `text_as` makes its own."""
        return tuple(self._make())

    def frame(self) -> DataFrame:
        """Return the numbers as tidy data: a row a number."""
        from pandas import DataFrame  # half a second, which a leaderboard does without

        return DataFrame([line for table in self.tables for line in table.lines()])

    def text_as(self, fmt: str) -> str:
        """Return the tables as "github", "latex", "csv", "html" or "json"."""
        return self._text_as(fmt)

    def __repr__(self) -> str:
        """Return the tables for a terminal."""
        return self.text_as("github")

    def _repr_html_(self) -> str:
        return self.text_as("html")
