"""What a page holds, before it is HTML: plain texts, which may be hostile and are escaped later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stiff_bench.tables.table import Table


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
        command: that prints the same as the tables; "" for none.
    """

    heading: str
    texts: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    folds: Sequence[Fold] = ()
    notes: Sequence[str] = ()
    command: str = ""


@dataclass(frozen=True)
class Part:
    """All about one folder of results."""

    folder: str
    blocks: Sequence[Block]
