"""Decide whether model A is better than B: the rule of compare, leaderboard and report.

`decide` is the rule; its inputs come from `estimates`. The rate of wrong winners between equal
models is counted in tests/protocols/scoring/test_false_positives.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from stiff_protocols.contract.display import BriefFields
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
"""Better model; "open": no significant difference, which does not mean that they are equal."""


@dataclass(frozen=True)
class Question:
    """Settings of the tests on every pair.

    Attributes:
        rope: largest difference that is negligible in practice, m.
        confidence: confidence of intervals and verdicts (0..1).
        seed: seed of the resampling.
    """

    rope: float = ROPE_M
    confidence: float = 1.0 - LEVEL
    seed: int = 0


@dataclass(frozen=True)
class Estimate:
    """Result of one test on a difference of errors, A minus B.

    Attributes:
        low, high: bounds of the difference, in its unit.
        p_value: two-sided p-value of the hypothesis of equal errors.
        posterior: probabilities that A is better by more than the ROPE, that the difference is
            within the ROPE, and that B is better.
    """

    low: float
    high: float
    p_value: float
    posterior: Posterior


def decide(results: Sequence[Estimate], confidence: float) -> Verdict:
    """Return the verdict on a difference, A minus B.

    Equivalent: in every result the ROPE has at least the probability `confidence` (0..1). Better:
    the first result's p-value is below 1 - confidence, and all intervals exclude zero.
    """
    if all(result.posterior.equivalent >= confidence for result in results):
        return "equivalent"
    if results[0].p_value >= 1.0 - confidence:
        return "open"
    if all(result.high < 0.0 for result in results):
        return "a"
    return "b" if all(result.low > 0.0 for result in results) else "open"


@dataclass(frozen=True, eq=False, repr=False)
class SharedErrors(BriefFields):
    """Errors on the same rows, in SI units; smaller is better.

    A column is a model, or one axis of a model.

    Attributes:
        of_splits: (J, m) errors per split; None with one split, or if all are scored together.
        test_share: share of the data set (0..1) that a split tests on.
        of_poses: m columns on all poses of the data set, tested or not, so that all callers get the
            same draws; None if the value cannot be resampled as a mean over rows.
        seed: seed of the draws.
    """

    of_splits: FloatArray | None
    test_share: float
    of_poses: PoseErrors | None
    seed: int = 0

    @cached_property
    def drawn_means(self) -> FloatArray | None:
        """Return (B, m) means on draws of the poses; NaN for a draw without a tested pose."""
        return None if self.of_poses is None else resampled_means(self.of_poses, seed=self.seed)


def estimates(
    errors: SharedErrors,
    pairs: Sequence[tuple[int, int]],
    question: Question,
    *,
    all_p_values: bool = False,
) -> list[list[Estimate]]:
    """Return the estimates of each applicable test for k pairs of columns, A and B.

    With several splits the first test is the corrected t test over splits. The next test is over
    the tested poses, with the fitted models held fixed: Wilcoxon's p-value, percentiles of the
    draws, and shares of the draws as probabilities. Wilcoxon's p-value is NaN if there is a test
    over splits, because thousands of pairs would take too long. `all_p_values` computes it always.
    """
    results: list[list[Estimate]] = []
    if errors.of_splits is not None:
        of_splits = errors.of_splits
        columns = (of_splits[:, i] - of_splits[:, j] for i, j in pairs)
        tests = [corrected_t(column, errors.test_share) for column in columns]
        level, rope = question.confidence, question.rope
        results.append([Estimate(*t.interval(level), t.p_value, t.posterior(rope)) for t in tests])
    if errors.of_poses is not None and errors.drawn_means is not None:
        drawn = errors.drawn_means[np.isfinite(errors.drawn_means[:, 0])]  # with a tested pose
        a, b = np.asarray(pairs, dtype=int).reshape(-1, 2).T
        differences = drawn[:, a] - drawn[:, b]  # (B, k)
        tail = 0.5 * (1.0 - question.confidence)
        intervals = np.quantile(differences, [tail, 1.0 - tail], axis=0).T.tolist()
        a_better = np.mean(differences < -question.rope, axis=0)
        b_better = np.mean(differences > question.rope, axis=0)
        equivalent = np.maximum(0.0, 1.0 - a_better - b_better)
        posteriors = np.column_stack([a_better, equivalent, b_better]).tolist()
        needed = all_p_values or not results
        p_values = [
            wilcoxon_signed_rank(errors.of_poses.differences(i, j)) if needed else np.nan
            for i, j in pairs
        ]
        results.append(
            [
                Estimate(bounds[0], bounds[1], p_value, Posterior(*chances))
                for bounds, p_value, chances in zip(intervals, p_values, posteriors, strict=True)
            ]
        )
    return results


def decide_pairs(
    errors: SharedErrors,
    pairs: Sequence[tuple[int, int]],
    question: Question,
    p_values: Sequence[float] | None = None,
) -> list[Verdict] | None:
    """Return the verdicts on k pairs; None: no test applies (one value, no poses).

    `p_values` are k corrected p-values of the first test; None: no correction. The draws are not
    corrected: for many models Holm would need rarer events than the draws contain.
    """
    results = estimates(errors, pairs, question)
    if not results:
        return None
    if p_values is not None:
        first = zip(results[0], p_values, strict=True)
        results[0] = [replace(result, p_value=p_value) for result, p_value in first]
    return [decide(of_pair, question.confidence) for of_pair in zip(*results, strict=True)]


def corrected_p_values(errors: SharedErrors) -> FloatArray | None:
    """Return (m, m) p-values of the first test, corrected for all pairs (Holm).

    None: no test applies.
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
