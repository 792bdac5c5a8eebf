"""Critical-difference diagrams of a folder's results."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from stiff_bench.analysis.critical_difference import (
    HEAD_INCH,
    LINE_INCH,
    RankAnalysis,
    draw_diagram,
    n_lines,
    rank_analyses,
)
from stiff_bench.analysis.leaderboard import presentation, shown_contests
from stiff_bench.analysis.ranking import Rankings, scored_contest
from stiff_bench.analysis.same_robot import of_robots
from stiff_bench.analysis.sort_key import sort_key
from stiff_bench.figures.figure import Content
from stiff_bench.figures.source import FigureSource, marks_in
from stiff_bench.figures.style import PAGE_INCH, new_figure
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.extras import require
from stiff_protocols.scoring.paired import LEVEL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METRIC = "norm"
MOST = 3
"""Diagrams on one page."""
SCALE = 0.8
"""Of the distances that `critical_difference` has for larger type."""
TITLE_WIDTH = 90
"""Characters; centred, so that the names beside a diagram push none off the page."""


def ranks_figure(analyses: Sequence[RankAnalysis]) -> Figure:
    """Draw a diagram for each analysis, one beneath the other.

    Args:
        analyses: at least one; all with an outcome.
    """
    heights = [SCALE * (HEAD_INCH + LINE_INCH * n_lines(one)) for one in analyses]
    figure = new_figure(PAGE_INCH, sum(heights))
    panels = figure.subplots(len(analyses), 1, squeeze=False, height_ratios=heights)[:, 0]
    for axes, analysis in zip(panels, analyses, strict=True):
        draw_diagram(analysis, axes)
        axes.grid(visible=False)
        about = f"{analysis.text}: {of_robots(analysis.families)}"
        axes.set_title(textwrap.fill(about, TITLE_WIDTH, break_on_hyphens=False), loc="center")
    return figure


def gather(source: FigureSource) -> Content:
    """Rank the models over the robots of the folder.

    Raises:
        ConfigError: there are too few robots or models for a critical difference, or
            scikit-posthocs is not installed.
    """
    require("a diagram of ranks", "scikit_posthocs")
    key = sort_key(METRIC, None)
    shown = shown_contests(source.contests, source.models)
    scored = [scored_contest(contest, shown.models, key) for contest in shown.contests]
    fair = [one for one in scored if not presentation(one.contest).selects_on_test] or scored
    found = rank_analyses(fair, Rankings(key, source.folder, 0))
    ranked = [one for one in found if one.outcome is not None]
    if not ranked:
        reasons = "; ".join(dict.fromkeys(one.why_none for one in found))
        raise ConfigError(
            f"--results {source.folder}: there is no critical difference to draw: it {reasons}"
        )
    drawn = ranked[:MOST]
    shown_here = {name for one in drawn for name in one.models}
    more = f" First {MOST} of {len(ranked)} blocks; `bench leaderboard` has all."
    kinds = " and ".join(dict.fromkeys(presentation(one.contest).kind for one in fair))
    caption = (
        f"Mean ranks over robots of the mean error length ({key.text}), {kinds} data; left is "
        f"better. Models joined by a bar are not told apart (Nemenyi, {LEVEL:g})."
        f"{marks_in([one.contest for one in fair], shown_here)}{more * (len(ranked) > MOST)}"
    )
    return Content(caption, partial(ranks_figure, drawn))
