"""Lay out help pages as plain text in two columns; no line break divides a name or a command."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stiff_bench.console import text_width

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel

NAME_COLUMN = 28
"""Width of the column of options' names; longer names have a line of their own."""
KEPT_TOGETHER = re.compile(r"`[^`]*`|default: |-")
"""Parts of a text that no line break divides."""
UNBREAKABLE = str.maketrans({"-": "\u2011", " ": "\u00a0"})
BREAKABLE = str.maketrans({"\u2011": "-", "\u00a0": " "})


def fill(text: str, indent: str = "", first_indent: str | None = None) -> str:
    """Break a text into lines of the terminal's width."""
    unbroken_text = KEPT_TOGETHER.sub(lambda part: part[0].translate(UNBREAKABLE), text)
    first = indent if first_indent is None else first_indent
    filled = textwrap.fill(
        unbroken_text,
        text_width(),
        initial_indent=first,
        subsequent_indent=indent,
        break_long_words=False,
    )
    return filled.translate(BREAKABLE)


def print_rows(heading: str, rows: Sequence[tuple[str, str]]) -> None:
    """Print names and their descriptions as two columns below a heading."""
    width = max((len(name) for name, _ in rows if len(name) <= NAME_COLUMN), default=0)
    print(f"\n{heading}:")
    for name, text in rows:
        if len(name) > width:
            print(f"  {name}")
            name = ""
        print(fill(text, " " * (width + 4), f"  {name:<{width}}  ") if text else f"  {name}")


def page_end(example: str) -> str:
    """Return the end of a page: the option for it, and an example as it is."""
    lines = "\n".join(f"  {line}" for line in example.splitlines())
    return f"-h, --help  Show this page.\n\nExample:\n{lines}"


class HelpPage:
    """The formatter of cyclopts' help pages."""

    def __call__(self, console: Any, options: Any, panel: HelpPanel) -> None:
        """Print a group of options with its heading."""
        rows = [
            (", ".join(entry.display_labels_with_metavar), _plain(entry.description))
            for entry in panel.entries
        ]
        if rows:
            print_rows(str(panel.title), rows)

    def render_usage(self, console: Any, options: Any, usage: Any) -> None:
        """Print the usage."""
        print(f"Usage: {str(usage).strip()}")

    def render_description(self, console: Any, options: Any, description: Any) -> None:
        """Print the text of a command; lines of a list stay as they are."""
        for paragraph in _plain(description).split("\n\n"):
            is_list = paragraph.startswith(" ")
            print("\n" + (paragraph if is_list else fill(" ".join(paragraph.split()))))


def _plain(text: Any) -> str:
    text = getattr(text, "primary_renderable", text)
    return str(getattr(text, "plain", text) or "")
