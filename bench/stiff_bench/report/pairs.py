"""Every pair of models in every contest: the verdicts of `bench compare`, at a bounded cost.

The same tests on the same splits and poses. One thing is quicker: the interval over poses is the
percentile interval of the draws that also give the probabilities, drawn once for all models of a
contest, where `bench compare` computes a BCa interval for each pair.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from stiff_bench.collected import Contest
from stiff_bench.contest_choice import presentation
from stiff_bench.contest_name import ContestName
from stiff_bench.estimates import (
    Estimate,
    Question,
    Verdict,
    decide,
    estimates_over_splits,
)
from stiff_bench.grouped import grouped
from stiff_bench.newest import Slot
from stiff_bench.split_sizes import split_sizes
from stiff_bench.stored_data import StoredData
from stiff_protocols.bootstrap import PoseErrors, pose_differences, pose_errors, resampled_means
from stiff_protocols.metrics import norm_errors
from stiff_protocols.paired import Posterior, wilcoxon_signed_rank
from stiff_protocols.record import CellResult
from stiff_protocols.types import FloatArray


@dataclass(frozen=True)
class Pair:
    """Two models in one contest, by the mean length of the error.

    Attributes:
        name: of the contest.
        a, b: names.
        n_splits: that both have.
        difference: mean error of A less that of B, m.
        p_value: over splits where there are several, else over poses.
        verdict: of all estimates together.
        of_fits: the verdict is of the fitted models alone: one split, or all scored together.
    """

    name: ContestName
    a: str
    b: str
    n_splits: int
    difference: float
    p_value: float
    verdict: Verdict
    of_fits: bool


def n_pairs(contest: Contest, models: Sequence[str]) -> int:
    """Return how many pairs of these models have results in a contest."""
    present = sum(1 for name in models if name in contest.competitors)
    return present * (present - 1) // 2


def compared_pairs(
    contest: Contest, models: Sequence[str], data: StoredData, question: Question
) -> Iterator[Pair]:
    """Yield all pairs of these models that share a split and at least two poses of a contest."""
    present = [name for name in models if name in contest.competitors]
    pairs = [
        (a, b, slots)
        for a, b in combinations(present, 2)
        if (slots := tuple(contest.shared_slots([a, b])))
    ]
    for slots, of_slots in grouped(pairs, lambda pair: pair[2]).items():
        together = [(a, b) for a, b, _ in of_slots]
        yield from _of_slots(contest, together, slots, data, question)


@dataclass(frozen=True)
class _Errors:
    """A model's errors on the shared splits: by split, (J,) m, and by pose."""

    of_splits: FloatArray
    of_poses: PoseErrors


def _of_slots(
    contest: Contest,
    pairs: Sequence[tuple[str, str]],
    slots: Sequence[Slot],
    data: StoredData,
    question: Question,
) -> Iterator[Pair]:
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    errors = {name: _errors(contest.results(name, slots), data) for name in names}
    if len(errors[names[0]].of_poses.poses) < 2:
        return
    drawn = resampled_means([errors[name].of_poses for name in names], seed=question.seed)
    column = {name: number for number, name in enumerate(names)}
    a, b = ([column[pair[side]] for pair in pairs] for side in (0, 1))
    low, high, posteriors = _of_draws(drawn[:, a] - drawn[:, b], question)
    over_splits: Sequence[Estimate | None] = [None] * len(pairs)
    by_split = len(slots) > 1 and not presentation(contest).pooled
    if by_split:
        share = split_sizes(contest.results(names[0], slots), len(data.samples)).test_share
        columns = [errors[a].of_splits - errors[b].of_splits for a, b in pairs]
        over_splits = estimates_over_splits(np.column_stack(columns), share, question)
    for number, ((one, other), splits) in enumerate(zip(pairs, over_splits, strict=True)):
        ours, theirs = errors[one], errors[other]
        p_value = _signed_rank(ours, theirs) if splits is None else splits.p_value
        over_poses = Estimate(low[number], high[number], posteriors[number], p_value)
        estimates = [over_poses] if splits is None else [splits, over_poses]
        yield Pair(
            name=contest.name,
            a=one,
            b=other,
            n_splits=len(slots),
            difference=_difference(ours, theirs, by_split),
            p_value=p_value,
            verdict=decide(estimates, question.confidence),
            of_fits=splits is None,
        )


def _errors(results: Sequence[CellResult], data: StoredData) -> _Errors:
    found = [result.prediction for result in results if result.prediction is not None]
    each = [norm_errors(prediction) for prediction in found]
    poses = data.samples.pose_id[np.concatenate([prediction.rows for prediction in found])]
    return _Errors(
        np.array([errors.mean() for errors in each]),
        pose_errors(poses, np.concatenate(each)[:, None]),
    )


def _difference(a: _Errors, b: _Errors, by_split: bool) -> float:
    if by_split:
        return float(a.of_splits.mean() - b.of_splits.mean())
    return float(a.of_poses.mean[0] - b.of_poses.mean[0])


def _signed_rank(a: _Errors, b: _Errors) -> float:
    return wilcoxon_signed_rank(pose_differences(a.of_poses, b.of_poses)[:, 0])


def _of_draws(
    drawn: FloatArray, question: Question
) -> tuple[list[float], list[float], list[Posterior]]:
    """Return the bounds and the probabilities of each column of (B, k) drawn differences, m."""
    tail = 0.5 * (1.0 - question.confidence)
    low, high = np.quantile(drawn, [tail, 1.0 - tail], axis=0)
    a_better = np.mean(drawn < -question.rope, axis=0).tolist()
    b_better = np.mean(drawn > question.rope, axis=0).tolist()
    posteriors = [
        Posterior(a, max(0.0, 1.0 - a - b), b) for a, b in zip(a_better, b_better, strict=True)
    ]
    return low.tolist(), high.tolist(), posteriors
