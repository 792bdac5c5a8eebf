"""What the pages of studies are made of: files written whole, lists, figures with captions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from stiff_bench.figures.figure_line import Prepared
from stiff_bench.render import markdown_text
from stiff_protocols.files import make_folder, written_whole

PICTURE_FILES = ("png", "pdf")


def written(path: Path, text: str) -> Path:
    """Write a text file, whole or not at all, and return its path.

    Raises:
        StoreError: it cannot be written.
    """
    make_folder(path.parent)
    with written_whole(path) as temporary:
        temporary.write_text(f"{text}\n", encoding="utf-8")
    return path


def pictures(figures: Iterable[Prepared], folder: Path) -> Iterator[Path]:
    """Write figures as PNG and PDF, and yield each file.

    Raises:
        StoreError: a file cannot be written.
    """
    make_folder(folder)
    for figure in figures:
        for suffix in PICTURE_FILES:
            path = folder / f"{_file_name(figure)}.{suffix}"
            figure.save(path)
            yield path


def listed(lines: Iterable[str]) -> str:
    """Return a list in markdown."""
    return "\n".join(f"- {line}" for line in lines)


def not_made(reasons: Mapping[str, str]) -> Iterator[str]:
    """Yield a line for each table or figure that could not be made, with the reason."""
    for what, reason in reasons.items():
        yield f"{what}: {markdown_text(reason)}"


def figure_text(figure: Prepared, folder: str) -> str:
    """Return a figure with its heading and caption, in markdown; `folder` is seen from the page."""
    picture = f"{folder}/{_file_name(figure)}"
    number = f"Figure {figure.name}: " if figure.name[0].isdigit() else ""
    alt = re.sub(r"[\[\]\\]", " ", figure.title)
    return "\n\n".join(
        [
            f"### {markdown_text(f'{number}{figure.title}')}",
            f"![{alt}]({picture}.png)",
            f"{markdown_text(figure.caption)} ([PDF]({picture}.pdf))",
        ]
    )


def _file_name(figure: Prepared) -> str:
    return f"figure_{figure.name.replace('-', '_')}"
