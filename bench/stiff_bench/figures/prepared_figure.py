"""Figure with all its numbers, ready for a notebook, a file or a page."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import matplotlib
from matplotlib.figure import Figure

from stiff_bench.console import one_line
from stiff_bench.figures.style import STYLE, add_subtitle
from stiff_bench.tables.picture_file import METADATA, check_suffix
from stiff_protocols.contract.files import written_whole

NOTEBOOK_DPI, MOST_PIXELS = 130, 900
"""Pixels per inch of a figure in a notebook, and its largest width; the picture has more."""


@dataclass(frozen=True, repr=False)
class Prepared:
    """A figure that can be drawn: its numbers are gathered.

    Attributes:
        title: content in a few words.
        caption: plain text: data, protocol, splits, seed, and what bands and marks mean.
        paint: function that returns the matplotlib figure; called inside the style.
        subtitle: data set and protocol, drawn above the panels; "" if the panels name them.
        style: settings of matplotlib; by default for a journal.
    """

    title: str
    caption: str
    paint: Callable[[], Figure]
    subtitle: str = ""
    style: Mapping[str, Any] = field(default_factory=lambda: STYLE)

    def draw(self) -> Figure:
        """Return the figure."""
        with _only_settings(self.style):
            figure = self.paint()
            if self.subtitle:
                add_subtitle(figure, self.subtitle)
            return figure

    def save(self, path: Path | str) -> None:
        """Write the figure as .png, .pdf or .svg, by the file's extension.

        Raises:
            ConfigError: the extension is not supported.
            StoreError: the file cannot be written.
        """
        file = Path(path)
        check_suffix(file)
        with written_whole(file) as temporary:
            self._write(temporary, file.suffix.lower())

    def picture(self, suffix: str) -> bytes:
        """Return the bytes of the picture in the format of an extension."""
        buffer = io.BytesIO()
        self._write(buffer, suffix)
        return buffer.getvalue()

    def __repr__(self) -> str:
        return one_line(f"Figure: {self.title}" + f" ({self.subtitle})" * bool(self.subtitle))

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """Return the picture and the width at which a notebook shows it, pixels."""
        image = self.picture(".png")
        inches = int.from_bytes(image[16:20], "big") / self.style.get("savefig.dpi", 100.0)
        return image, {"width": min(round(inches * NOTEBOOK_DPI), MOST_PIXELS)}

    def _write(self, target: Path | BinaryIO, suffix: str) -> None:
        with _only_settings(self.style):
            self.draw().savefig(target, format=suffix[1:], metadata=METADATA[suffix])


@contextmanager
def _only_settings(style: Mapping[str, Any]) -> Iterator[None]:
    """Draw with matplotlib's defaults and a style, without the user's matplotlibrc."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(dict[Any, Any](style))
        yield


Source = TypeVar("Source")
Figures = Mapping[str, Callable[[Source], Prepared]]
"""Name of a figure -> function that gathers its numbers from a source of results.

The function raises StoreError or ConfigError if numbers are missing, with the command to run.
"""
