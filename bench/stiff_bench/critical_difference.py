"""Critical-difference diagrams: mean ranks on a line, bars over models that are not told apart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.picture_file import check_suffix, drawing, save_figure
from stiff_bench.rank_analysis import RankAnalysis
from stiff_bench.same_robot import of_robots
from stiff_protocols.errors import ConfigError
from stiff_protocols.paired import LEVEL

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_INCH = 9.0
LINE_INCH = 0.22  # of a label, or of a bar
GAP_INCH = 0.12  # above and beneath a diagram
HEAD_INCH = 1.4  # title, critical difference and axis of a diagram
LEGEND_INCH = 0.35
CD_LINE = 2.0  # height of the critical difference above the axis, in lines
_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "stiffbench",
    "text.parse_math": False,  # a model may have "$" in its name
}
_LINE = "0.2"


def save_diagrams(
    analyses: Sequence[RankAnalysis], measure: str, kinds: Sequence[str], path: Path
) -> None:
    """Draw a diagram for each analysis that has an outcome, one beneath the other.

    Args:
        analyses: of a leaderboard.
        measure: what was ranked by, for the titles.
        kinds: of the data, e.g. ("simulated",).
        path: the file; its suffix chooses PNG, PDF or SVG.

    Raises:
        ConfigError: no analysis has an outcome, or the suffix is not known.
        StoreError: the file cannot be written.
    """
    check_suffix(path)
    drawn = [analysis for analysis in analyses if analysis.outcome is not None]
    if not drawn:
        reasons = "; ".join(dict.fromkeys(analysis.why_none for analysis in analyses))
        raise ConfigError(f"--figure {path}: there is no critical difference to draw: it {reasons}")
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    heights = [HEAD_INCH + LINE_INCH * n_lines(analysis) for analysis in drawn]
    with drawing(_STYLE):
        layout = ConstrainedLayoutEngine(h_pad=GAP_INCH)
        figure = Figure(figsize=(WIDTH_INCH, sum(heights) + LEGEND_INCH), layout=layout)
        axes = figure.subplots(len(drawn), 1, squeeze=False, height_ratios=heights)[:, 0]
        for analysis, ax in zip(drawn, axes, strict=True):
            draw_diagram(analysis, ax)
            ax.set_title(
                f"{analysis.text} | mean rank of {measure} | "
                f"{of_robots(analysis.families)} ({' and '.join(kinds)})"
            )
        figure.supxlabel(
            f"models joined by a bar are not told apart (Nemenyi, {LEVEL:g}); left is better",
            fontsize=_STYLE["font.size"],
        )
        save_figure(figure, path)


def n_lines(analysis: RankAnalysis) -> int:
    """Return how many lines of labels and bars a diagram has beneath its axis."""
    n_bars = 0 if analysis.outcome is None else len(analysis.outcome.groups)
    return n_bars + (len(analysis.models) + 1) // 2


def draw_diagram(analysis: RankAnalysis, ax: Axes) -> None:
    """Draw an analysis that has an outcome on axes of its own."""
    from pandas import DataFrame, Series
    from scikit_posthocs import critical_difference_diagram

    outcome, names = analysis.outcome, list(analysis.models)
    if outcome is None:
        return
    p_values = outcome.nemenyi if analysis.differs else np.ones_like(outcome.nemenyi)
    critical_difference_diagram(
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
    start = float(outcome.mean_ranks.min())
    end = start + outcome.critical_difference
    ax.plot([start, end], [CD_LINE, CD_LINE], color="black", linewidth=2.0, marker="|")
    ax.text(end, CD_LINE, f"  critical difference {outcome.critical_difference:.2f}", va="center")
