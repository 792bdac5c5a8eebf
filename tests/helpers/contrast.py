"""Contrast of colours on white paper, as WCAG 2 defines it."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

LEAST_CONTRAST = 3.0
"""Least contrast of graphical objects: WCAG 2.1, success criterion 1.4.11."""


def contrast_on_white(color, alpha: float = 1.0) -> float:
    """Return the contrast ratio (1..21) of a colour on white."""
    red, green, blue = (1.0 - alpha * (1.0 - np.array(to_rgb(color)))).tolist()
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4
        for part in (red, green, blue)
    ]
    luminance = float(np.dot([0.2126, 0.7152, 0.0722], linear))
    return 1.05 / (luminance + 0.05)


def pale_lines(figure: Figure) -> list[str]:
    """Return the drawn lines whose contrast on white is too small, without grid and ticks."""
    artists = [artist for axes in figure.axes for artist in axes.get_children()]
    pale = []
    for artist in artists:
        if isinstance(artist, Line2D) and len(artist.get_xdata()):
            alpha = artist.get_alpha() or to_rgba(artist.get_color())[3]
            colors = [to_rgba(artist.get_color(), alpha)]
        elif isinstance(artist, LineCollection):
            colors = artist.get_edgecolor()
        else:
            continue
        for *rgb, alpha in colors:
            if contrast_on_white(rgb, alpha) < LEAST_CONTRAST:
                pale.append(f"{artist.get_label()}: {rgb}")
    return pale
