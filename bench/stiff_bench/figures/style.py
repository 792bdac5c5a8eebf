"""Style of all figures: journal widths, small type and colour-blind safe colours."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from string import ascii_lowercase
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from stiff_bench.console import one_line
from stiff_bench.store.names import OPTION_MARK, grouped, split_word

COLUMN_INCH, PAGE_INCH = 3.46, 7.09
"""One column of a journal (88 mm), and both (180 mm)."""

STYLE: dict[str, Any] = {
    "savefig.dpi": 300,  # of a PNG
    "font.size": 7.0,
    "axes.titlesize": 7.5,
    "figure.titlesize": 8.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "0.92",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.0,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "pdf.fonttype": 42,  # letters that an editor can change
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "stiffbench",
    "text.parse_math": False,  # a model may have "$" in its name
}

REFERENCE_COLOR = "0.35"
"""Colour of identity lines, published values and other items that are not compared."""
COLORS = ("#0173b2", "#d55e00", "#029e73", "#6a1b4d", "#c873b8", "#2a1a7a", "#858585", "#5b3410")
"""Blue, orange, green ...: on white each has a contrast of 3:1, which a test computes.

The first three are from Okabe and Ito. The others differ in lightness, for colour-blind readers.
"""
_MARKERS = "osD^vP<X"
_LINES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 2)), (0, (8, 2)), (0, (3, 2)))


@dataclass(frozen=True)
class Look:
    """Colour, marker and line of a series; it is recognisable without colour."""

    color: str
    marker: str
    line: Any

    def points(self) -> dict[str, Any]:
        """Return the style of unconnected points."""
        return {"color": self.color, "marker": self.marker, "linestyle": "none"}

    def connected(self) -> dict[str, Any]:
        """Return the style of a line."""
        return {"color": self.color, "linestyle": self.line}


def looks(n: int) -> list[Look]:
    """Return `n` looks; after eight, colours repeat with other markers."""
    shifted = [(number, (number + number // len(COLORS)) % len(COLORS)) for number in range(n)]
    return [
        Look(COLORS[number % len(COLORS)], _MARKERS[style_number], _LINES[style_number])
        for number, style_number in shifted
    ]


def looks_of(names: Iterable[Any]) -> dict[Any, Look]:
    """Return a look for each name, in their order."""
    different = list(dict.fromkeys(names))
    return dict(zip(different, looks(len(different)), strict=True))


def seaborn_looks(names: Sequence[Any]) -> dict[str, Any]:
    """Return seaborn keywords with the colour and marker of each name."""
    name_looks = looks(len(names))
    return {
        "hue_order": names,
        "palette": [look.color for look in name_looks],
        "style_order": names,
        "markers": [look.marker for look in name_looks],
        "dashes": False,
        "markeredgewidth": 0.0,
    }


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure; sizes in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def new_panels(n: int, row_inch: float, legend_inch: float) -> tuple[Figure, list[Axes]]:
    """Return a figure and its `n` panels, at most three per row.

    A single panel is one column wide.
    """
    n_columns = min(n, 3)
    n_rows = -(-n // n_columns)
    figure = new_figure(COLUMN_INCH if n == 1 else PAGE_INCH, n_rows * row_inch + legend_inch)
    panels = list(figure.subplots(n_rows, n_columns, squeeze=False).flat)
    for axes in panels[n:]:
        axes.remove()
    return figure, panels[:n]


def add_subtitle(figure: Figure, text: str) -> None:
    """Write a line above all panels, and enlarge the figure by its height."""
    width, height = figure.get_size_inches()
    letters = int(width * SUBTITLE_LETTERS_PER_INCH)
    figure.set_size_inches(width, height + SUBTITLE_INCH)
    figure.suptitle(short(text, letters), x=0.01, ha="left", fontsize=SUBTITLE_POINTS)


def name_panels(panels: Sequence[Axes]) -> None:
    """Write (a), (b), ... before the titles of several panels."""
    for number, axes in enumerate(panels if len(panels) > 1 else ()):
        letter = ascii_lowercase[number] if number < len(ascii_lowercase) else str(number + 1)
        axes.set_title(f"({letter}) {axes.get_title(loc='left')}".rstrip(), loc="left")


def label_left(panels: Iterable[Axes], label: str = "") -> None:
    """Label the y axes of the first column of panels."""
    for axes in panels:
        place = axes.get_subplotspec()
        is_first = place is None or place.is_first_col()
        axes.set_ylabel(label if is_first else "")
        axes.tick_params(labelleft=is_first)


def share_legend(figure: Figure, panels: Iterable[Axes], *, ncols: int = 4, **spacing: Any) -> None:
    """Draw one legend for all panels below them, each name once."""
    handles: dict[str, Any] = {}
    for axes in panels:
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    place: Any = "outside lower center"
    figure.legend(list(handles.values()), list(handles), loc=place, ncols=ncols, **spacing)


LEGEND_LINE_INCH, LEGEND_LETTERS_PER_INCH, LEGEND_MARK_INCH = 0.17, 15.0, 0.45
"""Height of a legend's line, letters (of 7 points) in an inch, and width of the mark of a name."""


def legend_layout(
    names: Collection[str], n_panels: int, *, most: int, n_others: int
) -> tuple[int, float]:
    """Return the columns and the height [inch] of a legend below `new_panels`.

    It has the short texts of `names` and `n_others` entries with shorter texts. The columns are at
    most `most`, and as many as fit.
    """
    width = COLUMN_INCH if n_panels == 1 else PAGE_INCH
    longest = max(map(len, names), default=0)
    fitting = width / (LEGEND_MARK_INCH + longest / LEGEND_LETTERS_PER_INCH)
    n_columns = int(min(most, max(1.0, fitting)))
    return n_columns, LEGEND_LINE_INCH * -(-(len(names) + n_others) // n_columns)


SUBTITLE_POINTS, SUBTITLE_INCH, SUBTITLE_LETTERS_PER_INCH = 7.5, 0.18, 17.0
FINE_STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
"""Ticks of a logarithmic axis that often spans less than a decade."""


def plain_numbers(axis: Axis, steps: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Write 0.1, 0.2, 0.5, 1 on a logarithmic axis, or other steps of each decade."""
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def round_factor(factor: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... (or their tenths) that is not above a factor."""
    power = 10.0 ** np.floor(np.log10(factor))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= factor * 1.001))


MOST_LETTERS = 34
"""Longest name in a legend or on an axis, letters."""
PANEL_LETTERS = 22
"""Longest name above one of three panels in a row, letters."""


def short(name: str, most: int = MOST_LETTERS) -> str:
    """Return a name that fits a legend: printable, and long names cut in the middle."""
    text = one_line(name)
    if len(text) <= most:
        return text
    head = (most - 1) * 2 // 3
    return f"{text[:head]}…{text[len(text) - (most - 1 - head) :]}"


def short_names(names: Iterable[str]) -> dict[str, str]:
    """Return a different short text for each name.

    Equal short names lose their shared options. If they are still equal, a number is added.
    """
    texts = {name: short(name) for name in names}
    for alike in _alike(texts):
        shared = set.intersection(*(set(split_word(name)[1]) for name in alike))
        for name in alike:
            key, options = split_word(name)
            differing = [option for option in options if option not in shared]
            texts[name] = short(OPTION_MARK.join([key, *differing, "…"]))
    for alike in _alike(texts):
        for number, name in enumerate(alike, start=1):
            texts[name] = short(f"{number}: {name}")
    # matplotlib leaves labels that begin with an underscore out of a legend
    return {name: f" {text}" if text.startswith("_") else text for name, text in texts.items()}


def _alike(texts: Mapping[str, str]) -> list[list[str]]:
    return [names for names in grouped(texts, texts.__getitem__).values() if len(names) > 1]
