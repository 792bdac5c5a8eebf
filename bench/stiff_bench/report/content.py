"""What a page holds, before it is HTML: plain texts, which may be hostile and are escaped later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Tone = Literal["", "better", "worse"]
Kind = Literal["number", "text", "long"]
"""Of a column: sorted by numbers, or texts; long ones need room."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        text: as shown.
        order: what the column is sorted by: a number's digits, or a text; "" stands last.
        tone: which colour it has; the text says the same without it.
    """

    text: str
    order: str
    tone: Tone = ""


@dataclass(frozen=True)
class PageTable:
    """A table of the page.

    Attributes:
        caption: above it.
        header: of each column.
        kinds: of each column.
        rows: cells, one a column; the first one names the row.
        notes: beneath it.
        command: that prints the same; "" for none.
        widget: it can be sorted and filtered where scripts run.
    """

    caption: str
    header: tuple[str, ...]
    kinds: tuple[Kind, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    command: str = ""
    widget: bool = True


@dataclass(frozen=True)
class Picture:
    """A figure of the page.

    Attributes:
        title, caption: beneath it.
        alt: stands for it where it cannot be seen.
        media_type: e.g. "image/svg+xml".
        content: of the file.
        command: that draws it.
    """

    title: str
    caption: str
    alt: str
    media_type: str
    content: bytes
    command: str


@dataclass(frozen=True)
class Fold:
    """A text that is folded away: a log, or a list of versions."""

    summary: str
    text: str


@dataclass(frozen=True)
class Block:
    """What stands under one heading.

    Attributes:
        heading: in a few words.
        texts: paragraphs.
        tables, pictures, folds: beneath them.
        notes: what must be read with them.
    """

    heading: str
    texts: Sequence[str] = ()
    tables: Sequence[PageTable] = ()
    pictures: Sequence[Picture] = ()
    folds: Sequence[Fold] = ()
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Part:
    """All about one folder of results."""

    folder: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """All that the page holds.

    Attributes:
        command: that makes it.
        version: of stiffbench.
        parts: one a folder.
    """

    command: str
    version: str
    parts: Sequence[Part]
