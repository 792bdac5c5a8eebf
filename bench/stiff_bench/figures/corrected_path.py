"""A corrected path: what the commands remove, and the error that is expected to remain."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import PAGE_INCH, looks, new_figure, round_factor, share_legend
from stiff_bench.tables.units import MM
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.paths.compensation import Compensation
from stiff_protocols.paths.inverse import evenly_spaced

HEIGHT_INCH = 2.9
WANTED_COLOR = "0.55"
MOST_POINTS, ARROWS = 2_000, 40
"""Points of a line that are drawn, and error vectors."""
SHOWN_SHARE = 0.2
"""The largest error is drawn about this long, as a part of the path's extent."""


def path_picture(
    name: str,
    found: Compensation,
    remaining: FloatArray | None,
    source: str,
    extrapolates: Sequence[str],
) -> Prepared:
    """Return the figure of a corrected path, with what its marks mean.

    Args:
        name: of the path.
        found: points and commands.
        remaining: error that is expected to remain at the corrected points, m; None: not known.
        source: where it comes from.
        extrapolates: (n,) what of a point is beyond the training range.
    """
    return Prepared(
        title=f"Path {name}: deflection that is removed, error that remains",
        caption="Predicted deflections of the uncorrected path, magnified as stated; along the "
        "path the deflection that the commands take out, and the band of the error that is "
        f"expected to remain ({source}). Points beyond the training range are shaded.",
        paint=partial(_painted, found, remaining, extrapolates),
    )


def _painted(
    found: Compensation, remaining: FloatArray | None, extrapolates: Sequence[str]
) -> Figure:
    place, before = MM * found.wanted, MM * found.before
    rows, arrows = evenly_spaced(len(place), MOST_POINTS), evenly_spaced(len(place), ARROWS)
    removed = MM * found.removed
    extent, largest = max(float(np.ptp(place, axis=0).max()), 1.0), float(removed.max())
    times = round_factor(SHOWN_SHARE * extent / largest) if largest > 0.0 else 1.0
    blue, orange = looks(2)

    figure = new_figure(PAGE_INCH, HEIGHT_INCH)
    space = figure.add_subplot(1, 2, 1, projection="3d")
    space.plot(*place[rows].T, color=WANTED_COLOR, linewidth=2.6, label="wanted")
    moved = place + times * before
    space.plot(*moved[rows].T, color=orange.color, linewidth=0.8, label="without correction")
    vectors = np.stack([place[arrows], moved[arrows]], axis=1)
    space.add_collection3d(Line3DCollection(vectors, colors=orange.color, linewidths=0.5))
    drawn = np.concatenate([place[rows], moved[rows]])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    half = 0.5 * np.maximum(high - low, 0.4 * extent)
    for axis, centre, room in zip("xyz", 0.5 * (low + high), half, strict=True):
        space.set(**{f"{axis}lim": (centre - room, centre + room), f"{axis}label": f"{axis} [mm]"})
        space.locator_params(axis=axis, nbins=4)
    space.set_box_aspect(half, zoom=0.82)  # room for the labels
    space.set_title(f"(a) Path, deflections times {times:g}", loc="left")

    along = figure.add_subplot(1, 2, 2)
    distance = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))]
    marker = "o" if len(place) == 1 else ""
    label = "removed deflection"
    along.plot(distance[rows], removed[rows], color=orange.color, marker=marker, label=label)
    title = f"(b) Mean {removed.mean():.3g} mm removed"
    if remaining is not None and found.converged.any():
        left = np.full(len(place), np.nan)
        left[found.converged] = MM * remaining
        band: dict[str, Any] = {"color": blue.color, "alpha": 0.2, "linewidth": 0}
        label = "expected remaining error"
        along.fill_between(distance[rows], 0.0, left[rows], **band, label=label)
        along.plot(distance[rows], left[rows], color=blue.color, linewidth=0.8, marker=marker)
        title += f", {np.nanmean(left):.2g} mm expected to remain"
    beyond = np.array([bool(word) for word in extrapolates])
    if beyond.any():
        style: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.8", "hatch": "///"}
        shade = along.fill_between(
            distance,
            0.0,
            1.0,
            where=beyond | np.roll(beyond, 1) if len(beyond) > 1 else beyond,
            transform=along.get_xaxis_transform(),
            label=f"beyond the training range ({beyond.mean():.0%})",
            zorder=0,
            **style,
        )
        shade.set_linewidth(0.0)
    along.set(xlabel="distance along the path [mm]", ylabel="length [mm]")
    along.set_ylim(bottom=0.0)
    along.set_title(title, loc="left")
    share_legend(figure, [space, along])
    return figure
