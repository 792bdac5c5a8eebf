"""Print help pages as plain text: names and their descriptions in two columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stiff_bench.console import print_text, wrapped

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel

NAME_COLUMN = 28
"""Width of the column of options' names; longer names have a line of their own."""


def print_rows(heading: str, rows: Sequence[tuple[str, str]]) -> None:
    """Print names and their descriptions as two columns below a heading."""
    width = max((len(name) for name, _ in rows if len(name) <= NAME_COLUMN), default=0)
    print_text(f"\n{heading}:")
    for name, text in rows:
        if len(name) > width:
            print_text(f"  {name}")
            name = ""
        print_text(wrapped(text, f"  {name:<{width}}  ", " " * (width + 4)))


def page_end(example: str) -> str:
    """Return the end of a page: the option for it, and an example as it is."""
    lines = "\n".join(f"  {line}" for line in example.splitlines())
    return f"-h, --help  Show this page.\n\nExample:\n{lines}"


class HelpPage:
    """The formatter of cyclopts' help pages."""

    def __call__(self, console: Any, options: Any, panel: HelpPanel) -> None:
        """Print a group of options with its heading."""
        rows = []
        for entry in panel.entries:
            is_option = entry.positional_label is None
            end = " [required]" if entry.required and is_option else ""
            end = f" [default: {entry.default}]" if entry.default else end
            text = _plain(entry.description) + end
            rows.append((", ".join(entry.display_labels_with_metavar), text))
        if rows:
            print_rows(str(panel.title), rows)

    def render_usage(self, console: Any, options: Any, usage: Any) -> None:
        """Print the usage."""
        print_text(f"Usage: {str(usage).strip()}")

    def render_description(self, console: Any, options: Any, description: Any) -> None:
        """Print the text of a command; lines of a list stay as they are."""
        for paragraph in _plain(description).split("\n\n"):
            is_list = paragraph.startswith(" ")
            print_text("\n" + (paragraph if is_list else wrapped(" ".join(paragraph.split()))))


def _plain(text: Any) -> str:
    text = getattr(text, "primary_renderable", text)
    return str(getattr(text, "plain", text) or "")
