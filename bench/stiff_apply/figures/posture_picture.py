"""Postures for a task: deflection over tool turn."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stiff_apply.posture_math import BRANCHES, RatedPosture
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import PAGE_INCH, REFERENCE_COLOR, looks, new_figure, share_legend
from stiff_bench.tables.units import MM

HEIGHT_INCH = 2.9
TICK_DEG, ROOM = 45.0, 1.4
"""Step of the ticks; end of the axis over the largest deflection."""
LINE_POINTS, MARK_POINTS = {"+": 3.2, "-": 1.3}, 8.0
MARKERS = {"best": "*", "given": "o"}


def posture_picture(
    title: str,
    words: str,
    table: pd.DataFrame,
    best: RatedPosture,
    given: RatedPosture | None,
) -> Prepared:
    """Return the figure of a ranking with its caption.

    Args:
        title: model, robot and task.
        words: part of the deflection, "along the axis".
        table: a row per posture, the best one first.
        best: posture of the first row.
        given: posture to compare with.
    """
    part = f"Predicted deflection {words} of the tool"
    marked = {"best": best} if given is None else {"best": best, "given": given}
    return Prepared(
        title="Postures for a task",
        caption=f"{part} over its turn, a line per branch of the arm. Gaps: beyond joint limits, "
        "out of reach or near a singularity. Vertical bars: intervals of the model.",
        paint=partial(_painted_turns, words, table, marked),
        subtitle=title,
    )


def _painted_turns(words: str, table: pd.DataFrame, marked: Mapping[str, RatedPosture]) -> Figure:
    size_column, every_turn = f"{words.split()[0]}_mm", table["turn_deg"]
    turns = np.sort(every_turn.unique())
    step = float(np.diff(turns).min()) if len(turns) > 1 else 360.0
    figure = new_figure(PAGE_INCH, HEIGHT_INCH)
    axes = figure.add_subplot()
    for branch, look in zip(BRANCHES, looks(len(BRANCHES)), strict=True):
        branch_rows = table[table["branch"] == branch].sort_values("turn_deg")
        if not len(branch_rows):
            continue
        turn, size = branch_rows["turn_deg"].to_numpy(), branch_rows[size_column].to_numpy()
        gaps = np.flatnonzero(np.diff(turn) > 1.5 * step) + 1
        turn, size = (np.insert(values.astype(float), gaps, np.nan) for values in (turn, size))
        width = LINE_POINTS[branch[-1]]  # wrist branches often have equal deflections
        axes.plot(turn, size, label=branch, linewidth=width, **look.connected())
    for name, posture in marked.items():
        half = None if posture.half_width is None else MM * posture.half_width.mean()
        axes.errorbar(
            posture.turn,
            MM * posture.size.mean(),
            half,
            marker=MARKERS[name],
            markersize=MARK_POINTS,
            markerfacecolor="white",
            markeredgecolor="black",
            ecolor=REFERENCE_COLOR,
            linestyle="none",
            zorder=4,
            label=name if half is None else f"{name}, +-{half:.2g} mm",
        )
    mean = "" if len(marked["best"].q) == 1 else "mean "
    axes.set(
        xlabel="turn about the axis of the tool [deg]",
        ylabel=f"{mean}deflection {words} [mm]",
        xlim=(-183.0, 183.0),
        xticks=np.arange(-180.0, 181.0, TICK_DEG),
    )
    sizes = [MM * posture.size.mean() for posture in marked.values()]
    largest = max(*table[size_column], *sizes, 1e-9)
    axes.set_ylim(0.0, ROOM * largest)  # wider intervals are cut
    share_legend(figure, [axes], ncols=6)
    return figure
