"""The table of the critical-difference analyses of a leaderboard."""

from __future__ import annotations

import numpy as np

from stiff_bench.leaderboard import Section
from stiff_bench.rank_analysis import RankAnalysis
from stiff_bench.render import TextTable
from stiff_bench.same_robot import of_robots
from stiff_bench.sort_key import SortKey
from stiff_protocols.paired import LEVEL


def analyses_table(section: Section, key: SortKey) -> TextTable:
    """Return a row for each analysis of a section that has an outcome."""
    found = [analysis for analysis in section.analyses if analysis.outcome is not None]
    types = {robot.type for analysis in found for robot in analysis.robots}
    notes = [
        'Friedman: p-value of "all models are equal". CD: mean ranks over robots that are at '
        f"least so far apart differ (Nemenyi, level {LEVEL:g}). Pairs: told apart by Nemenyi's and "
        "by Conover's test (Holm). Groups: models that are not told apart. A robot counts once: "
        "scores on several data sets of it (loads, sensors, seeds) are averaged.",
    ]
    if len(types) == 1:
        notes.append(
            f"all robots are of one type ({types.pop()}, "
            f"{' and '.join(section.kinds)}): what holds for its specimens need not hold for "
            "another robot."
        )
    if len(found) > 1:
        notes.append(
            "all protocols together: the score of a model on a robot is its mean rank over the "
            "contests there."
        )
    agreeing = [len(analysis.robots) for analysis in found if _robots_agree(analysis)]
    if agreeing:
        notes.append(
            "Conover: - where all robots agree on every rank. Without any disagreement to measure "
            f"by it would be certain of every difference; {min(agreeing)} robots that agree have "
            f"an exact two-sided p of {2.0 * 0.5 ** min(agreeing):.3g} for a pair."
        )
    return TextTable(
        title=f"Critical difference over robots | {key.text}",
        header=(
            "protocol, condition",
            "robots",
            "models",
            "Friedman p",
            "CD",
            "pairs: Nemenyi",
            "pairs: Conover",
            "groups, best first",
        ),
        rows=[_analysis_cells(analysis) for analysis in found],
        notes=[*notes, *section.caveats],
    )


def _robots_agree(analysis: RankAnalysis) -> bool:
    return analysis.differs and analysis.outcome is not None and analysis.outcome.conover is None


def _analysis_cells(analysis: RankAnalysis) -> list[str]:
    outcome = analysis.outcome
    assert outcome is not None
    upper = np.triu_indices(len(analysis.models), k=1)
    told = [
        "-"
        if p is None or not analysis.differs
        else f"{(p[upper] < LEVEL).sum()} of {len(p[upper])}"
        for p in (outcome.nemenyi, outcome.conover)
    ]
    groups = [f"{{{', '.join(analysis.models[i] for i in group)}}}" for group in outcome.groups]
    return [
        analysis.text,
        of_robots(analysis.families),
        str(len(analysis.models)),
        f"{outcome.friedman_p:.2g}",
        f"{outcome.critical_difference:.2f}",
        *told,
        (", ".join(groups) or "none") if analysis.differs else "all (Friedman)",
    ]
