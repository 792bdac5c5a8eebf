"""Which models are better across data sets? Friedman, two post-hoc tests, critical difference.

Each data set gives each model one rank; no more than the order within a data set is used
(Demsar 2006, Statistical comparisons of classifiers over multiple data sets). The data sets must be
independent: specimens of a robot type are, splits of one data set share their samples and are not.

The tests stand here in a few lines each. scipy.stats and scikit-posthocs have them too, but every
leaderboard of five robots computes them: importing scipy.stats would add 0.8 s, scikit-posthocs
(pandas, matplotlib) 1.2 s more, to the 1 s of a leaderboard of 100,000 values
(results/performance.md) and to the 3.1 s of one of a million, which is to take 3 s
(docs/performance.md). The tests compare with theirs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, frozen_array
from stiff_protocols.scoring.paired import LEVEL, holm, ranked

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

    `scores` are (n, m) errors; smaller is better.

    Raises:
        DataError: there are too few data sets or models, or a score is missing or not finite.
    """
    values = frozen_array(scores, "scores", (None, None))  # (n, m)
    reason = why_not(*values.shape)
    if reason:
        raise DataError(f"the critical-difference analysis {reason}")
    ranks = ranked(values)  # (n, m)
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
    return _critical_range(n_models) * _rank_scale(n_datasets, n_models)


def _rank_scale(n_datasets: int, n_models: int) -> float:
    """The standard deviation of a mean rank, which the studentised range is in units of."""
    return math.sqrt(n_models * (n_models + 1) / (12.0 * n_datasets))


@lru_cache
def _critical_range(n_models: int) -> float:
    """Return the studentised range whose probability is `LEVEL`, by bisection."""
    low, high = 0.0, 100.0
    while (middle := 0.5 * (low + high)) not in (low, high):
        if _range_probability(np.array([middle]), n_models)[0] > LEVEL:
            low = middle
        else:
            high = middle
    return high


def _range_probability(size: FloatArray, n_models: int) -> FloatArray:
    """Return the (k,) probabilities that m standard normal numbers span more than (k,) sizes.

    It is 1 - m times the integral of phi(z) (Phi(z) - Phi(z - size))^(m - 1) over the largest of
    them, z. The trapezoidal rule is exact to rounding where smooth tails are cut off this far out.
    """
    z = np.linspace(-9.0, 9.0, 361)
    density = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    below = special.ndtr(z) - special.ndtr(z - size[:, None])  # (k, 361)
    inside = n_models * (z[1] - z[0]) * (density * below ** (n_models - 1)).sum(axis=1)
    return np.asarray(np.clip(1.0 - inside, 0.0, 1.0))


def _friedman(ranks: FloatArray) -> float:
    """The p-value of Friedman's test, with the correction for ties."""
    n, m = ranks.shape
    spread = float(((ranks - 0.5 * (m + 1)) ** 2).sum())
    if spread == 0.0:  # all models tie everywhere: the statistic is 0/0
        return 1.0
    between = float(((ranks.mean(axis=0) - 0.5 * (m + 1)) ** 2).sum())
    return float(special.chdtrc(m - 1, n**2 * (m - 1) * between / spread))


def _nemenyi(ranks: FloatArray) -> FloatArray:
    """The p-values of the pairs, from the studentised range (Demsar 2006)."""
    n, m = ranks.shape
    first, second = np.triu_indices(m, 1)
    apart = np.abs(ranks.sum(axis=0)[first] - ranks.sum(axis=0)[second]) / n
    return _of_pairs(_range_probability(apart / _rank_scale(n, m), m), m)


def _conover(ranks: FloatArray) -> FloatArray | None:
    """Return Conover's p-values; None where the data sets agree and leave no residual.

    Conover 1999, Practical Nonparametric Statistics, section 5.8, with Holm's correction.
    """
    if (ranks == ranks[0]).all():
        return None
    n, m = ranks.shape
    sums = ranks.sum(axis=0)
    df = (n - 1) * (m - 1)
    residual = n * float((ranks**2).sum()) - float((sums**2).sum())
    first, second = np.triu_indices(m, 1)
    t_values = np.abs(sums[first] - sums[second]) / math.sqrt(2.0 * residual / df)
    return _of_pairs(holm(2.0 * special.stdtr(df, -t_values)), m)


def _of_pairs(p_values: FloatArray, n_models: int) -> FloatArray:
    matrix = np.eye(n_models)
    matrix[np.triu_indices(n_models, 1)] = p_values
    return np.maximum(matrix, matrix.T)


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
