"""Stiffness map: values over a plane of the workspace, with arm, load and extremes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from stiff_bench.figures import style
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.robot_picture import ARM_COLOR, FORCE_COLOR, arm_points
from stiff_bench.tables.units import MM
from stiff_protocols.contract.types import AXES, BoolArray, FloatArray, Robot

TOP_SHARE = 0.98
"""Share of values below the end of the colour scale; values are unbounded at the reach's edge."""
CONTOURS = 7
HATCH, HATCH_COLOR = "////", "0.35"
ARROW_SHARE = 0.16
"""Length of the force in the plane of the picture, as a share of the panel's longer side."""
LEAST_SHOWN = 0.2
"""Share of a force in the plane of the picture from which it is drawn as an arrow."""
MARGIN_SHARE = 0.04
"""Empty space around the drawn points, as a share of the panel's longer side."""
LEGEND_COLUMNS = 2
MARKS = {"stiffest": "^", "softest": "s"}
TITLE_INCH, LABEL_INCH, BAR_INCH, GAP_INCH, LINE_INCH = 0.2, 0.5, 0.42, 0.08, 0.17
"""Room for the title, axis labels, the colour bar, at the panel, and a line of the legend."""
TALLEST_PANEL = 1.4
"""Height of a panel over its width at most."""
MAP_STYLE = style.STYLE | {"hatch.linewidth": 0.35}
SIGNED, UNSIGNED = "RdBu_r", "viridis_r"


@dataclass(frozen=True, eq=False)
class MapContent:
    """Values, marks and arm of a picture.

    Attributes:
        title: place of the plane.
        first: (n_columns,) positions along the horizontal axis, mm.
        second: (n_rows,) positions along the vertical axis, mm.
        values: (n_rows, n_columns) values in the map's unit; NaN where blank.
        is_far: (n_rows, n_columns) true if a point is far from the training poses.
        is_jump: (n_rows, n_columns) true if a neighbour has another configuration.
        marks: name from `MARKS` -> (2,) place of the marked point, mm, and its value.
        axes: numbers of the horizontal and the vertical axis, base frame.
        arm: (n, 3) base, joints and TCP at the stiffest point, base frame, mm.
        force: (3,) force, N, base frame; zero for none.
        label: quantity of the colours with its unit.
        unit: unit of the values.
    """

    title: str
    first: FloatArray
    second: FloatArray
    values: FloatArray
    is_far: BoolArray
    is_jump: BoolArray
    marks: Mapping[str, tuple[FloatArray, float]]
    axes: tuple[int, int]
    arm: FloatArray
    force: FloatArray
    label: str
    unit: str

    @property
    def shows_force(self) -> bool:
        """True if the plane of the picture shows a good part of the force."""
        in_plane = float(np.linalg.norm(self.force[list(self.axes)]))
        return in_plane > LEAST_SHOWN * float(np.linalg.norm(self.force))


def arm_line(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the (n_joints + 2, 3) base, joints and TCP at (n_joints,) q, base frame, mm."""
    return np.asarray(arm_points(robot, q[None])[0] * MM)


def stiffness_map_picture(content: MapContent, about: str, quantity: str, place: str) -> Prepared:
    """Return the picture of a map.

    Args:
        content: values, marks and arm.
        about: model, robot and load, above the panel.
        quantity: mapped quantity with its load.
        place: planes and orientation of the tool.
    """
    caption = (
        f"{about}: {quantity}; {place}. Each point has the configuration nearest to a training "
        "pose, inside the joint limits; contours end where it changes. Blank: out of reach, beyond "
        "limits or singular. Hatched: a joint is beyond its training range, or the nearest "
        f"training pose is far. The colours end at the {TOP_SHARE:.0%} quantile."
    )
    return Prepared(
        f"Stiffness map, {quantity}", caption, partial(_painted, content), about, MAP_STYLE
    )


def _painted(content: MapContent) -> Figure:
    low, high = _limits(content)
    panel_inch = style.COLUMN_INCH - LABEL_INCH - GAP_INCH
    panel_inch *= min((high - low)[1] / (high - low)[0], TALLEST_PANEL)
    handles = _legend_handles(content)
    legend_inch = LINE_INCH * -(-len(handles) // LEGEND_COLUMNS)
    height = panel_inch + TITLE_INCH + LABEL_INCH + BAR_INCH + legend_inch
    figure = style.new_figure(style.COLUMN_INCH, height)
    axes = figure.add_subplot()
    norm, colors, extend = _scale(content.values)
    drawn = _draw_plane(axes, content, norm, colors)
    _draw_arm(axes, content, (high - low).max())
    for name, (place, _) in content.marks.items():
        axes.plot(*place, **_mark_look(name))
    horizontal, vertical = (f"{AXES[axis]} [mm]" for axis in content.axes)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel=horizontal, ylabel=vertical)
    axes.set_title(content.title, loc="left")
    axes.locator_params(nbins=6)
    axes.grid(False)
    bar = figure.colorbar(drawn, ax=axes, extend=extend, location="bottom", aspect=30, pad=0.02)
    bar.set_label(content.label)
    bar.outline.set_visible(False)
    below: Any = "outside lower center"
    figure.legend(handles=handles, loc=below, ncols=LEGEND_COLUMNS)
    return figure


def _limits(content: MapContent) -> tuple[FloatArray, FloatArray]:
    """Return the (2,) lower and upper limits of the panel, mm: all values and the arm."""
    rows, columns = np.nonzero(~np.isnan(content.values))
    values = np.column_stack([content.first[columns], content.second[rows]])
    drawn = np.concatenate([content.arm[:, content.axes], values])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    room = MARGIN_SHARE * (high - low).max()
    return low - room, high + room


def _scale(values: FloatArray) -> tuple[Normalize, str, str]:
    """Return colour scale, colour map name, and the cut end.

    Zero is in the middle for values of both signs.
    """
    values = values[~np.isnan(values)]
    lowest, highest = float(values.min()), float(values.max())
    if lowest < 0.0 < highest:
        reach = float(np.quantile(np.abs(values), TOP_SHARE))
        return Normalize(-reach, reach), SIGNED, "both"
    if highest <= 0.0:
        low = float(np.quantile(values, 1.0 - TOP_SHARE))
        return Normalize(low, highest), UNSIGNED.removesuffix("_r"), "min"
    return Normalize(lowest, float(np.quantile(values, TOP_SHARE))), UNSIGNED, "max"


def _draw_plane(axes: Axes, plane: MapContent, norm: Normalize, colors: str) -> Any:
    """Draw the values of a plane, its contours and the hatched part; return the colours."""
    grid = plane.first, plane.second
    look: dict[str, Any] = {"shading": "nearest", "rasterized": True, "zorder": 1.0}
    drawn = axes.pcolormesh(*grid, plane.values, norm=norm, cmap=colors, **look)
    if min(plane.values.shape) < 2:
        return drawn
    values = np.ma.masked_where(np.isnan(plane.values) | plane.is_jump, plane.values)
    levels = MaxNLocator(CONTOURS).tick_values(norm.vmin or 0.0, norm.vmax or 0.0)[1:-1]
    if values.count() and np.any((levels > values.min()) & (levels < values.max())):
        lines = axes.contour(*grid, values, levels, colors="0.15", linewidths=0.5, zorder=2.0)
        halo = [withStroke(linewidth=1.6, foreground="white")]
        for text in axes.clabel(lines, fmt="%g", fontsize=5.5, inline=False):
            text.set(path_effects=halo, zorder=2.1)  # the arm is above
    if plane.is_far.any():
        far = plane.is_far.astype(float)
        hatched = axes.contourf(*grid, far, [0.5, 1.5], colors="none", hatches=[HATCH], zorder=1.5)
        hatched.set(edgecolor=HATCH_COLOR, linewidth=0.0)
        axes.contour(*grid, far, [0.5], colors=HATCH_COLOR, linewidths=0.5, zorder=1.6)
    return drawn


def _draw_arm(axes: Axes, content: MapContent, side: float) -> None:
    """Draw the arm, and the force as an arrow if it shows in a panel of this longer side [mm]."""
    arm = content.arm[:, content.axes]
    wide: dict[str, Any] = {"solid_capstyle": "round", "solid_joinstyle": "round", "zorder": 3.0}
    outline = [withStroke(linewidth=4.6, foreground="white")]
    axes.plot(*arm.T, color=ARM_COLOR, linewidth=3.2, path_effects=outline, **wide)
    axes.plot(*arm[1:-1].T, "o", color="white", ms=2.4, mec="black", mew=0.6, zorder=3.1)
    if content.shows_force:
        force = content.force[list(content.axes)] / np.linalg.norm(content.force)
        end = arm[-1] + ARROW_SHARE * side * force
        arrow = {"arrowstyle": "-|>", "color": FORCE_COLOR, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tuple(end), xytext=tuple(arm[-1]), arrowprops=arrow, zorder=4.0)


def _mark_look(name: str) -> dict[str, Any]:
    """Return the look of a marked point."""
    look: dict[str, Any] = {"marker": MARKS[name], "linestyle": "none", "zorder": 5.0}
    look |= {"ms": 5.0, "mew": 0.8}
    return look | {"color": "white", "mec": "black", "clip_on": False}


def _legend_handles(content: MapContent) -> list[Any]:
    """Return the legend entries."""
    handles: list[Any] = [
        Line2D([], [], **_mark_look(name), label=f"{name}, {value:.3g} {content.unit}")
        for name, (_, value) in content.marks.items()
    ]
    arm: dict[str, Any] = {"color": ARM_COLOR, "label": "arm at the stiffest point"}
    handles.append(Line2D([], [], linewidth=3.0, **arm))
    if content.force.any():
        size = f"force {np.linalg.norm(content.force):.4g} N"
        if content.shows_force:
            handles.append(Line2D([], [], color=FORCE_COLOR, linewidth=1.6, label=size))
        else:
            handles.append(Line2D([], [], linestyle="none", label=f"{size}, across the plane"))
    if content.is_far.any():
        look: dict[str, Any] = {"facecolor": "none", "edgecolor": HATCH_COLOR, "linewidth": 0.5}
        handles.append(Patch(hatch=HATCH * 2, label="far from the training poses", **look))
    return handles
