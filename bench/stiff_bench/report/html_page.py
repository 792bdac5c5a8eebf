"""Content of the report page, and its HTML file.

Texts may be hostile: all are escaped. Style, scripts and pictures are inside the file.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from stiff_bench.console import printable
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.report.first_screen import FIRST_MODELS, WIDTH, FirstScreen
from stiff_bench.store.names import OPTION_MARK, natural_key
from stiff_bench.tables.table import Column, Entry, Table, quantity
from stiff_bench.tables.writers import html_text


class Picture(NamedTuple):
    """Figure of the page as a file, with the command that draws it.

    `dataset` and `protocol` name its results; "" for several.
    """

    title: str
    caption: str
    media_type: str
    content: bytes
    command: str
    dataset: str = ""
    protocol: str = ""


class Link(NamedTuple):
    """A text that leads to another page or file, by its relative address."""

    text: str
    address: str


@dataclass(frozen=True)
class Block:
    """Content under one heading; `command` prints the same tables, "" for none.

    `folds` are collapsed texts with a summary, such as a log. With `is_detail`, the whole block is
    collapsed and not printed. `links` lead to other pages and files.
    """

    heading: str
    texts: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    folds: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = ()
    command: str = ""
    is_detail: bool = False
    links: Sequence[Link] = ()

    @property
    def choices(self) -> dict[str, list[str]]:
        """Data sets and protocols of the pictures; empty if no picture names any."""
        by_data = [picture for picture in self.pictures if picture.dataset]
        kinds = {
            "data set": dict.fromkeys(picture.dataset for picture in by_data),
            "protocol": dict.fromkeys(picture.protocol for picture in by_data),
        }
        return {kind: [*names] for kind, names in kinds.items() if names}


LARGEST_SVG = 150_000
"""Bytes; a larger picture is embedded as PNG."""


def embedded(figure: Prepared, command: str, dataset: str = "", protocol: str = "") -> Picture:
    """Return a figure for a page: as SVG, or as PNG if the SVG is large."""
    media_type, content = "image/svg+xml", figure.picture(".svg")
    if len(content) > LARGEST_SVG:
        media_type, content = "image/png", figure.picture(".png")
    return Picture(figure.title, figure.caption, media_type, content, command, dataset, protocol)


@dataclass(frozen=True)
class Part:
    """Content of the page for one folder of results.

    Attributes:
        facts: date and numbers, in one line.
        answer: first screen; None: the models cannot be compared.
        headline: heading of the sentences of a page without answer; "" for none.
        sentences: labels and texts below that heading.
        reason: reason for a missing answer or ranking; "" for none.
        notes: notes on the data.
        blocks: details, most important first.
    """

    facts: str
    answer: FirstScreen | None = None
    headline: str = ""
    sentences: Sequence[tuple[str, str]] = ()
    reason: str = ""
    notes: Sequence[str] = ()
    blocks: Sequence[Block] = ()


_HERE = Path(__file__).parent
PACKAGE, VERSION = "datatables.net", "3.1.5"
LICENCE = "MIT"
SCRIPT = _HERE / "npm" / "dataTables.min.js"
"""The widget that sorts and filters tables."""

MOST_ROWS = 2000
"""Largest number of embedded rows of a table; a note states the rest."""
FEW_ROWS = 12
"""Largest number of rows of a table without search, filters and sorting."""
_LONG = 40  # characters of a text that needs room


def page_table(table: Table) -> dict[str, Any]:
    """Return the visible part of a table, cut to `MOST_ROWS`, for the page's template.

    It has headings and CSS class of each column, all notes, and whether the table can be sorted.
    A row has cells (text, sort key, CSS class); an empty sort key is last.
    """
    visible_table = replace(table, brief=False).visible_table()
    rows, notes = visible_table.rows[:MOST_ROWS], [*visible_table.notes]
    if len(rows) < len(visible_table.rows):
        notes.append(
            f"The first {len(rows)} of {len(visible_table.rows)} rows are shown; select fewer with "
            "--model, --dataset and --protocol."
        )
    styles = [
        _style(column, [row[number] for row in rows])
        for number, column in enumerate(visible_table.columns)
    ]
    by_sign = all(column.by_sign for column in visible_table.columns if column.kind == "number")
    return {
        "headings": visible_table.headings(),
        "styles": styles,
        "rows": [[*map(_page_cell, visible_table.columns, row, styles)] for row in rows],
        "notes": notes,
        "can_be_sorted": len(rows) > FEW_ROWS and not by_sign,
        "as_cards": not by_sign,
    }


def _style(column: Column, cells: Sequence[Entry]) -> str:
    if column.kind == "number":
        return "number"
    return "long" if any(len(column.text(cell)) > _LONG for cell in cells) else "text"


_LONGEST_ORDER = 60  # characters of a text's sort key


def _page_cell(column: Column, cell: Entry, style: str) -> tuple[str, str, str]:
    text = column.text(cell)
    if style != "number":  # natural order: "n = 5" comes before "n = 10"
        order = natural_key(text.lower())[:_LONGEST_ORDER]
        return text, order, "" if style == "long" else style
    cell_quantity = quantity(cell)
    if cell_quantity is None or cell_quantity.order is None:
        return text, "", style
    tone = " worse" if cell_quantity.order < 0.0 else " better" if cell_quantity.order > 0.0 else ""
    return text, f"{cell_quantity.order:.12g}", style + tone * (column.by_sign > 0)


def render_page(
    parts: Mapping[str, Part],
    command: str,
    *,
    title: str = "stiffbench report",
    addresses: Mapping[str, str] = MappingProxyType({}),
    back: Link | None = None,
) -> str:
    """Return the page as HTML.

    Args:
        parts: folder of results -> its content.
        command: command that creates the page.
        title: title of the page.
        addresses: name in the first column of a table -> relative address of its own page.
        back: link to the page above this one; None: there is none.

    All texts are escaped. The content security policy names the two scripts and the style of this
    package by their hashes. It blocks all other scripts and styles, and all requests.
    """
    scripts = [file.read_text(encoding="utf-8") for file in (SCRIPT, _HERE / "page.js")]
    style = (_HERE / "page.css").read_text(encoding="utf-8")
    environment = Environment(
        loader=FileSystemLoader(_HERE),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        **{"source": _source, "breakable": _breakable, "laid_out": page_table},
        "html_text": lambda text: Markup(html_text(text)),
    }
    return environment.get_template("page.html.jinja").render(
        parts=parts,
        command_line=command,
        title=title,
        addresses=addresses,
        back=back,
        version=version("stiffbench"),
        few_rows=FEW_ROWS,
        first_models=FIRST_MODELS,
        chart_width=WIDTH,
        policy=_policy(scripts, style),
        scripts=[Markup(script) for script in scripts],
        style=Markup(style),
        widget=f"{PACKAGE} {VERSION} ({LICENCE})",
    )


def _visible(value: Any) -> Any:
    """Escape control characters and characters that reverse text."""
    return printable(value) if type(value) is str else value


def _breakable(name: str) -> Markup:
    """Allow a line break before each option of a name."""
    return Markup(html_text(name).replace(OPTION_MARK, f"<wbr>{OPTION_MARK}"))


def _source(picture: Picture) -> str:
    return f"data:{picture.media_type};base64,{base64.b64encode(picture.content).decode()}"


def _policy(scripts: list[str], style: str) -> str:
    digests = (hashlib.sha256(text.encode()).digest() for text in (*scripts, style))
    *of_scripts, of_style = (f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)
    return (
        f"default-src 'none'; img-src data:; script-src {' '.join(of_scripts)}; "
        f"style-src {of_style}; base-uri 'none'; form-action 'none'"
    )
