"""Tables of typed values, printed by commands and pages.

Each column of a table makes its cells from the records of the rows. `writers` writes the table as
text, `page` as part of a page. Neither parses numbers from texts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Any, Literal, Self

from stiff_bench.console import SCREEN as SCREEN
from stiff_protocols.contract.display import BriefFields


@dataclass(frozen=True)
class Name:
    """A name with a mark, for example that its epoch was picked on the test part."""

    text: str
    mark: str = ""

    def __str__(self) -> str:
        """Return the name with its mark as text."""
        return f"{self.text} [{self.mark}]" if self.mark else self.text


@dataclass(frozen=True)
class Quantity:
    """A number in a table in its column's unit, or the reason why it is missing.

    Attributes:
        value: number; None if there is only an interval, a share or a status.
        spread: standard deviation; None: unknown.
        low, high: interval or range; None: no interval.
        n: number of averaged splits or specimens; only in csv and json.
        share: count and total, such as 3 of 5 data sets.
        mark: text after the number, such as "*".
        status: text after the number or instead of it, such as "FAILED".
        ratio: ratio to the VJM's error: on an HTML page the colour of the cell, or the dot of a
            chart; None: no colour.
    """

    value: float | None = None
    spread: float | None = None
    low: float | None = None
    high: float | None = None
    n: int | None = None
    share: tuple[int, int] | None = None
    mark: str = ""
    status: str = ""
    ratio: float | None = None

    @property
    def order(self) -> float | None:
        """Return the sort value: value, else low end, else the share's count."""
        if self.value is not None or self.low is not None:
            return self.value if self.value is not None else self.low
        return None if self.share is None else float(self.share[0])

    def text(self, spec: str) -> str:
        """Return value, spread, interval and share, each formatted with `spec`."""
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
"""Cell of a table. A float is a quantity with only a value; None is printed as a dash."""


def quantity(cell: Entry) -> Quantity | None:
    """Return the quantity of a cell; None for texts and empty cells."""
    if isinstance(cell, int | float):
        return Quantity(cell)
    return cell if isinstance(cell, Quantity) else None


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: heading.
        kind: "number", or "text" that describes its row.
        unit: printed unit of its numbers; "" for none.
        format: format specification of its numbers, or a function that writes a quantity with unit.
        group: heading above the names of several columns.
        about: facts about the column for csv and json, such as metric and axis.
        hidden: True if only csv and json have the column, because the title has its value.
        is_change: True if cells below zero are coloured as better, and above as worse.
        is_chart: True if an HTML page shows ratio and interval of the cells as a chart; other
            formats print them as text.
        value: function that makes the cell from the record of a row, such as a model; None: the
            record has the cell under the column's name. See `Table.of`.
    """

    name: str
    kind: Literal["number", "text"] = "number"
    unit: str = ""
    format: str | Callable[[Quantity], str] = ""
    group: str = ""
    about: Mapping[str, object] = field(default_factory=dict)
    hidden: bool = False
    is_change: bool = False
    is_chart: bool = False
    value: Callable[[Any], Entry] | None = None

    def text(self, cell: Entry) -> str:
        """Return a cell as text; a dash if it is empty."""
        number = quantity(cell)
        if number is None:
            return "-" if cell is None else str(cell)
        if callable(self.format):
            return number.status or "-" if number.order is None else self.format(number)
        parts = (number.text(self.format), number.status, number.mark)
        return " ".join(filter(None, parts)) or "-"


def text_columns(*names: str) -> list[Column]:
    """Return columns of texts."""
    return [Column(name, "text") for name in names]


VALUE_FIELDS = (
    *("column", "value", "spread", "low", "high", "n", "part", "whole"),
    *("unit", "mark", "status"),
)
"""Fields of each number in csv and json."""
MOST_NOTES = 4
BEST_MARK = "*"
"""Mark of the best number of a column."""


@dataclass(frozen=True, repr=False)
class Table(BriefFields):
    """Rows of typed cells.

    Attributes:
        title: text above the table.
        columns: columns from left to right, text columns first.
        rows: cells, one per column.
        notes: texts below the table.
        unit: unit in the title; headings of columns with another unit include it.
        about: facts for csv and json, such as data set, protocol and seed.
        details: long notes, only in json.
        brief: True to print only `MOST_NOTES` of its notes; json has all.
        formats: formats of `render` that include the table; empty: all.
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

    @classmethod
    def of(
        cls,
        title: str,
        columns: Sequence[Column],
        records: Iterable[Any],
        notes: Sequence[str] = (),
        **facts: Any,
    ) -> Self:
        """Return a table with a row per record, made by the columns' `value`.

        The records of a pandas DataFrame are dictionaries of its rows, with None for NaN.
        """
        frame: Any = records
        if hasattr(frame, "to_dict"):
            records = frame.astype(object).where(frame.notna(), None).to_dict("records")
        values = [column.value or itemgetter(column.name) for column in columns]
        rows = [[value(record) for value in values] for record in records]
        return cls(title, columns, rows, notes, **facts)

    def heading(self, column: Column) -> str:
        """Return a column's name, with its unit unless title or cells have it."""
        named = column.unit in ("", self.unit) or callable(column.format)
        return column.name if named else f"{column.name} [{column.unit}]"

    def headings(self) -> list[str]:
        """Return the heading of each column in one line, with its group in front."""
        return [
            ": ".join(filter(None, (column.group, self.heading(column)))) for column in self.columns
        ]

    def visible_table(self) -> Table:
        """Return the printed table: without hidden columns and, if brief, with few notes."""
        seen = [number for number, column in enumerate(self.columns) if not column.hidden]
        notes = list(dict.fromkeys(filter(None, self.notes)))
        if self.brief and len(notes) > MOST_NOTES:
            n_more = len(notes) - MOST_NOTES + 1
            notes = [*notes[: MOST_NOTES - 1], f"{n_more} more notes: `--format json`"]
        return replace(self._of_columns(seen), notes=notes)

    def without_empty_columns(self) -> Table:
        """Return the table without the columns that have no cell in any row."""
        numbers = range(len(self.columns))
        return self._of_columns(
            [k for k in numbers if any(row[k] is not None for row in self.rows)]
        )

    def _of_columns(self, numbers: Sequence[int]) -> Table:
        rows = [[row[number] for number in numbers] for row in self.rows]
        return replace(self, columns=[self.columns[number] for number in numbers], rows=rows)

    def texts(self) -> list[list[str]]:
        """Return the cells of each row as texts."""
        return [
            [column.text(cell) for column, cell in zip(self.columns, row, strict=True)]
            for row in self.rows
        ]

    def records(self) -> Iterator[tuple[dict[str, object], list[dict[str, object]]]]:
        """Yield each row: texts by column name, and numbers (see `VALUE_FIELDS`)."""
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
        """Yield a line per number: the table's facts, the row's texts, the number."""
        for texts, values in self.records():
            for value in values or [{}]:
                yield {**self.about, **texts, **value}


def _value(column: Column, cell: Entry) -> dict[str, object]:
    """Return the fields of a number; None for empty ones."""
    number = quantity(cell) or Quantity(status=str(cell or ""))
    part, total = number.share or (None, None)
    numbers = (number.value, number.spread, number.low, number.high, number.n, part, total)
    texts = (column.unit, number.mark, number.status)
    return dict(zip(VALUE_FIELDS, (column.name, *numbers, *texts), strict=True))
