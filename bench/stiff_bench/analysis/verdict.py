"""Is A better than B? `decide` is the one rule of compare, leaderboard and report.

What it decides on is made by `estimates`. How often it finds a winner between equal models is
counted in tests/protocols/scoring/test_false_positives.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.scoring.bootstrap import PoseErrors, resampled_means
from stiff_protocols.scoring.paired import (
    LEVEL,
    ROPE_M,
    Posterior,
    corrected_t,
    corrected_t_p_values,
    holm,
    wilcoxon_signed_rank,
)

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
    """What one test says about a difference of errors, A less B.

    Attributes:
        low, high: bounds of the difference, in its unit.
        p_value: of "there is no difference", two-sided.
        posterior: probabilities that A is better by more than the ROPE, that the difference lies
            in it, that B is better.
    """

    low: float
    high: float
    p_value: float
    posterior: Posterior

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval holds one sign only."""
        return self.low > 0.0 or self.high < 0.0


def decide(results: Sequence[Estimate], confidence: float) -> Verdict:
    """Return the verdict on a difference, A less B.

    Equivalent: every result gives the ROPE at least the probability `confidence` (0..1). Better:
    the first result's p-value lies below 1 - confidence, and no interval reaches zero.
    """
    if all(result.posterior.equivalent >= confidence for result in results):
        return "equivalent"
    if results[0].p_value >= 1.0 - confidence:
        return "open"
    if all(result.high < 0.0 for result in results):
        return "a"
    return "b" if all(result.low > 0.0 for result in results) else "open"


DISAGREEMENTS: dict[str, str] = {
    "": "",
    "splits": "The splits agree on it, but a few poses could turn it: measure more poses.",
    "poses": "The poses agree on it, but it changes from split to split: use more --splits.",
}


def disagreement(splits: Estimate, poses: Estimate) -> Literal["", "splits", "poses"]:
    """Return which of two intervals alone excludes zero; "" where both do or none does."""
    is_sure = [splits.excludes_zero, poses.excludes_zero]
    if is_sure == [True, False]:
        return "splits"
    return "poses" if is_sure == [False, True] else ""


def corrected(results: Sequence[Estimate]) -> list[Estimate]:
    """Return results whose p-values are corrected for one another (Holm)."""
    p_values = holm([result.p_value for result in results]).tolist()
    return [replace(result, p_value=p) for result, p in zip(results, p_values, strict=True)]


@dataclass(frozen=True, eq=False, repr=False)
class SharedErrors(BriefFields):
    """Errors on the same rows, in SI units; smaller is better.

    A column is a model, or one axis of a model.

    Attributes:
        of_splits: (J, m) on each split; None where there is one, or all are scored together.
        test_share: part of the data set (0..1) that a split tests on.
        of_poses: m columns on all poses of the data set, tested or not, so that whoever asks gets
            the same draws of them; None where the value is no mean over rows.
        seed: of the draws.
    """

    of_splits: FloatArray | None
    test_share: float
    of_poses: PoseErrors | None
    seed: int = 0

    @cached_property
    def drawn(self) -> FloatArray | None:
        """The (B, m) means on draws of the poses; NaN where a draw holds no tested pose."""
        return None if self.of_poses is None else resampled_means(self.of_poses, seed=self.seed)


def estimates(
    errors: SharedErrors,
    pairs: Sequence[tuple[int, int]],
    question: Question,
    *,
    all_p_values: bool = False,
) -> list[list[Estimate]]:
    """Return what each test that applies says of k pairs of columns, A and B, in tests of k.

    First the corrected t test over splits, where there are several; then, with the fitted models
    held fixed, the tested poses: Wilcoxon's p-value, percentiles of the draws, and as probabilities
    the shares of the draws. Wilcoxon's is NaN where the splits decide, because among thousands of
    pairs it would take longer than all the rest; with `all_p_values` it is there, too.
    """
    a, b = [one for one, _ in pairs], [other for _, other in pairs]
    found: list[list[Estimate]] = []
    if errors.of_splits is not None:
        differences = errors.of_splits[:, a] - errors.of_splits[:, b]  # (J, k)
        tests = [corrected_t(one, errors.test_share) for one in differences.T]
        found.append(
            [
                Estimate(*t.interval(question.confidence), t.p_value, t.posterior(question.rope))
                for t in tests
            ]
        )
    if errors.of_poses is not None and errors.drawn is not None:
        drawn = errors.drawn[np.isfinite(errors.drawn[:, 0])]  # a tested pose is in it
        needed = all_p_values or not found
        p_values = [
            wilcoxon_signed_rank(errors.of_poses.differences(i, j)) if needed else np.nan
            for i, j in pairs
        ]
        found.append(_over_poses(drawn[:, a] - drawn[:, b], p_values, question))
    return found


def _over_poses(drawn: FloatArray, p_values: Sequence[float], question: Question) -> list[Estimate]:
    """Return an estimate for each column of the (B, k) differences on the draws, m."""
    tail = 0.5 * (1.0 - question.confidence)
    low, high = np.quantile(drawn, [tail, 1.0 - tail], axis=0)  # (k,)
    a_better = np.mean(drawn < -question.rope, axis=0)
    b_better = np.mean(drawn > question.rope, axis=0)
    equivalent = np.maximum(0.0, 1.0 - a_better - b_better)
    return [
        Estimate(
            *(float(low[k]), float(high[k]), p_value),
            posterior=Posterior(float(a_better[k]), float(equivalent[k]), float(b_better[k])),
        )
        for k, p_value in enumerate(p_values)
    ]


def decide_pairs(
    errors: SharedErrors,
    pairs: Sequence[tuple[int, int]],
    question: Question,
    p_values: Sequence[float] | None = None,
) -> list[Verdict] | None:
    """Return the verdicts on k pairs; None where no test applies: one value, no poses behind it.

    `p_values` are k corrected ones of the first test; None: p is not corrected. The draws are not
    corrected: among many models Holm would ask for rarer events than they hold.
    """
    results = estimates(errors, pairs, question)
    if not results:
        return None
    if p_values is not None:
        first = zip(results[0], p_values, strict=True)
        results[0] = [replace(result, p_value=p_value) for result, p_value in first]
    return [decide(of_pair, question.confidence) for of_pair in zip(*results, strict=True)]


def corrected_p_values(errors: SharedErrors) -> FloatArray | None:
    """Return the (m, m) p-values of the first test, corrected for all pairs of m columns (Holm).

    None where no test applies.
    """
    if errors.of_splits is not None:
        a, b = upper = np.triu_indices(errors.of_splits.shape[1], k=1)
        differences = errors.of_splits[:, a] - errors.of_splits[:, b]
        p_values = corrected_t_p_values(differences, errors.test_share)
    elif (of_poses := errors.of_poses) is not None:
        upper = np.triu_indices(of_poses.totals.shape[1], k=1)
        pairs = zip(*(indices.tolist() for indices in upper), strict=True)
        p_values = np.array([wilcoxon_signed_rank(of_poses.differences(a, b)) for a, b in pairs])
    else:
        return None
    matrix = np.zeros((1 + upper[1].max(initial=0),) * 2)
    matrix[upper] = holm(p_values)
    return matrix + matrix.T
