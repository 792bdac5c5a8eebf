"""A page of sections with texts, tables and figures, and its HTML with style and pictures inside.

Texts may be hostile: all are escaped. Long tables are sorted and searched by ITables, offline.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import distribution, version
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from stiff_bench.console import printable
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.store.names import OPTION_MARK, natural_key
from stiff_bench.tables.table import BEST_MARK, Column, Entry, Table, quantity
from stiff_bench.tables.writers import html_text
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.files import make_folder, written_whole

LARGEST_SVG = 150_000
"""Bytes; a larger picture is embedded as PNG."""
FEW_ROWS = 12
"""Largest number of rows of a table without search and sorting."""
STEPS = 4
"""Number of colours on each side of the VJM; the last is half or double its error."""
WIDTH, MARGIN = 360, 18
"""Width of a chart and its margin on each side, px."""
POWERS = range(-3, 3)
"""Powers of two on the axis of a chart: 1/8 to 4 times the VJM's error."""
_HERE = Path(__file__).parent


class Link(NamedTuple):
    """A text that leads to another page or file, by its relative address."""

    text: str
    address: str


class Figure(NamedTuple):
    """A picture of the page by its address, with the command that draws it."""

    title: str
    caption: str
    address: str
    command: str


@dataclass(frozen=True)
class Section:
    """Content under one heading.

    Attributes:
        heading: heading.
        about: facts in one line above the heading.
        texts: labelled sentences.
        tables: tables below the sentences.
        choices: tables of which the page shows one, chosen by the text in front of it.
        figures: pictures below the tables.
        notes: list of further texts; text between backticks is code.
        links: other pages and files.
        command: command that prints the same tables.
        log: text that keeps its lines, such as the log of a fit.
        sections: sections below this one.
        is_folded: True if the page shows only the heading until it is opened.
    """

    heading: str
    about: str = ""
    texts: Sequence[tuple[str, str]] = ()
    tables: Sequence[Table] = ()
    choices: Sequence[tuple[str, Table]] = ()
    figures: Sequence[Figure] = ()
    notes: Sequence[str] = ()
    links: Sequence[Link] = ()
    command: str = ""
    log: str = ""
    sections: Sequence[Section] = ()
    is_folded: bool = False


@dataclass(frozen=True)
class Page:
    """A page.

    Attributes:
        title: title of the page.
        sections: its content.
        command: command that makes the page.
        addresses: text in a cell -> address of its own page, or of a paper.
        up: link to the page above this one; None: there is none.
        words: text of a heading or cell -> its meaning, shown when a pointer rests on it.
    """

    title: str
    sections: Sequence[Section]
    command: str = ""
    addresses: Mapping[str, str] = field(default_factory=dict)
    up: Link | None = None
    words: Mapping[str, str] = field(default_factory=dict)


def drawn_figures(figures: Iterable[tuple[Callable[[], Prepared], str]]) -> list[Figure]:
    """Draw figures into the page, each with its command; those without enough results are omitted.

    A figure is SVG, or PNG if the SVG is large.
    """
    drawn = []
    for make, command in figures:
        try:
            prepared = make()
            media_type, content = "image/svg+xml", prepared.picture(".svg")
            if len(content) > LARGEST_SVG:
                media_type, content = "image/png", prepared.picture(".png")
        except (StiffBenchError, ArithmeticError, ValueError):  # the page is still written
            continue
        address = f"data:{media_type};base64,{base64.b64encode(content).decode()}"
        drawn.append(Figure(prepared.title, prepared.caption, address, command))
    return drawn


def write_text(path: Path, text: str) -> Path:
    """Write a text completely or not at all, and return its path."""
    make_folder(path.parent)
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return path


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
    environment.filters |= {"rich": rich_text, "name": breakable_name, "cell": html_cell}
    return environment.get_template("page.html.jinja").render(
        page=page,
        version=version("stiffbench"),
        style=Markup((_HERE / "page.css").read_text(encoding="utf-8")),
        script=script,
        embedded_script="" if script else Markup(table_script()),
        few_rows=FEW_ROWS,
        ticks=[(chart_position(2.0**n), f"1/{2**-n}" if n < 0 else f"{2**n}x") for n in POWERS],
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
    order: str
    style: str
    is_best: bool = False
    chart: tuple[float, ...] = ()


def html_cell(cell: Entry, column: Column) -> Cell:
    """Return a cell of a column; missing numbers are sorted last."""
    text, number = column.text(cell), quantity(cell)
    if column.kind == "text":
        return Cell(text, natural_key(text.lower()), "text" if len(text) <= 40 else "")
    if number is None or number.order is None:
        return Cell(text, "1e300", "number")
    if column.is_chart and number.ratio is not None:
        bounds = number.low or number.ratio, number.ratio, number.high or number.ratio
        chart = tuple(map(chart_position, bounds))
        return Cell(text, f"{number.ratio:.12g}", "chart", chart=chart)
    style = ratio_style(number.ratio)
    if column.is_change and number.order:
        style = "less-2" if number.order < 0.0 else "more-2"
    text = text.removesuffix(BEST_MARK).rstrip()
    is_best = BEST_MARK in number.mark
    return Cell(text, f"{number.order:.12g}", f"number {style}".rstrip(), is_best)


def ratio_style(ratio: float | None) -> str:
    """Return the CSS class of a ratio to the VJM's error; "" for none.

    >>> ratio_style(0.4), ratio_style(0.85), ratio_style(1.0), ratio_style(1.5)
    ('less-4', 'less-1', '', 'more-2')
    """
    if ratio is None or ratio <= 0.0:
        return ""
    step = round(min(1.0, max(-1.0, math.log2(ratio))) * STEPS)
    return f"{'less' if step < 0 else 'more'}-{abs(step)}" if step else ""


def chart_position(ratio: float) -> float:
    """Return the position of a ratio on the logarithmic axis, px; others are at an end."""
    power = math.log2(ratio) if ratio > 0.0 else -math.inf
    share = (power - POWERS[0]) / (POWERS[-1] - POWERS[0])
    return round(MARGIN + (WIDTH - 2 * MARGIN) * min(1.0, max(0.0, share)), 1)
