"""Which models are better across data sets? Friedman, two post-hoc tests, critical difference.

Each data set gives each model one rank; no more than the order within a data set is used
(Demsar 2006, Statistical comparisons of classifiers over multiple data sets). The data sets must be
independent: specimens of a robot type are, splits of one data set share their samples and are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from stiff_protocols.errors import DataError
from stiff_protocols.paired import LEVEL
from stiff_protocols.types import FloatArray, frozen_array

FEWEST_DATASETS = 5
FEWEST_MODELS = 3


@dataclass(frozen=True, eq=False)
class OverDatasets:
    """Comparison of m models over several data sets.

    Attributes:
        mean_ranks: (m,) mean over the data sets; 1 is the smallest error, ties share their rank.
        friedman_p: p-value of "all models are equal".
        nemenyi: (m, m) p-values of each pair, corrected for all pairs; 1 on the diagonal.
        conover: (m, m) the same by Conover's test with Holm's correction: more powerful, less
            careful. None where all data sets agree on every rank: it measures by their
            disagreement, and without any it would be certain of every difference.
        critical_difference: two mean ranks that are at least so far apart differ at `LEVEL`.
        groups: each a largest set of two or more models, by their column and best first, none of
            which is so far from another; a model may belong to several.
    """

    mean_ranks: FloatArray
    friedman_p: float
    nemenyi: FloatArray
    conover: FloatArray | None
    critical_difference: float
    groups: list[tuple[int, ...]]


def why_not(n_datasets: int, n_models: int) -> str:
    """Return why so many data sets and models cannot be compared by ranks, "" where they can."""
    if n_datasets < FEWEST_DATASETS:
        verb = "is" if n_datasets == 1 else "are"
        return (
            f"needs at least {FEWEST_DATASETS} data sets of different robots, here {verb} "
            f"{n_datasets}: splits of one data set, and several data sets of one robot, do not "
            "count"
        )
    if n_models < FEWEST_MODELS:
        verb = "is" if n_models == 1 else "are"
        return f"needs at least {FEWEST_MODELS} models, here {verb} {n_models}"
    return ""


def compare_over_datasets(scores: ArrayLike) -> OverDatasets:
    """Return ranks and tests of m models over n data sets.

    Args:
        scores: (n, m) error of each model on each data set; smaller is better.

    Raises:
        DataError: there are too few data sets or models, or a score is missing or not finite.
    """
    values = frozen_array(scores, "scores", (None, None))  # (n, m)
    reason = why_not(*values.shape)
    if reason:
        raise DataError(f"the critical-difference analysis {reason}")
    ranks = stats.rankdata(values, axis=1)  # (n, m)
    mean_ranks = np.asarray(ranks.mean(axis=0))
    distance = critical_difference(*values.shape)
    return OverDatasets(
        mean_ranks=mean_ranks,
        friedman_p=_friedman(ranks),
        nemenyi=_nemenyi(ranks),
        conover=_conover(ranks),
        critical_difference=distance,
        groups=_groups(mean_ranks, distance),
    )


def critical_difference(n_datasets: int, n_models: int) -> float:
    """Return the Nemenyi critical difference of mean ranks at `LEVEL`.

    q sqrt(m (m + 1) / (6 n)), with q from the studentised range / sqrt 2 (Demsar 2006, section
    3.2.2).
    """
    q = float(stats.studentized_range.ppf(1.0 - LEVEL, n_models, np.inf)) / math.sqrt(2.0)
    return q * math.sqrt(n_models * (n_models + 1) / (6.0 * n_datasets))


def _friedman(ranks: FloatArray) -> float:
    if np.ptp(ranks) == 0.0:  # all models tie everywhere: the statistic is 0/0
        return 1.0
    return float(stats.friedmanchisquare(*ranks.T).pvalue)


def _nemenyi(ranks: FloatArray) -> FloatArray:
    import scikit_posthocs

    return np.array(scikit_posthocs.posthoc_nemenyi_friedman(ranks), dtype=np.float64)


def _conover(ranks: FloatArray) -> FloatArray | None:
    """Return Conover's p-values; None where the data sets agree and leave no residual."""
    import scikit_posthocs

    if (ranks == ranks[0]).all():
        return None
    return np.array(
        scikit_posthocs.posthoc_conover_friedman(ranks, p_adjust="holm"), dtype=np.float64
    )


def _groups(mean_ranks: FloatArray, distance: float) -> list[tuple[int, ...]]:
    """Return the runs of neighbouring mean ranks that span less than `distance`."""
    order = np.argsort(mean_ranks, kind="stable")
    ends = np.searchsorted(mean_ranks[order], mean_ranks[order] + distance, side="left")
    groups = []
    reached = 0
    for start, end in enumerate(ends.tolist()):
        if end > reached and end - start > 1:  # else the last group holds this one
            groups.append(tuple(order[start:end].tolist()))
        reached = max(reached, end)
    return groups
