"""Two competitors, contest by contest: how much they differ, and how sure that is.

Two things are uncertain: another training set would give other models, and other poses would be
tested. Repeated splits show the first (corrected t test), the bootstrap over poses the second.
A verdict needs all that the results allow; a single split, and a protocol that scores all poses
together, allow the poses alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiff_bench.choice import OPTION_MARK, split_word
from stiff_bench.collected import Contest, ContestName, Slot
from stiff_bench.stored_data import StoredData
from stiff_protocols.bootstrap import (
    PoseErrors,
    bootstrap_difference,
    pose_differences,
    pose_errors,
    resampled_means,
)
from stiff_protocols.errors import DataError
from stiff_protocols.metrics import absolute_errors, norm_errors
from stiff_protocols.paired import (
    LEVEL,
    ROPE_M,
    Posterior,
    corrected_t,
    holm,
    wilcoxon_signed_rank,
)
from stiff_protocols.ranks import FEWEST_DATASETS
from stiff_protocols.record import CellResult, Presentation
from stiff_protocols.types import AXES, FloatArray, Prediction

NORM = "norm"
ERRORS = (*AXES, NORM)
"""What is compared: the absolute error along each axis, and the length of the error vector."""
Verdict = Literal["a", "b", "equivalent", "open"]
"""Who is better; "open": they cannot be told apart, which does not mean that they are equal."""
SPECIMEN = "specimen="


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


@dataclass(frozen=True)
class Row:
    """One kind of error of A and of B.

    Attributes:
        error: one of `ERRORS`.
        mean_a, mean_b: mean absolute errors, m.
        difference: A less B, m; negative where A is better.
        over_splits: by the corrected t test; None where there is one split or all are pooled.
        over_poses: by the bootstrap over poses, with the fitted models held fixed.
        verdict: of all of them together.
    """

    error: str
    mean_a: float
    mean_b: float
    difference: float
    over_splits: Estimate | None
    over_poses: Estimate
    verdict: Verdict

    @property
    def main(self) -> Estimate:
        """The estimate that is shown first: over splits where there is one."""
        return self.over_splits or self.over_poses


@dataclass(frozen=True)
class Comparison:
    """A and B in one contest.

    Attributes:
        name: of the contest.
        a, b: what must stand beside their numbers.
        slots: the splits that both have.
        n_train, n_test: rows of one split, means over the splits.
        train_known: the number of training rows was stored; else it is all that was not tested.
        n_poses: that were tested.
        same_test: several splits test the same rows.
        rows: one for each of `ERRORS`.
        missing: what A or B lacks, one line each.
    """

    name: ContestName
    a: Presentation
    b: Presentation
    slots: tuple[Slot, ...]
    n_train: float
    n_test: float
    train_known: bool
    n_poses: int
    same_test: bool
    rows: tuple[Row, ...]
    missing: tuple[str, ...]

    def row(self, error: str) -> Row:
        """Return the row of one kind of error."""
        return self.rows[ERRORS.index(error)]

    @property
    def over_splits(self) -> bool:
        """Whether the spread over splits is known."""
        return self.rows[0].over_splits is not None

    @property
    def test_share(self) -> float:
        """Part of the samples (0..1) that a split tests on."""
        return self.n_test / (self.n_test + self.n_train)


@dataclass(frozen=True)
class Across:
    """A and B over several data sets of one robot type, under one protocol and condition.

    Attributes:
        family: the data sets' name without their specimen.
        protocol, condition, seed: shared.
        verdicts: of the mean length of the error, one a data set.
        mean_difference: over the data sets, A less B, m.
        p_value: Wilcoxon over the data sets' differences; None where they are too few.
    """

    family: str
    protocol: str
    condition: str
    seed: int
    verdicts: tuple[Verdict, ...]
    mean_difference: float
    p_value: float | None


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


def estimate_over_poses(a: PoseErrors, b: PoseErrors, question: Question) -> list[Estimate]:
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
        pair = [
            PoseErrors(one.poses, one.totals[:, [column]], one.counts) for one in (a, b)
        ]
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


def errors_of(prediction: Prediction) -> FloatArray:
    """Return the (n, 4) sizes of the errors, m, one column for each of `ERRORS`."""
    return np.column_stack([absolute_errors(prediction), norm_errors(prediction)])


def predictions(results: Sequence[CellResult]) -> list[Prediction]:
    """Return what finished cells predicted."""
    return [result.prediction for result in results if result.prediction is not None]


def compare(contest: Contest, a: str, b: str, data: StoredData, question: Question) -> Comparison:
    """Compare two competitors of a contest on the splits that both have.

    Raises:
        DataError: one has no results there, they share no split, or one pose alone was tested.
    """
    slots = _shared(contest, a, b)
    of_a, of_b = (contest.results(name, slots) for name in (a, b))
    predicted_a, predicted_b = predictions(of_a), predictions(of_b)
    rows = np.concatenate([one.rows for one in predicted_a])
    pose_id = data.samples.pose_id[rows]
    over_poses = estimate_over_poses(
        pose_errors(pose_id, np.concatenate([errors_of(one) for one in predicted_a])),
        pose_errors(pose_id, np.concatenate([errors_of(one) for one in predicted_b])),
        question,
    )
    n_test = float(np.mean([len(one.rows) for one in predicted_a]))
    known = all(result.n_train for result in of_a)
    n_train = float(np.mean([result.n_train for result in of_a]))
    frame = Comparison(
        name=contest.name,
        a=contest.competitors[a].shown,
        b=contest.competitors[b].shown,
        slots=tuple(slots),
        n_train=n_train if known else len(data.samples) - n_test,
        n_test=n_test,
        train_known=known,
        n_poses=len(np.unique(pose_id)),
        same_test=len({one.rows.tobytes() for one in predicted_a}) == 1 < len(slots),
        rows=(),
        missing=tuple(_missing(contest, a, b)),
    )
    if len(slots) == 1 or frame.a.pooled:
        means = [_pooled_means(one) for one in (predicted_a, predicted_b)]
        return replace(frame, rows=_rows(*means, None, over_poses, question))
    each_a, each_b = (
        np.array([errors_of(one).mean(axis=0) for one in predicted])  # (J, 4) m
        for predicted in (predicted_a, predicted_b)
    )
    over_splits = _over_splits(each_a - each_b, frame.test_share, question)
    means = [each_a.mean(axis=0), each_b.mean(axis=0)]
    return replace(frame, rows=_rows(*means, over_splits, over_poses, question))


def _pooled_means(predicted: Sequence[Prediction]) -> FloatArray:
    return np.asarray(np.concatenate([errors_of(one) for one in predicted]).mean(axis=0))


def _over_splits(
    differences: FloatArray, test_share: float, question: Question
) -> list[Estimate]:
    """Return an estimate for each column of the (J, k) differences of the splits, m."""
    estimates = []
    for column in differences.T:
        found = corrected_t(column, test_share)
        low, high = found.interval(question.confidence)
        estimates.append(Estimate(low, high, found.posterior(question.rope), found.p_value))
    return estimates


def _rows(
    mean_a: FloatArray,
    mean_b: FloatArray,
    over_splits: list[Estimate] | None,
    over_poses: list[Estimate],
    question: Question,
) -> tuple[Row, ...]:
    """Return the rows with their verdicts."""
    over_poses = _corrected(over_poses)
    of_splits = [None] * len(ERRORS) if over_splits is None else _corrected(over_splits)
    rows = []
    for k, error in enumerate(ERRORS):
        difference = float(mean_a[k] - mean_b[k])
        estimates = [one for one in (of_splits[k], over_poses[k]) if one is not None]
        verdict = decide(estimates, question.confidence)
        rows.append(
            Row(
                error,
                float(mean_a[k]),
                float(mean_b[k]),
                difference,
                of_splits[k],
                over_poses[k],
                verdict,
            )
        )
    return tuple(rows)


def _corrected(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Correct the axes' p-values for one another (Holm); the length is a question of its own."""
    of_axes = holm([estimate.p_value for estimate in estimates[: len(AXES)]])
    p_values = [*of_axes.tolist(), estimates[-1].p_value]
    return [
        replace(estimate, p_value=p_value)
        for estimate, p_value in zip(estimates, p_values, strict=True)
    ]


def _shared(contest: Contest, a: str, b: str) -> list[Slot]:
    """Return the splits that both have, or say why there are none."""
    for name in (a, b):
        if name not in contest.competitors:
            raise DataError(f"{contest.name.text}: {name} was not run")
        if not contest.competitors[name].done:
            reasons = list(contest.competitors[name].reasons.values())
            raise DataError(f"{contest.name.text}: {name} has no result ({reasons[0]})")
    slots = contest.shared_slots([a, b])
    if not slots:
        raise DataError(f"{contest.name.text}: {a} and {b} have no result on the same split")
    return slots


def _missing(contest: Contest, a: str, b: str) -> list[str]:
    """Say on how many splits A or B has no result, and why."""
    found = []
    shared = len(contest.shared_slots([a, b]))
    asked = {
        slot
        for name in (a, b)
        for slot in (*contest.competitors[name].done, *contest.competitors[name].reasons)
    }
    for name in (a, b):
        competitor = contest.competitors[name]
        lacking = sorted(asked - set(competitor.done))
        if lacking:
            reasons = dict.fromkeys(
                competitor.reasons.get(slot, "not run") for slot in lacking
            )
            found.append(
                f"{name} lacks {len(lacking)} of {len(asked)} splits ({'; '.join(reasons)}); "
                f"compared on the {shared} that both have"
            )
    return found


def across_datasets(comparisons: Sequence[Comparison]) -> list[Across]:
    """Sum up over the data sets of one robot type, wherever there are several.

    Splits of one data set are never counted as data sets, nor is other data of the same name.
    """
    groups: dict[tuple[str, str, str, int], list[Comparison]] = {}
    for comparison in comparisons:
        name = comparison.name
        key = (family(name.dataset), name.protocol, name.condition, name.seed)
        groups.setdefault(key, []).append(comparison)
    return [
        _across(key, group)
        for key, group in groups.items()
        if len(group) > 1 and len({one.name.dataset for one in group}) == len(group)
    ]


def family(dataset: str) -> str:
    """Return a data set's name without its specimen: "kr10-twin" for "kr10-twin@specimen=3"."""
    key, settings = split_word(dataset)
    kept = [word for word in settings if not word.startswith(SPECIMEN)]
    return OPTION_MARK.join([key, *kept])


def _across(key: tuple[str, str, str, int], group: Sequence[Comparison]) -> Across:
    differences = [one.row(NORM).difference for one in group]
    enough = len(group) >= FEWEST_DATASETS
    return Across(
        *key,
        verdicts=tuple(one.row(NORM).verdict for one in group),
        mean_difference=float(np.mean(differences)),
        p_value=wilcoxon_signed_rank(differences) if enough else None,
    )
