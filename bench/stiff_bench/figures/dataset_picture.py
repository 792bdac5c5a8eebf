"""Picture of a data set: poses, load directions, deflections and joint torques."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import seaborn
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import COLORS, STYLE
from stiff_bench.store.samples import load_torque
from stiff_bench.tables.units import MM
from stiff_protocols.contract.types import AXES, BenchmarkData, FloatArray, IntArray, TextArray

SIZE_INCH = (10.0, 8.0)
_SCREEN: dict[str, Any] = {
    **STYLE,
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.8,
    "grid.color": "0.9",
    "grid.linewidth": 0.8,
    "savefig.dpi": 150,
}

MOST_POINTS = 3000  # in a cloud; more hide each other
MOST_GROUPS = 6  # in the legend
MOST_BINS = 50
LONGEST_LABEL = 9  # letters of a joint's name that is written horizontally
WIDE_RATIO = 30.0
"""Joints whose torques differ by more than this are drawn on a symmetric logarithmic axis."""


def dataset_picture(data: BenchmarkData, title: str) -> Prepared:
    """Return the picture of a data set of at least one sample."""
    return Prepared(title, "", partial(_draw, data, title), style=_SCREEN)


def _draw(data: BenchmarkData, title: str) -> Figure:
    samples = data.samples
    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    poses = np.sort(np.unique(samples.pose_id, return_index=True)[1])  # a row of each
    count = f"samples: {len(samples):,}   poses: {len(poses):,}   robot: {data.robot.name}"
    figure.suptitle(f"{title}\n{count}", fontsize=11.0)
    pages = figure.subfigures(2, 2, squeeze=False, wspace=0.03, hspace=0.04)
    cloud, loads, histograms, torques = pages.flat
    _draw_poses(cloud, data, poses)
    _draw_directions(loads, samples.wrench[:, :3])
    _draw_deflections(histograms, samples.deflection)
    _draw_torques(torques, data)
    return figure


def _head(page: SubFigure, text: str) -> None:
    page.suptitle(text, fontsize=10.0, fontweight="bold", x=0.02, horizontalalignment="left")


def _move_legend(page: SubFigure, panels: Sequence[Axes]) -> None:
    """Draw seaborn's legend of the first panel below all of them."""
    page.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    for axes in panels:
        if (legend := axes.get_legend()) is not None:
            legend.remove()


def _thinned(n: int) -> IntArray:
    """Return the rows to draw: all, or a reproducible random selection."""
    if n <= MOST_POINTS:
        return np.arange(n)
    return np.sort(np.random.default_rng(0).choice(n, MOST_POINTS, replace=False))


def _drawn_note(n_drawn: int, n: int) -> str:
    return "" if n_drawn == n else f" ({n_drawn:,} of {n:,} drawn)"


def _point_area(n: int) -> float:
    """Return the area of a point in square typographic points: smaller in a dense cloud."""
    return float(np.clip(4000.0 / max(n, 1), 5.0, 14.0))


def _draw_poses(page: SubFigure, data: BenchmarkData, poses: IntArray) -> None:
    """Draw TCP positions from the side and from above, one point per pose."""
    rows = poses[_thinned(len(poses))]
    x, y, z = data.robot.tcp_position(data.samples.q[rows]).T
    _head(page, f"(a) TCP positions, base frame{_drawn_note(len(rows), len(poses))}")
    side, above = page.subplots(1, 2)
    groups = _most_groups(data.samples.group[rows])
    look: dict[str, Any] = {"linewidth": 0.0, "alpha": 0.85, "rasterized": True}
    look["s"] = 1.5 * _point_area(len(rows))
    look["palette"] = COLORS[: len(dict.fromkeys(groups.tolist()))]
    for axes, across, up in ((side, np.hypot(x, y), z), (above, x, y)):
        seaborn.scatterplot(x=across, y=up, hue=groups, style=groups, ax=axes, **look)
        axes.plot(0.0, 0.0, "k+", markersize=9.0, label="base")
        axes.set_aspect("equal", adjustable="datalim")
        axes.locator_params(nbins=5)
    side.set(title="from the side", xlabel="distance from z axis [m]", ylabel="z [m]")
    above.set(title="from above", xlabel="x [m]", ylabel="y [m]")
    _move_legend(page, (side, above))


def _most_groups(groups: TextArray) -> TextArray:
    """Return (n,) groups; all after the first `MOST_GROUPS` are merged."""
    names = list(dict.fromkeys(groups.tolist()))
    if len(names) <= MOST_GROUPS:
        return groups
    merged_name = f"... and {len(names) - MOST_GROUPS} more groups"
    return np.where(np.isin(groups, names[:MOST_GROUPS]), groups, merged_name)


def _draw_directions(page: SubFigure, force: FloatArray) -> None:
    """Draw the force directions on equal-area maps of both half spheres."""
    force = force[force.any(axis=1)]
    size = np.linalg.norm(force, axis=1)
    rows = _thinned(len(force))
    _head(page, f"(b) Force directions, base frame{_drawn_note(len(rows), len(force))}")
    x, y, z = (force / size[:, None]).T
    radius = np.sqrt(1.0 - np.abs(z).clip(max=1.0))  # Lambert: 0 straight up or down, 1 horizontal
    azimuth = np.arctan2(y, x)
    scale = Normalize(*(size.min(), size.max()) if len(size) else (0.0, 0.0))
    halves = page.subplots(1, 2, subplot_kw={"projection": "polar"})
    for axes, down in zip(halves, (True, False), strict=True):
        half = (z < 0.0) == down
        half_rows = rows[half[rows]]
        look = {"s": _point_area(len(rows)), "norm": scale, "linewidths": 0.0, "rasterized": True}
        points = axes.scatter(azimuth[half_rows], radius[half_rows], c=size[half_rows], **look)
        axes.set(ylim=(0.0, 1.0), title=f"{'downwards' if down else 'upwards'}: {half.sum():,}")
        axes.set_xticks(np.deg2rad([0, 90, 180, 270]), ["+x", "+y", "-x", "-y"])
        circles = np.sqrt(1.0 - np.sin(np.deg2rad([30, 60])))
        axes.set_yticks(circles, [f"{'-' if down else '+'}{angle}°" for angle in (30, 60)])
        axes.set_rlabel_position(135.0)
    bar = page.colorbar(points, ax=list(halves), orientation="horizontal", shrink=0.7, aspect=30)
    bar.set_label("|F| [N]   (top view; circles: elevation above the horizontal)")
    bar.locator = MaxNLocator(6)
    bar.ax.set_visible(len(force) > 0)


def _draw_deflections(page: SubFigure, deflection: FloatArray) -> None:
    """Draw a histogram for each component, with common bins."""
    _head(page, "(c) Deflection of the TCP under load, base frame")
    millimetres = deflection * MM
    edges = np.histogram_bin_edges(millimetres, bins="auto")
    if len(edges) - 1 > MOST_BINS:
        edges = np.histogram_bin_edges(millimetres, bins=MOST_BINS)
    rows = page.subplots(3, 1, sharex=True, sharey=True)
    for axes, name, values in zip(rows, AXES, millimetres.T, strict=True):
        axes.hist(values, edges, color="0.55", edgecolor="white", linewidth=0.5)
        axes.axvline(0.0, color="black", linewidth=0.8)
        axes.yaxis.set_major_locator(MaxNLocator(3, integer=True))
        axes.set_ylabel(f"d{name}: samples")
    rows[-1].set_xlabel("displacement [mm]")


def _draw_torques(page: SubFigure, data: BenchmarkData) -> None:
    """Draw boxes of load torque and gravity torque per joint."""
    _head(page, "(d) Torque on the joints: quartiles and range")
    robot, axes = data.robot, page.subplots()
    kinds = zip(robot.joint_names, robot.joint_types, strict=True)
    joints = [f"{name} [N]" if kind == "prismatic" else name for name, kind in kinds]
    torques = {"load (Jᵀw)": load_torque(data.robot, data.samples)}
    if robot.has_masses:
        torques["weight of the links"] = robot.gravity_torque(data.samples.q)
    width = 0.7 / len(torques)
    middle = np.arange(len(joints)) - width * (len(torques) - 1) / 2.0
    look: dict[str, Any] = {"widths": 0.85 * width, "whis": (0.0, 100.0), "patch_artist": True}
    look |= {"medianprops": {"color": "black"}, "manage_ticks": False}
    for number, (label, torque) in enumerate(torques.items()):
        box = {"facecolor": COLORS[number], "alpha": 0.6}
        axes.boxplot(torque, positions=middle + number * width, boxprops=box, label=label, **look)
    axes.set_xticks(range(len(joints)), joints)
    axes.axhline(0.0, color="0.5", linewidth=0.8, zorder=0.5)
    axes.grid(visible=False, axis="x")
    if max(map(len, joints)) > LONGEST_LABEL:
        axes.tick_params(axis="x", rotation=25.0)
    sliding = "prismatic" in robot.joint_types
    axes.set(xlabel="joint", ylabel="torque [N m], force [N]" if sliding else "torque [N m]")
    _set_torque_scale(axes, np.concatenate(list(torques.values())))
    _move_legend(page, (axes,))


def _set_torque_scale(axes: Axes, torque: FloatArray) -> None:
    """Choose a symmetric logarithmic axis if the joints' torques differ much."""
    largest = np.abs(torque).max(axis=0)  # (n_joints,)
    seen = largest[largest > 1e-6 * largest.max()]  # rounding errors do not count
    if len(seen) and seen.max() > WIDE_RATIO * seen.min():
        linear = 10.0 ** np.floor(np.log10(seen.min()))
        axes.set_yscale("symlog", linthresh=linear, linscale=0.5)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.margins(y=0.08)
        axes.set_ylabel(f"{axes.get_ylabel()}, log beyond ±{linear:g}")
