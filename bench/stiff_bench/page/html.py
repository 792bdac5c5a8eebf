"""Write a page as HTML, with style and pictures inside.

Texts may be hostile: all are escaped. Long tables are sorted and searched by ITables, offline.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import distribution, version
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from stiff_bench.console import printable
from stiff_bench.page.page import Page
from stiff_bench.store.names import OPTION_MARK, natural_key
from stiff_bench.tables.table import BEST_MARK, Column, Entry, Quantity, Table, quantity
from stiff_bench.tables.writers import html_text

FEW_ROWS = 12
"""Largest number of rows of a table without search and sorting."""
STEPS = 4
"""Number of colours on each side of the VJM; the last is half or double its error."""
WIDTH, MARGIN = 360, 18
"""Width of a chart and its margin on each side, px."""
MOST_DOUBLINGS = 4
"""Largest power of two on the axis of a chart."""
_HERE = Path(__file__).parent


def html_page(page: Page, script: str = "") -> str:
    """Return a page as HTML.

    Args:
        page: content of the page.
        script: address of a file with `table_script`; "" puts the script into the page.
    """
    environment = Environment(
        loader=FileSystemLoader(_HERE),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: printable(value) if type(value) is str else value,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"rich": rich_text, "name": breakable_name, "view": table_view}
    return environment.get_template("page.html.jinja").render(
        page=page,
        version=version("stiffbench"),
        style=Markup((_HERE / "page.css").read_text(encoding="utf-8")),
        script=script,
        embedded_script="" if script else Markup(table_script()),
        few_rows=FEW_ROWS,
    )


def rich_text(text: str) -> Markup:
    """Return a text as HTML; text between backticks becomes code."""
    return Markup(html_text(text))


def breakable_name(name: str) -> Markup:
    """Return a name as HTML, with a line break allowed before each option."""
    return Markup(html_text(name).replace(OPTION_MARK, f"<wbr>{OPTION_MARK}"))


def table_script() -> str:
    """Return a script that loads the ITables bundle, which it contains."""
    file = distribution("itables").locate_file("itables/html/dt_bundle.js")  # no import: 0.6 s
    bundle = base64.b64encode(Path(str(file)).read_bytes()).decode()
    address = f"data:text/javascript;base64,{bundle}"
    return f'window.itables = import("{address}");'


class Cell(NamedTuple):
    """A cell of a table on the page.

    Attributes:
        text: text as in other formats.
        order: sort key.
        style: CSS classes.
        is_best: True if the number is the best of its column.
        chart: positions of low end, dot and high end, px; empty: no chart.
    """

    text: str
    order: str = ""
    style: str = ""
    is_best: bool = False
    chart: Sequence[float] = ()


class Head(NamedTuple):
    """A heading above one or more columns."""

    text: str
    style: str
    n_columns: int = 1
    n_rows: int = 1


@dataclass(frozen=True)
class TableView:
    """Printed part of a table for the page's template."""

    heads: Sequence[Sequence[Head]]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str]
    axis: Axis
    can_be_sorted: bool


def table_view(table: Table) -> TableView:
    """Return headings, cells and all notes of a table."""
    table = replace(table, brief=False).visible_table()
    charts = [n for n, column in enumerate(table.columns) if column.is_chart]
    axis = Axis.over(
        bound for row in table.rows for n in charts for bound in _bounds(quantity(row[n]))
    )
    rows = [
        [_cell(column, cell, axis) for column, cell in zip(table.columns, row, strict=True)]
        for row in table.rows
    ]
    is_matrix = all(column.by_sign for column in table.columns if column.kind == "number")
    heads = [*filter(None, _heads(table))]
    return TableView(heads, rows, table.notes, axis, len(rows) > FEW_ROWS and not is_matrix)


def _heads(table: Table) -> Iterator[list[Head]]:
    """Yield the headings of groups of columns, then the headings of columns."""
    has_groups = any(column.group for column in table.columns)
    first, second = list[Head](), list[Head]()
    for group, members in groupby(table.columns, lambda column: column.group):
        columns = [*members]
        first += [Head(group, "group", len(columns))] * bool(group)
        heads = second if group else first
        n_rows = 2 if has_groups and not group else 1
        for column in columns:
            style = "chart" if column.is_chart else column.kind
            heads.append(Head(table.heading(column), style, n_rows=n_rows))
    yield first
    yield second


def _cell(column: Column, cell: Entry, axis: Axis) -> Cell:
    text, number = column.text(cell), quantity(cell)
    if column.kind == "text":
        return Cell(text, natural_key(text.lower()), "text" if len(text) <= 40 else "")
    if number is None or number.order is None:
        return Cell(text, "1e300", "number")  # missing numbers are last
    order = f"{number.order:.12g}"
    if column.is_chart and number.ratio is not None:
        return Cell(text, f"{number.ratio:.12g}", "chart", chart=[*map(axis.at, _bounds(number))])
    style = ratio_style(number.ratio)
    if column.by_sign and number.order:
        style = "less-2" if number.order * column.by_sign > 0.0 else "more-2"
    text = text.removesuffix(BEST_MARK).rstrip()
    return Cell(text, order, f"number {style}".rstrip(), BEST_MARK in number.mark)


def _bounds(number: Quantity | None) -> list[float]:
    """Return low end, ratio and high end of a chart; [] without a ratio."""
    if number is None or number.ratio is None:
        return []
    low, high = (number.ratio if end is None else end for end in (number.low, number.high))
    return [low, number.ratio, high]


def ratio_style(ratio: float | None) -> str:
    """Return the CSS class of a ratio to the VJM's error; "" for none.

    >>> ratio_style(0.4), ratio_style(0.85), ratio_style(1.0), ratio_style(1.5)
    ('less-4', 'less-1', '', 'more-2')
    """
    if ratio is None or ratio <= 0.0:
        return ""
    step = round(min(1.0, max(-1.0, math.log2(ratio))) * STEPS)
    return f"{'less' if step < 0 else 'more'}-{abs(step)}" if step else ""


@dataclass(frozen=True)
class Axis:
    """Logarithmic axis of the charts of a table, from 2^first to 2^last times the VJM's error."""

    first: int
    last: int

    @classmethod
    def over(cls, ratios: Iterable[float]) -> Axis:
        """Return the axis from 0.5 to 4, longer if ratios are outside."""
        powers = [math.log2(ratio) for ratio in ratios if ratio > 0.0] or [0.0]
        first = max(-MOST_DOUBLINGS, min(-1, math.floor(min(powers))))
        return cls(first, min(MOST_DOUBLINGS, max(2, math.ceil(max(powers)))))

    def at(self, ratio: float) -> float:
        """Return the position of a ratio, px; ratios outside are at the end."""
        power = math.log2(ratio) if ratio > 0.0 else -math.inf
        share = (power - self.first) / (self.last - self.first)
        return round(MARGIN + (WIDTH - 2 * MARGIN) * min(1.0, max(0.0, share)), 1)

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Return position and label of each power of two."""
        return [
            (self.at(2.0**power), f"1/{2**-power}" if power < 0 else f"{2**power}x")
            for power in range(self.first, self.last + 1)
        ]
