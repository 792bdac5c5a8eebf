"""A corrected path: where the tool would be without correction, and the errors along the path."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import PAGE_INCH, looks, new_figure, round_factor, share_legend
from stiff_bench.tables.units import MM
from stiff_protocols.contract.types import Interval
from stiff_protocols.paths.compensation import Compensation
from stiff_protocols.paths.inverse import evenly_spaced

HEIGHT_INCH = 2.9
WANTED_COLOR = "0.55"
MOST_POINTS, ARROWS = 2_000, 40
"""Points of a line that are drawn, and error vectors."""
SHOWN_SHARE = 0.2
"""The largest error is drawn about this long, as a part of the path's extent."""


def path_picture(name: str, found: Compensation, interval: Interval | None) -> Prepared:
    """Return the figure of a corrected path, with what its marks mean."""
    return Prepared(
        title=f"Path {name} before and after correction",
        caption="Predicted error vectors of the uncorrected path, magnified as stated, and the "
        "length of the error along the path. The band is the length of the intervals' half-widths.",
        paint=partial(_painted, found, interval),
    )


def _painted(found: Compensation, interval: Interval | None) -> Figure:
    place, before, after = MM * found.wanted, MM * found.before, MM * found.after
    rows, arrows = evenly_spaced(len(place), MOST_POINTS), evenly_spaced(len(place), ARROWS)
    size_before, size_after = (np.linalg.norm(one, axis=1) for one in (before, after))
    extent, largest = max(float(np.ptp(place, axis=0).max()), 1.0), float(size_before.max())
    times = round_factor(SHOWN_SHARE * extent / largest) if largest > 0.0 else 1.0
    blue, orange = looks(2)

    figure = new_figure(PAGE_INCH, HEIGHT_INCH)
    space = figure.add_subplot(1, 2, 1, projection="3d")
    space.plot(*place[rows].T, color=WANTED_COLOR, linewidth=2.6, label="wanted")
    moved, corrected = place + times * before, place + times * after
    space.plot(*moved[rows].T, color=orange.color, linewidth=0.8, label="without correction")
    vectors = np.stack([place[arrows], moved[arrows]], axis=1)
    space.add_collection3d(Line3DCollection(vectors, colors=orange.color, linewidths=0.5))
    space.plot(*corrected[rows].T, color=blue.color, label="corrected")
    drawn = np.concatenate([place[rows], moved[rows], corrected[rows]])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    half = 0.5 * np.maximum(high - low, 0.4 * extent)
    for axis, centre, room in zip("xyz", 0.5 * (low + high), half, strict=True):
        space.set(**{f"{axis}lim": (centre - room, centre + room), f"{axis}label": f"{axis} [mm]"})
        space.locator_params(axis=axis, nbins=4)
    space.set_box_aspect(half, zoom=0.82)  # room for the labels
    space.set_title(f"(a) Path, errors times {times:g}", loc="left")

    along = figure.add_subplot(1, 2, 2)
    distance = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))]
    marker = "o" if len(place) == 1 else ""
    for size, look in ((size_before, orange), (size_after, blue)):
        along.plot(distance[rows], size[rows], color=look.color, marker=marker)
    if interval is not None:
        width = 0.5 * MM * np.linalg.norm(interval.upper - interval.lower, axis=1)
        band: dict[str, Any] = {"color": blue.color, "alpha": 0.2, "linewidth": 0}
        label = f"half-width of the {interval.coverage:.0%} interval"
        along.fill_between(distance[rows], 0.0, width[rows], **band, label=label)
    along.set(xlabel="distance along the path [mm]", ylabel="predicted path error [mm]")
    along.set_ylim(bottom=0.0)
    means = f"Mean {size_before.mean():.3g} mm before, {size_after.mean():.1g} mm after"
    along.set_title(f"(b) {means}", loc="left")
    share_legend(figure, [space, along])
    return figure
