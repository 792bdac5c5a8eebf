"""How sure is a difference of mean errors, and who is better?

Two things are uncertain: another training set would give other models, and other poses would give
other errors. Repeated splits show the first (corrected t test), the bootstrap over poses the
second. A verdict needs all that the results allow. A single split, and a protocol that scores all
poses together, allow the poses alone: what they say holds for these fits, not for the learners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiff_protocols.bootstrap import (
    PoseErrors,
    bootstrap_difference,
    pose_differences,
    resampled_means,
)
from stiff_protocols.paired import (
    LEVEL,
    ROPE_M,
    Posterior,
    corrected_t,
    holm,
    wilcoxon_signed_rank,
)
from stiff_protocols.types import AXES, FloatArray

Verdict = Literal["a", "b", "equivalent", "open"]
"""Who is better; "open": they cannot be told apart, which does not mean that they are equal."""


@dataclass(frozen=True)
class Question:
    """What is asked of every contest.

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
    """What one method says about a difference of mean errors, A less B.

    Attributes:
        low, high: bounds, m.
        posterior: probabilities that A is better by more than the ROPE, that the difference lies
            in it, that B is better.
        p_value: of "there is no difference", two-sided.
    """

    low: float
    high: float
    posterior: Posterior
    p_value: float


def decide(estimates: Sequence[Estimate], confidence: float) -> Verdict:
    """Return the verdict on a difference of mean errors, A less B.

    Equivalent: every estimate gives the ROPE at least the probability `confidence`. Better: the
    first estimate's p-value lies below 1 - confidence, and no interval reaches zero.
    """
    if all(estimate.posterior.equivalent >= confidence for estimate in estimates):
        return "equivalent"
    if estimates[0].p_value >= 1.0 - confidence:
        return "open"
    if all(estimate.high < 0.0 for estimate in estimates):
        return "a"
    return "b" if all(estimate.low > 0.0 for estimate in estimates) else "open"


def estimates_over_poses(a: PoseErrors, b: PoseErrors, question: Question) -> list[Estimate]:
    """Return an estimate for each column of the errors, the fitted models held fixed.

    The interval is the BCa bootstrap's over poses, the probabilities are shares of the resamples,
    and the p-value, not corrected, is Wilcoxon's over the poses' mean differences.

    Raises:
        DataError: there is one pose alone.
    """
    found = bootstrap_difference(a, b, confidence=question.confidence, seed=question.seed)
    each = pose_differences(a, b)  # (p, k) m
    estimates = []
    for column in range(each.shape[1]):
        pair = [PoseErrors(one.poses, one.totals[:, [column]], one.counts) for one in (a, b)]
        drawn = resampled_means(pair, seed=question.seed)
        difference = drawn[:, 0] - drawn[:, 1]
        a_better = float(np.mean(difference < -question.rope))
        b_better = float(np.mean(difference > question.rope))
        estimates.append(
            Estimate(
                low=float(found.low[column]),
                high=float(found.high[column]),
                posterior=Posterior(a_better, max(0.0, 1.0 - a_better - b_better), b_better),
                p_value=wilcoxon_signed_rank(each[:, column]),
            )
        )
    return estimates


def estimates_over_splits(
    differences: FloatArray, test_share: float, question: Question
) -> list[Estimate]:
    """Return an estimate for each column of the (J, k) differences of the splits, m."""
    estimates = []
    for column in differences.T:
        found = corrected_t(column, test_share)
        low, high = found.interval(question.confidence)
        estimates.append(Estimate(low, high, found.posterior(question.rope), found.p_value))
    return estimates


def corrected_over_axes(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Correct the axes' p-values for one another (Holm); the length is a question of its own."""
    of_axes = holm([estimate.p_value for estimate in estimates[: len(AXES)]])
    p_values = [*of_axes.tolist(), estimates[-1].p_value]
    return [
        replace(estimate, p_value=p_value)
        for estimate, p_value in zip(estimates, p_values, strict=True)
    ]
