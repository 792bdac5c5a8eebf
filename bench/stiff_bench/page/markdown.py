"""Write a page as Markdown."""

from __future__ import annotations

from collections.abc import Iterator

from stiff_bench.page.page import Figure, Page, Section
from stiff_bench.tables.writers import markdown_text, render


def markdown_page(page: Page) -> str:
    """Return a page as Markdown."""
    parts = [f"# {markdown_text(page.title)}"]
    parts += [part for section in page.sections for part in _parts(section, 2)]
    return "\n\n".join(parts)


def _parts(section: Section, level: int) -> Iterator[str]:
    """Yield the paragraphs of a section with a heading of this level."""
    if section.heading:
        yield f"{'#' * level} {markdown_text(section.heading)}"
    if lines := [*(f"{label}: {text}" for label, text in section.texts), *section.notes]:
        yield "\n".join(f"- {markdown_text(line)}" for line in lines)
    if section.tables:
        yield render(section.tables, "github", section.command)
    for figure in section.figures:
        yield from _figure(figure)
    for part in section.sections:
        yield from _parts(part, level + 1)


def _figure(figure: Figure) -> Iterator[str]:
    """Yield a picture and its caption, with a link to the same picture as PDF."""
    yield f"![{markdown_text(figure.title)}]({figure.address})"
    pdf = figure.address.removesuffix(".png") + ".pdf"
    yield f"{markdown_text(figure.caption)} ([PDF]({pdf}))"
