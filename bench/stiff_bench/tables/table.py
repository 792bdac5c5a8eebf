"""The table that every command prints and every page shows: typed values until the last step.

A table is a list of columns, each of which says how its cell is made from what a row is of.
`render` prints it as text, the report as part of a page. Neither reads a number back out of a text.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Any, Literal, Self

from stiff_protocols.contract.brief_fields import BriefFields


@dataclass(frozen=True)
class Name:
    """A name with what must stand beside it, such as that its epoch was picked on the test part."""

    text: str
    mark: str = ""

    def __str__(self) -> str:
        """Return the name with its mark, for people."""
        return f"{self.text} [{self.mark}]" if self.mark else self.text


@dataclass(frozen=True)
class Quantity:
    """A number of a table, in its column's unit, or why there is none.

    Attributes:
        value: None: there is an interval, a share or a status alone.
        spread: standard deviation; None: not known.
        low, high: interval or range; None: there is none.
        n: of how many splits or specimens it is the mean; csv and json alone say it.
        share: of how many the number is of, such as 3 of 5 data sets.
        mark: stands behind it, such as "*".
        status: stands in its place or behind it, such as "FAILED".
    """

    value: float | None = None
    spread: float | None = None
    low: float | None = None
    high: float | None = None
    n: int | None = None
    share: tuple[int, int] | None = None
    mark: str = ""
    status: str = ""

    @property
    def order(self) -> float | None:
        """What it is sorted by: value, else low end, else the first number of the share."""
        if self.value is not None or self.low is not None:
            return self.value if self.value is not None else self.low
        return None if self.share is None else float(self.share[0])

    def text(self, spec: str) -> str:
        """Return value, spread, interval and share, each number as `format` writes it by `spec`."""
        parts = []
        if self.value is not None:
            parts.append(f"{self.value:{spec}}")
        if self.spread is not None:
            parts.append(f"± {self.spread:{spec}}")
        if self.low is not None and self.high is not None:
            interval = f"{self.low:{spec}} to {self.high:{spec}}"
            parts.append(f"({interval})" if parts else interval)
        if self.share is not None:
            share = "/".join(map(str, self.share))
            parts.append(f"({share})" if parts else share)
        return " ".join(parts)


Entry = str | int | float | Name | Quantity | None
"""A float is a quantity with a value alone; None prints as a dash."""


def quantity(cell: Entry) -> Quantity | None:
    """Return a cell's number, or why there is none; None where the cell is a text or empty."""
    if isinstance(cell, int | float):
        return Quantity(cell)
    return cell if isinstance(cell, Quantity) else None


@dataclass(frozen=True)
class Column:
    """A column of a table: one entry makes a new one.

    Attributes:
        name: above it.
        kind: "number", or "text" that describes its row.
        unit: of its numbers, as printed; "" for none.
        format: of its numbers, as `format` reads it; or what writes a whole quantity, its unit too.
        group: above the names of several columns.
        about: facts on it for csv and json, such as metric and axis.
        hidden: csv and json alone hold it, because the title says it to people.
        marks_shown: False: csv and json alone have the marks of its cells, as a note says them.
        by_sign: 1: cells above zero are coloured as better, below as worse; -1: the other way.
        value: makes its cell from what a row is of, such as a model; None: the row has it under the
            column's name. See `Table.of`.
    """

    name: str
    kind: Literal["number", "text"] = "number"
    unit: str = ""
    format: str | Callable[[Quantity], str] = ""
    group: str = ""
    about: Mapping[str, object] = field(default_factory=dict)
    hidden: bool = False
    marks_shown: bool = True
    by_sign: int = 0
    value: Callable[[Any], Entry] | None = None

    def text(self, cell: Entry) -> str:
        """Return one of its cells for people, a dash where there is none."""
        found = quantity(cell)
        if found is None:
            return "-" if cell is None else str(cell)
        if callable(self.format):
            return found.status or "-" if found.order is None else self.format(found)
        mark = found.mark if self.marks_shown else ""
        return " ".join(filter(None, (found.text(self.format), found.status, mark))) or "-"


def text_columns(*names: str) -> list[Column]:
    """Return columns of texts."""
    return [Column(name, "text") for name in names]


VALUE_FIELDS = (
    *("column", "value", "spread", "low", "high", "n", "part", "whole"),
    *("unit", "mark", "status"),
)
"""Of each number, in csv and json."""
MOST_NOTES = 4
BEST_MARK = "*"
"""Stands behind the best number of a column."""
SCREEN = "screen"
"""Format of a terminal."""
WRITTEN = ("github", "latex", "html", "json")
"""Formats of long tables: not of a terminal, and not csv."""


@dataclass(frozen=True, repr=False)
class Table(BriefFields):
    """Rows of typed cells.

    Attributes:
        title: above it.
        columns: from left to right; those of text first.
        rows: cells, one a column.
        notes: beneath it.
        unit: that the title names; the names of columns with another one say it.
        about: facts for csv and json, such as data set, protocol and seed.
        details: too long to stand beneath it; json alone has them.
        brief: whether people see `MOST_NOTES` of its notes alone; json has all.
        formats: that hold it, as `render` names them; none: all.
        best_first: whether the first row is the best.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Entry]]
    notes: Sequence[str] = ()
    unit: str = ""
    about: Mapping[str, object] = field(default_factory=dict)
    details: Sequence[str] = ()
    brief: bool = False
    formats: Collection[str] = ()
    best_first: bool = False

    @classmethod
    def of(
        cls,
        title: str,
        columns: Sequence[Column],
        records: Iterable[Any],
        notes: Sequence[str] = (),
        **facts: Any,
    ) -> Self:
        """Return a table with a row a record; each column's `value` makes its cell from it."""
        values = [column.value or itemgetter(column.name) for column in columns]
        rows = [[value(record) for value in values] for record in records]
        return cls(title, columns, rows, notes, **facts)

    def heading(self, column: Column) -> str:
        """Return a column's name, with its unit where neither title nor cells say it."""
        named = column.unit in ("", self.unit) or callable(column.format)
        return column.name if named else f"{column.name} [{column.unit}]"

    def headings(self) -> list[str]:
        """Return the heading of each column, after that of its group, in one line."""
        return [": ".join(filter(None, (one.group, self.heading(one)))) for one in self.columns]

    def shown(self) -> Table:
        """Return what people see: no hidden columns and, where it is brief, few notes."""
        seen = [number for number, one in enumerate(self.columns) if not one.hidden]
        rows = [[row[number] for number in seen] for row in self.rows]
        notes = list(dict.fromkeys(filter(None, self.notes)))
        if self.brief and len(notes) > MOST_NOTES:
            n_more = len(notes) - MOST_NOTES + 1
            notes = [*notes[: MOST_NOTES - 1], f"{n_more} more notes: `--format json`"]
        columns = [self.columns[number] for number in seen]
        return replace(self, columns=columns, rows=rows, notes=notes)

    def texts(self) -> list[list[str]]:
        """Return each row's cells for people."""
        return [
            [column.text(cell) for column, cell in zip(self.columns, row, strict=True)]
            for row in self.rows
        ]

    def records(self) -> Iterator[tuple[dict[str, object], list[dict[str, object]]]]:
        """Yield each row: its texts by name of column, and its numbers (see `VALUE_FIELDS`)."""
        for row in self.rows:
            texts: dict[str, object] = {}
            values = []
            for column, cell in zip(self.columns, row, strict=True):
                if column.kind == "number":
                    values.append({**column.about, **_value(column, cell)})
                elif isinstance(cell, Name):
                    texts |= {column.name: cell.text, f"{column.name} mark": cell.mark}
                else:
                    texts[column.name] = cell
            yield texts, values

    def lines(self) -> Iterator[dict[str, object]]:
        """Yield a line for each number: the table's facts, the row's texts, and the number."""
        for texts, values in self.records():
            for value in values or [{}]:
                yield {**self.about, **texts, **value}


def _value(column: Column, cell: Entry) -> dict[str, object]:
    """Return a number field by field; None where it has none."""
    found = quantity(cell) or Quantity(status=str(cell or ""))
    part, whole = found.share or (None, None)
    numbers = (found.value, found.spread, found.low, found.high, found.n, part, whole)
    texts = (column.unit, found.mark, found.status)
    return dict(zip(VALUE_FIELDS, (column.name, *numbers, *texts), strict=True))
