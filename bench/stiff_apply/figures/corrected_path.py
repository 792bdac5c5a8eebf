"""Corrected path: removed deflection and expected errors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import PAGE_INCH, looks, new_figure, round_factor, share_legend
from stiff_bench.tables.units import MM
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.paths.compensation import Compensation
from stiff_protocols.paths.inverse import evenly_spaced
from stiff_protocols.scoring.cross_validated import ErrorLengths

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEIGHT_INCH = 3.1
WANTED_COLOR = "0.55"
MOST_POINTS, ARROWS = 2_000, 40
"""Largest numbers of points per line and of arrows."""
SHOWN_SHARE = 0.2
"""The largest deflection or error is drawn about this long, as a part of the path's extent."""
CORNERS = np.linspace(0.0, 2.0 * np.pi, 25)
"""Angles, rad, at which the circle of an expected error is drawn."""
HATCHES = ("", "////", "....")
"""Hatches of the regions beyond the training range, one per reason."""


def path_picture(
    name: str,
    compensation: Compensation,
    mean: ErrorLengths,
    half_width: ErrorLengths,
    extrapolates: Sequence[str],
) -> Prepared:
    """Return the figure of a corrected path with its caption.

    Args:
        name: name of the path.
        compensation: wanted points, commands and predicted deflections.
        mean: expected mean distance from the path.
        half_width: half width of the interval of that distance.
        extrapolates: (n,) names of what is beyond the training range at a point; "" for none.
    """
    return Prepared(
        title=f"Path {name}: removed deflection and expected errors",
        caption="Predicted deflections of the uncorrected path and radii of the expected mean "
        "error, magnified as stated; and both along the path. "
        f"{mean.name.capitalize()}: {mean.source}. "
        f"{half_width.name.capitalize()}: {half_width.source}. "
        "Shaded: beyond the training range of the model.",
        paint=partial(_painted, compensation, mean, half_width, extrapolates),
    )


def _painted(
    compensation: Compensation,
    mean: ErrorLengths,
    half_width: ErrorLengths,
    extrapolates: Sequence[str],
) -> Figure:
    place, before = MM * compensation.target, MM * compensation.before
    removed = MM * np.linalg.norm(compensation.removed, axis=1)
    errors = None if mean.values is None else MM * mean.values
    rows, arrows = evenly_spaced(len(place), MOST_POINTS), evenly_spaced(len(place), ARROWS)
    extent = max(float(np.ptp(place, axis=0).max()), 1.0)
    largest = float(np.linalg.norm(before, axis=1).max())
    largest = max(largest, 0.0 if errors is None else float(errors.max()))
    times = round_factor(SHOWN_SHARE * extent / largest) if largest > 0.0 else 1.0
    blue, orange = looks(2)

    figure = new_figure(PAGE_INCH, HEIGHT_INCH)
    space = figure.add_subplot(1, 2, 1, projection="3d")
    moved = place + times * before
    space.plot(*place[rows].T, color=WANTED_COLOR, linewidth=1.6, label="wanted")
    space.plot(*moved[rows].T, color=orange.color, linewidth=0.8, label="without correction")
    vectors = np.stack([place[arrows], moved[arrows]], axis=1)
    space.add_collection3d(Line3DCollection(vectors, colors=orange.color, linewidths=0.5))
    drawn = np.concatenate([place[rows], moved[rows]])
    if errors is not None:
        circles = _circles(place, times * errors, arrows)
        look: dict[str, Any] = {"facecolors": blue.color, "alpha": 0.1, "linewidths": 0}
        space.add_collection3d(Poly3DCollection(circles, **look))
        drawn = np.concatenate([drawn, circles.reshape(-1, 3)])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    half = 0.5 * np.maximum(high - low, 0.4 * extent)
    for axis, centre, room in zip("xyz", 0.5 * (low + high), half, strict=True):
        space.set(**{f"{axis}lim": (centre - room, centre + room), f"{axis}label": f"{axis} [mm]"})
        space.locator_params(axis=axis, nbins=4 if room > 0.4 * extent else 2)
    space.set_box_aspect(half, zoom=0.82)  # room for the labels
    space.set_title(f"(a) Path, deflections and errors times {times:g}", loc="left")

    along = figure.add_subplot(1, 2, 2)
    distance = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))]
    marker = "o" if len(place) == 1 else ""
    look = {"color": orange.color, "marker": marker}
    along.plot(distance[rows], removed[rows], **look, label="removed (predicted deflection)")
    means = f"Mean removed {removed.mean():.3g} mm, expected error unknown"
    if errors is not None:
        band: dict[str, Any] = {"color": blue.color, "alpha": 0.2, "linewidth": 0}
        along.plot(distance[rows], errors[rows], color=blue.color, marker=marker, linewidth=0.8)
        along.fill_between(distance[rows], 0.0, errors[rows], **band, label=mean.name)
        means = f"Means: removed {removed.mean():.3g} mm, expected error {errors.mean():.3g} mm"
    if half_width.values is not None:
        look = {"color": blue.color, "linestyle": ":", "marker": marker, "linewidth": 0.8}
        along.plot(distance[rows], MM * half_width.values[rows], **look, label=half_width.name)
    along.set(xlabel="distance along the path [mm]", ylabel="length [mm]")
    along.set_ylim(bottom=0.0)
    along.set_title(f"(b) {means}", loc="left")
    _shade(along, distance, extrapolates)
    share_legend(figure, [space, along], ncols=3)
    return figure


def _circles(place: FloatArray, radius: FloatArray, rows: Any) -> FloatArray:
    """Return (n_rows, n_corners, 3) circles about points of a path, across its direction."""
    tangent = np.gradient(place, axis=0)[rows] if len(place) > 1 else np.eye(3)[:1]
    least = np.eye(3)[np.abs(tangent).argmin(axis=1)]  # never parallel to the path
    first = np.cross(tangent, least)
    length = np.linalg.norm(first, axis=1, keepdims=True)
    first = np.divide(first, length, out=least.copy(), where=length > 0.0)
    second = np.cross(tangent, first)
    length = np.linalg.norm(second, axis=1, keepdims=True)
    second = np.divide(second, length, out=np.roll(least, 1, axis=1), where=length > 0.0)
    around = np.cos(CORNERS)[:, None] * first[:, None] + np.sin(CORNERS)[:, None] * second[:, None]
    return np.asarray(place[rows, None] + radius[rows, None, None] * around)


def _shade(along: Axes, distance: FloatArray, extrapolates: Sequence[str]) -> None:
    """Shade parts of a path beyond the training range, hatched by reason."""
    words = np.array(extrapolates)
    reasons = [word for word in dict.fromkeys(extrapolates) if word]
    edges = np.r_[distance[0], 0.5 * (distance[1:] + distance[:-1]), distance[-1]]
    if distance[-1] == 0.0:  # all points are the same place
        edges = np.r_[np.full(len(distance), -0.5), 0.5]
    starts = np.flatnonzero(np.r_[True, words[1:] != words[:-1]])
    ends = np.r_[starts[1:], len(words)]
    named = set()
    for start, end in zip(starts, ends, strict=True):
        if not (word := str(words[start])):
            continue
        label = f"beyond the training range: {word.replace(' ', ', ')}"
        along.axvspan(
            edges[start],
            edges[end],
            facecolor="0.9",
            edgecolor="0.7",
            hatch=HATCHES[reasons.index(word) % len(HATCHES)],
            linewidth=0.0,
            label="" if word in named else label,
            zorder=0.0,
        )
        named.add(word)
