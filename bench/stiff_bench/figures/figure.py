"""A line of a catalogue of figures: what drives command, page and report alike."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, Literal, TypeVar

from stiff_bench.figures.style import DOTS_PER_INCH, STYLE
from stiff_bench.tables.picture_file import drawing, save_figure, write_picture
from stiff_protocols.contract.errors import StiffBenchError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Source = TypeVar("Source")


@dataclass(frozen=True)
class Content:
    """What a figure is made of, before it has a name."""

    caption: str
    paint: Callable[[], Figure]


@dataclass(frozen=True)
class Prepared:
    """A figure that can be drawn: its numbers are gathered.

    Attributes:
        name: word that asks for it.
        title: what it shows, in a few words.
        caption: plain text: data, protocol, splits, seed, and what bands and marks mean.
        paint: makes the matplotlib figure, inside the journal's style.
    """

    name: str
    title: str
    caption: str
    paint: Callable[[], Figure]

    @property
    def alt(self) -> str:
        """What stands for it where no picture can be seen."""
        return f"{self.title}; described below"

    def draw(self) -> Figure:
        """Return the figure."""
        with drawing(STYLE):
            return self.paint()

    def save(self, path: Path) -> None:
        """Write it in the format that the file's suffix names.

        Raises:
            ConfigError: the suffix names none.
            StoreError: the file cannot be written.
        """
        with drawing(STYLE):
            save_figure(self.paint(), path, DOTS_PER_INCH)

    def _repr_png_(self) -> bytes:
        return self.picture("png")

    def picture(self, kind: Literal["svg", "png", "pdf"]) -> bytes:
        """Return what `save` writes into a file of a kind."""
        held = io.BytesIO()
        with drawing(STYLE):
            write_picture(self.paint(), held, f".{kind}", DOTS_PER_INCH)
        return held.getvalue()


@dataclass(frozen=True)
class FigureLine(Generic[Source]):
    """One figure that can be asked for.

    Attributes:
        name: word that asks for it.
        title: what it shows, in a few words.
        gather: reads its numbers from a source; raises StoreError or ConfigError where they are
            not there.
    """

    name: str
    title: str
    gather: Callable[[Source], Content]

    def prepare(self, source: Source) -> Prepared:
        """Gather the numbers.

        Raises:
            StoreError, ConfigError: results are missing; it says which, and what makes them.
        """
        content = self.gather(source)
        return Prepared(self.name, self.title, content.caption, content.paint)


def can_be_drawn(
    figures: Mapping[str, FigureLine[Source]], source: Source
) -> tuple[list[Prepared], dict[str, str]]:
    """Return the figures that a source is enough for, and why it is not for the others."""
    prepared, missing = [], {}
    for name, line in figures.items():
        try:
            prepared.append(line.prepare(source))
        except StiffBenchError as error:
            missing[name] = str(error)
    return prepared, missing
