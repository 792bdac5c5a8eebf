"""A figure whose numbers are gathered: a notebook shows it, a file or a page holds it."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

from matplotlib.figure import Figure

from stiff_bench.data_tools.picture_file import drawing, save_figure, write_picture
from stiff_bench.figures.style import DOTS_PER_INCH, STYLE, add_subtitle
from stiff_protocols.contract.errors import StiffBenchError


@dataclass(frozen=True)
class Prepared:
    """A figure that can be drawn: its numbers are gathered.

    Attributes:
        title: what it shows, in a few words.
        caption: plain text: data, protocol, splits, seed, and what bands and marks mean.
        paint: makes the matplotlib figure, inside the journal's style.
        subtitle: data set and protocol, drawn above the panels; "" where these name them.
    """

    title: str
    caption: str
    paint: Callable[[], Figure]
    subtitle: str = ""

    def draw(self) -> Figure:
        """Return the figure."""
        with drawing(STYLE):
            return self._painted()

    def _painted(self) -> Figure:
        figure = self.paint()
        if self.subtitle:
            add_subtitle(figure, self.subtitle)
        return figure

    def save(self, path: Path | str) -> None:
        """Write it in the format that the file's suffix names: .png, .pdf or .svg.

        Raises:
            ConfigError: the suffix names none.
            StoreError: the file cannot be written.
        """
        with drawing(STYLE):
            save_figure(self._painted(), Path(path), DOTS_PER_INCH)

    def _repr_png_(self) -> bytes:
        return self.picture("png")

    def picture(self, kind: Literal["svg", "png", "pdf"]) -> bytes:
        """Return what `save` writes into a file of a kind."""
        held = io.BytesIO()
        with drawing(STYLE):
            write_picture(self._painted(), held, f".{kind}", DOTS_PER_INCH)
        return held.getvalue()


Source = TypeVar("Source")
Figures = Mapping[str, Callable[[Source], Prepared]]
"""Word that asks for a figure -> what gathers its numbers from a source of results.

It raises StoreError or ConfigError where they are not there, and says what makes them.
"""


def can_be_drawn(
    figures: Figures[Source], source: Source
) -> tuple[dict[str, Prepared], dict[str, str]]:
    """Return the figures that a source is enough for, and why it is not for the others."""
    prepared, missing = dict[str, Prepared](), dict[str, str]()
    for name, gather in figures.items():
        try:
            prepared[name] = gather(source)
        except StiffBenchError as error:
            missing[name] = str(error)
    return prepared, missing
