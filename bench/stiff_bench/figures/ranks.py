"""Critical-difference diagrams of a folder's results."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pandas import DataFrame, Series

from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.critical_difference import RankAnalysis, of_robots
from stiff_bench.analysis.leaderboard import build_leaderboard
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.figures.figure_source import FigureSource, marks_in
from stiff_bench.figures.prepared_figure import Prepared
from stiff_bench.figures.style import PAGE_INCH, new_figure
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.extras import require
from stiff_protocols.scoring.paired import LEVEL

METRIC = "norm"
MOST = 3
"""Diagrams on one page."""
LINE_INCH = 0.176  # of a label, or of a bar
HEAD_INCH = 1.12  # title, critical difference and axis of a diagram
CD_LINE = 2.0  # height of the critical difference above the axis, in lines
_LINE = "0.2"
TITLE_WIDTH = 90
"""Characters; centred, so that the names beside a diagram push none off the page."""


def ranks_figure(analyses: Sequence[RankAnalysis], measure: str = "") -> Figure:
    """Draw a diagram for each analysis, which has an outcome, one beneath the other.

    `measure` is what the ranks are of, on which kind of data; "" where a caption says it.
    """
    # beneath an axis are labels on two sides, and bars
    n_lines = [
        len(one.outcome.groups if one.outcome else ()) + (len(one.models) + 1) // 2
        for one in analyses
    ]
    heights = [HEAD_INCH + LINE_INCH * n for n in n_lines]
    figure = new_figure(PAGE_INCH, sum(heights))
    panels = figure.subplots(len(analyses), 1, squeeze=False, height_ratios=heights)[:, 0]
    for axes, analysis in zip(panels, analyses, strict=True):
        _draw(analysis, axes)
        axes.grid(visible=False)
        about = f"{analysis.text}: {of_robots(analysis.families)}"
        about += f", mean rank of {measure}" if measure else ""
        axes.set_title(textwrap.fill(about, TITLE_WIDTH, break_on_hyphens=False), loc="center")
    return figure


def _draw(analysis: RankAnalysis, ax: Axes) -> None:
    from scikit_posthocs import critical_difference_diagram

    outcome, names = analysis.outcome, list(analysis.models)
    if outcome is None:
        return
    p_values = np.where(analysis.apart, 0.0, 1.0)  # the bars show who is apart, no more
    drawn = critical_difference_diagram(
        Series(outcome.mean_ranks, index=names),
        DataFrame(p_values, index=names, columns=names),
        alpha=LEVEL,
        ax=ax,
        label_fmt_left="{label} ({rank:.2f})",
        label_fmt_right="({rank:.2f}) {label}",
        elbow_props={"color": _LINE, "linewidth": 0.8},
        marker_props={"color": _LINE, "s": 12.0},
        text_h_margin=0.02 * len(names),
    )
    for (bar,) in drawn["crossbars"]:  # through its models in the order of a set of names
        bar.set_xdata(sorted(bar.get_xdata()))
    start = float(outcome.mean_ranks.min())
    end = start + outcome.critical_difference
    ax.plot([start, end], [CD_LINE, CD_LINE], color="black", linewidth=2.0, marker="|")
    ax.text(end, CD_LINE, f"  critical difference {outcome.critical_difference:.2f}", va="center")


def _prepared(analyses: Sequence[RankAnalysis], measure: str = "", caption: str = "") -> Prepared:
    require("a diagram of ranks", "scikit_posthocs")
    paint = partial(ranks_figure, analyses, measure)
    return Prepared("Critical differences of mean ranks", caption, paint)


def save_diagrams(analyses: Sequence[RankAnalysis], measure: str, path: Path) -> None:
    """Draw all analyses of a section that have an outcome, one at least, as PNG, PDF or SVG.

    Raises:
        ConfigError: the suffix is not known, or scikit-posthocs is not installed.
        StoreError: the file cannot be written.
    """
    _prepared([one for one in analyses if one.outcome is not None], measure).save(path)


def gather(source: FigureSource) -> Prepared:
    """Show the critical differences of mean ranks over robots.

    Raises:
        ConfigError: there are too few robots or models for a critical difference, or
            scikit-posthocs is not installed.
    """
    key = sort_key(METRIC, None)
    stored = StoredResults(source.folder, source.cases)
    section = build_leaderboard(stored, models=source.models, key=key).sections[0]
    ranked = [one for one in section.analyses if one.outcome is not None]
    if not ranked:
        reasons = "; ".join(dict.fromkeys(one.why_none for one in section.analyses))
        raise ConfigError(
            f"{source.folder}: there is no critical difference to draw: it {reasons}", "results"
        )
    drawn = ranked[:MOST]
    shown_here = {name for one in drawn for name in one.models}
    more = f" First {MOST} of {len(ranked)} blocks; `bench leaderboard` has all."
    caption = (
        f"Mean ranks over robots by {key.text}, {' and '.join(section.kinds)} data; left is "
        f"better. Models joined by a bar do not differ significantly (Nemenyi, {LEVEL:g})."
        f"{marks_in([one.case for one in section.cases], shown_here)}{more * (len(ranked) > MOST)}"
    )
    return _prepared(drawn, caption=caption)
