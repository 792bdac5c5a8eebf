"""Is A better than B? `decide` is the one rule of compare, leaderboard, report and CD diagrams.

How often it finds a winner between equal models is counted in
tests/protocols/scoring/test_false_positives.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.bootstrap import (
    PoseErrors,
    bootstrap_difference,
    pose_differences,
    resampled_means,
)
from stiff_protocols.scoring.paired import (
    LEVEL,
    ROPE_M,
    Posterior,
    corrected_t,
    holm,
    wilcoxon_signed_rank,
)
from stiff_protocols.scoring.ranks import OverDatasets

Verdict = Literal["a", "b", "equivalent", "open"]
"""Who is better; "open": they cannot be told apart, which does not mean that they are equal."""


@dataclass(frozen=True)
class Question:
    """What is asked of every pair.

    Attributes:
        rope: largest difference that makes none in practice, m.
        confidence: of intervals and verdicts.
        seed: of the resampling.
    """

    rope: float = ROPE_M
    confidence: float = 1.0 - LEVEL
    seed: int = 0


@dataclass(frozen=True)
class Estimate:
    """What one test says about a difference of errors, or of mean ranks, A less B.

    Attributes:
        low, high: bounds of the difference, in its unit.
        p_value: of "there is no difference", two-sided.
        posterior: probabilities that A is better by more than the ROPE, that the difference lies
            in it, that B is better; all 0 of mean ranks, which know no such region.
    """

    low: float
    high: float
    p_value: float
    posterior: Posterior


def decide(results: Sequence[Estimate], confidence: float) -> Verdict:
    """Return the verdict on a difference, A less B.

    Equivalent: every result gives the ROPE at least the probability `confidence`. Better: the
    first result's p-value lies below 1 - confidence, and no interval reaches zero.

    Args:
        results: at least one, on the same difference.
        confidence: that a verdict needs (0..1).
    """
    if all(result.posterior.equivalent >= confidence for result in results):
        return "equivalent"
    if results[0].p_value >= 1.0 - confidence:
        return "open"
    if all(result.high < 0.0 for result in results):
        return "a"
    return "b" if all(result.low > 0.0 for result in results) else "open"


def corrected(results: Sequence[Estimate]) -> list[Estimate]:
    """Return results whose p-values are corrected for one another (Holm)."""
    p_values = holm([result.p_value for result in results]).tolist()
    return [replace(result, p_value=p) for result, p in zip(results, p_values, strict=True)]


def estimates_over_splits(
    differences: FloatArray, test_share: float, question: Question
) -> list[Estimate]:
    """Return an estimate for each column of the (J, k) differences of the splits, m."""
    estimates = []
    for column in differences.T:
        found = corrected_t(column, test_share)
        interval, posterior = found.interval(question.confidence), found.posterior(question.rope)
        estimates.append(Estimate(*interval, found.p_value, posterior))
    return estimates


def estimates_over_poses(a: PoseErrors, b: PoseErrors, question: Question) -> list[Estimate]:
    """Return an estimate for each column of the errors, the fitted models held fixed.

    The interval is the BCa bootstrap's over poses, the probabilities are shares of the resamples,
    and the p-value, not corrected, is Wilcoxon's over the poses' mean differences.

    Raises:
        DataError: there is one pose alone.
    """
    bounds = bootstrap_difference(a, b, confidence=question.confidence, seed=question.seed)
    of_poses = pose_differences(a, b)  # (p, k) m
    estimates = []
    for column in range(of_poses.shape[1]):
        pair = [PoseErrors(one.poses, one.totals[:, [column]], one.counts) for one in (a, b)]
        drawn = resampled_means(pair, seed=question.seed)
        p_value = wilcoxon_signed_rank(of_poses[:, column])
        (estimate,) = estimates_over_draws(drawn[:, [0]] - drawn[:, [1]], [p_value], question)
        low, high = float(bounds.low[column]), float(bounds.high[column])
        estimates.append(replace(estimate, low=low, high=high))
    return estimates


def estimates_over_draws(
    drawn: FloatArray, p_values: Sequence[float], question: Question
) -> list[Estimate]:
    """Return an estimate for each pair of models that share the draws of their poses.

    `drawn` are the (B, k) differences of the mean errors on each draw, m, `p_values` the k of
    Wilcoxon's test over the poses. The interval is the percentiles of the draws: BCa's takes 20 ms.
    """
    tail = 0.5 * (1.0 - question.confidence)
    low, high = np.quantile(drawn, [tail, 1.0 - tail], axis=0)  # (k,)
    a_better = np.mean(drawn < -question.rope, axis=0)
    b_better = np.mean(drawn > question.rope, axis=0)
    equivalent = np.maximum(0.0, 1.0 - a_better - b_better)
    return [
        Estimate(
            low=float(low[k]),
            high=float(high[k]),
            p_value=p_value,
            posterior=Posterior(float(a_better[k]), float(equivalent[k]), float(b_better[k])),
        )
        for k, p_value in enumerate(p_values)
    ]


def rank_difference(outcome: OverDatasets, a: int, b: int) -> Estimate:
    """Return what Nemenyi's test says about the mean ranks of two columns of an outcome.

    It looks at pairs only where Friedman's test finds that the models differ: p is the larger one.
    """
    difference = float(outcome.mean_ranks[a] - outcome.mean_ranks[b])
    reach = outcome.critical_difference
    p_value = max(outcome.friedman_p, float(outcome.nemenyi[a, b]))
    nothing = Posterior(0.0, 0.0, 0.0)
    return Estimate(difference - reach, difference + reach, p_value, nothing)


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """Errors of m models that were tested on the same rows, in SI units; smaller is better.

    Attributes:
        of_splits: (J, m) on each split; None where there is one, or all are scored together.
        test_share: part of the data set (0..1) that a split tests on.
        of_poses: of each model, in one column; None where the value is no mean over rows.
        drawn: (B, m) on draws of the poses, NaN where a draw holds no tested pose; None likewise.
    """

    of_splits: FloatArray | None
    test_share: float
    of_poses: Sequence[PoseErrors] | None
    drawn: FloatArray | None


def decide_pairs(
    errors: SharedErrors, pairs: Sequence[tuple[int, int]], question: Question, *, correct: bool
) -> list[Verdict] | None:
    """Return the verdicts on k pairs; None where no test applies: one value, no poses behind it.

    A winner needs the corrected t over splits, or Wilcoxon's test over poses where there are no
    splits, and that the draws of the poses agree. `pairs` are columns of A and of B. Where asked
    to, the p-values are corrected for the other pairs (Holm); the draws are not: among many models
    Holm would ask for rarer events than they hold.
    """
    a, b = [one for one, _ in pairs], [other for _, other in pairs]
    results: list[list[Estimate]] = []
    if errors.of_splits is not None:
        differences = errors.of_splits[:, a] - errors.of_splits[:, b]  # (J, k)
        results.append(estimates_over_splits(differences, errors.test_share, question))
        p_values = [estimate.p_value for estimate in results[0]]
    elif errors.of_poses is not None:
        p_values = [_signed_rank(errors.of_poses[i], errors.of_poses[j]) for i, j in pairs]
    else:
        return None
    if errors.drawn is not None:
        drawn = errors.drawn[np.isfinite(errors.drawn[:, 0])]  # a tested pose is in it
        results.append(estimates_over_draws(drawn[:, a] - drawn[:, b], p_values, question))
    if correct:
        results[0] = corrected(results[0])
    return [decide(of_pair, question.confidence) for of_pair in zip(*results, strict=True)]


def _signed_rank(a: PoseErrors, b: PoseErrors) -> float:
    """Return the p-value of Wilcoxon's test over the poses that were tested."""
    tested = a.counts > 0
    return wilcoxon_signed_rank((a.totals - b.totals)[tested, 0] / a.counts[tested])
