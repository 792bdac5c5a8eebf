"""Figures of a board: score against cost, and against training poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import (
    COLUMN_INCH,
    PAGE_INCH,
    REFERENCE_COLOR,
    looks_of,
    new_figure,
    short_names,
)
from stiff_bench.results.columns import number
from stiff_bench.results.leaderboard import StudyLeaderboard
from stiff_bench.tables.units import percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.scoring.paired import LEVEL

COST_INCH, CURVES_INCH = 4.2, 3.0
"""Heights of the figures."""
TICKS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Ratios to the VJM's error that an axis names."""
MOST_CURVES = 8
Row = Mapping[Any, Any]
"""Row of `leaderboard.model_frame`."""


def score_against_cost(board: StudyLeaderboard) -> Prepared:
    """Show error over the VJM's error against fit time.

    Raises:
        ConfigError: no time of a fit was recorded.
    """
    rows = [row for row in board.board_frame.to_dict("records") if row["fit_s"] > 0.0]
    if not rows:
        raise ConfigError("no time of a fit was recorded")
    caption = (
        f"Error over the VJM's, geometric mean over {board.scores.scope} with its "
        f"{percent(1.0 - LEVEL)} interval, against the median time of a fit on one core. "
        "Lower left is better; a cached pre-training costs nothing."
    )
    return Prepared("Score against cost", caption, partial(_cost_figure, rows))


def _cost_figure(rows: Sequence[Row]) -> Figure:
    figure = new_figure(PAGE_INCH, COST_INCH)
    axes = figure.subplots()
    names = [row["model"] for row in rows]
    labels = short_names(names)
    for row, look in zip(rows, looks_of(names).values(), strict=True):
        bounds = [[row["ratio"] - row["low"]], [row["high"] - row["ratio"]]]
        axes.errorbar(row["fit_s"], row["ratio"], yerr=bounds, **look.points(), lw=0.8)
    axes.set(xscale="log", xlabel="time of a fit [s]")
    axes.xaxis.set_major_formatter("{x:g}")
    _ratio_axis(axes)
    _name_points(axes, [(row["fit_s"], row["ratio"], labels[row["model"]]) for row in rows])
    return figure


def _name_points(axes: Axes, points: Sequence[tuple[float, float, str]]) -> None:
    """Write names to the right of points, without overlaps."""
    axes.figure.canvas.draw()
    to_pixels, height = axes.transData.transform, 8.0
    taken: list[tuple[float, float]] = []
    for x, y, name in sorted(points, key=lambda point: point[1]):
        across, up = to_pixels((x, y))
        place = up
        while any(abs(place - v) < height and abs(across - h) < 110.0 for h, v in taken):
            place += height / 4.0
        taken.append((across, place))
        axes.annotate(
            name,
            (x, y),
            xytext=(5.0, (place - up) * 72.0 / axes.figure.dpi - 2.0),
            textcoords="offset points",
            fontsize=6.0,
        )


def score_against_poses(board: StudyLeaderboard) -> Prepared:
    """Show error over the VJM's error against training poses.

    Raises:
        ConfigError: the board has no scores with fewer poses.
    """
    sizes = {heading: int(heading.split()[0]) for heading in board.few}
    curves = {
        row["model"]: row
        for row in board.board_frame.to_dict("records")
        if sizes and row["model"] != REFERENCE_MODEL
        if all(number(row, ("few", heading)) is not None for heading in sizes)
    }
    if not curves:
        raise ConfigError("no model has scores with fewer poses")
    best_rows = dict(list(curves.items())[:MOST_CURVES])
    n_all = max(result.n_train for result in board.scores.tasks[-1].results[REFERENCE_MODEL])
    caption = (
        "Error over the VJM's with as many poses, geometric mean over robots: the best "
        f"{len(best_rows)} of {len(curves)} models with scores at every number of poses."
    )
    paint = partial(_curves_figure, best_rows, sizes, n_all)
    return Prepared("Score against the number of poses", caption, paint)


def _curves_figure(rows: Mapping[str, Row], sizes: Mapping[str, int], n_all: int) -> Figure:
    figure = new_figure(COLUMN_INCH * 1.5, CURVES_INCH)
    axes = figure.subplots()
    labels = short_names(rows)
    for name, look in looks_of(rows).items():
        few = [(size, rows[name]["few", heading]) for heading, size in sizes.items()]
        x, y = zip(*sorted([(n_all, rows[name]["ratio"]), *few]), strict=True)
        axes.plot(x, y, **look.connected(), marker=look.marker, label=labels[name])
    ticks = sorted([*sizes.values(), n_all])
    axes.set(xscale="log", xlabel="training poses")
    axes.set_xticks(ticks, map(str, ticks))
    axes.set_xticks([], minor=True)
    _ratio_axis(axes)
    axes.legend(fontsize=6.0, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _ratio_axis(axes: Axes) -> None:
    axes.set(yscale="log", ylabel="error / VJM's error")
    low, high = axes.get_ylim()
    ticks = [tick for tick in TICKS if low <= tick <= high]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks([], minor=True)
    axes.axhline(1.0, color=REFERENCE_COLOR, linewidth=0.8, linestyle="--")
