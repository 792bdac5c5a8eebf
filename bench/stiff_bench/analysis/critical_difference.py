"""Friedman and post-hoc tests over the robots of a leaderboard.

A block is one protocol and condition. A robot counts once in it: other loads, sensors, noise and
seeds of splits repeat the same robot, and a model's scores on its data sets are averaged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.analysis.ranking import Rankings, ScoredContest, complete_models
from stiff_bench.analysis.same_robot import Specimen, family_of, of_robots, robots_of
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.analysis.verdict import decide, rank_difference
from stiff_bench.store.names import ContestName, grouped
from stiff_bench.tables.picture_file import check_suffix, drawing, save_figure
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.paired import LEVEL
from stiff_protocols.scoring.ranks import OverDatasets, compare_over_datasets, why_not

if TYPE_CHECKING:
    from matplotlib.axes import Axes


NOT_OF_COSTS = "does not apply to costs"


@dataclass(frozen=True, eq=False)
class RankAnalysis:
    """The comparison of models over the robots of a block, or why there is none.

    Attributes:
        protocol, condition: of the block; both "" for all protocols together, where a model's
            score on a robot is its mean rank over the contests there.
        families: robot that counts -> its data sets' names, without the options that make another
            robot of its type.
        models: with results on all of them, in the order of the outcome's columns.
        outcome: None where there is none.
        why_none: "" where there is an outcome.
    """

    protocol: str
    condition: str
    families: Mapping[Specimen, tuple[str, ...]]
    models: tuple[str, ...]
    outcome: OverDatasets | None
    why_none: str

    @property
    def robots(self) -> tuple[Specimen, ...]:
        """The robots that count."""
        return tuple(self.families)

    @property
    def text(self) -> str:
        """Protocol and condition for people."""
        block = " | ".join(filter(None, (self.protocol, self.condition)))
        return block or "all protocols together"

    @property
    def differs(self) -> bool:
        """Whether the Friedman test finds that the models differ; else no pair is looked at."""
        return self.outcome is not None and self.outcome.friedman_p < LEVEL

    def like_best(self, model: str) -> bool | None:
        """Say whether a model is not found worse than the best; None where there is no analysis."""
        if self.outcome is None:
            return None
        best = int(self.outcome.mean_ranks.argmin())
        difference = rank_difference(self.outcome, best, self.models.index(model))
        return decide([difference], 1.0 - LEVEL).verdict != "a"


def rank_analyses(scored: Sequence[ScoredContest], rankings: Rankings) -> list[RankAnalysis]:
    """Return an analysis for each block; where there are several, the one over all comes first."""
    robots = robots_of([one.contest for one in scored], rankings.robot_name)
    blocks = grouped(scored, lambda one: (one.name.protocol, one.name.condition))
    found = [_of_block(*block, members, robots, rankings) for block, members in blocks.items()]
    return found if len(found) == 1 else [_of_all(scored, robots, rankings), *found]


def _of_block(
    protocol: str,
    condition: str,
    scored: Sequence[ScoredContest],
    robots: Mapping[ContestName, Specimen],
    rankings: Rankings,
) -> RankAnalysis:
    models = complete_models(scored)
    sign = rankings.key.sign
    scores = {one.name: np.array([sign * one.mean(model) for model in models]) for one in scored}
    return _analysis(protocol, condition, models, scores, robots, rankings.key)


def _of_all(
    scored: Sequence[ScoredContest], robots: Mapping[ContestName, Specimen], rankings: Rankings
) -> RankAnalysis:
    models = complete_models(scored)
    scores = {one.name: rankings.of(one, models).ranks for one in scored}
    return _analysis("", "", models, scores, robots, rankings.key)


def _analysis(
    protocol: str,
    condition: str,
    models: tuple[str, ...],
    scores: Mapping[ContestName, FloatArray],
    robots: Mapping[ContestName, Specimen],
    key: SortKey,
) -> RankAnalysis:
    """Return the analysis of the (m,) scores in each contest, averaged over those of one robot."""
    of_robots = grouped(scores, lambda name: robots[name])
    why_none = NOT_OF_COSTS if key.is_cost else why_not(len(of_robots), len(models))
    outcome = None
    if not why_none:
        outcome = compare_over_datasets(
            [np.mean([scores[name] for name in names], axis=0) for names in of_robots.values()]
        )
    families = {
        robot: tuple(dict.fromkeys(family_of(name) for name in names))
        for robot, names in of_robots.items()
    }
    return RankAnalysis(protocol, condition, families, models, outcome, why_none)


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
        ConfigError: no analysis has an outcome, the suffix is not known, or scikit-posthocs is
            not installed.
        StoreError: the file cannot be written.
    """
    check_suffix(path)
    drawn = [analysis for analysis in analyses if analysis.outcome is not None]
    if not drawn:
        reasons = "; ".join(dict.fromkeys(analysis.why_none for analysis in analyses))
        raise ConfigError(f"--figure {path}: there is no critical difference to draw: it {reasons}")
    require("a diagram of ranks", "scikit_posthocs")
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
