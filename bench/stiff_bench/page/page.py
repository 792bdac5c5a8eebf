"""Content of a page: sections of texts, tables and figures.

All texts are plain; `html` escapes them.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.tables.table import Table
from stiff_protocols.contract.errors import StiffBenchError
from stiff_protocols.contract.files import make_folder, written_whole

LARGEST_SVG = 150_000
"""Bytes; a larger picture is embedded as PNG."""


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
        addresses: name in the first column of a table -> address of its own page.
        up: link to the page above this one; None: there is none.
    """

    title: str
    sections: Sequence[Section]
    command: str = ""
    addresses: Mapping[str, str] = field(default_factory=dict)
    up: Link | None = None


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
