"""Two competitors in one contest: how much they differ, axis by axis, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiff_bench.analysis.collected import Contest, SplitSizes, split_sizes
from stiff_bench.analysis.verdict import (
    Decision,
    Estimate,
    Question,
    Verdict,
    corrected,
    decide,
    estimates_over_poses,
    estimates_over_splits,
)
from stiff_bench.store.names import ContestName
from stiff_bench.store.newest import Slot
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.record import CellResult, Presentation
from stiff_protocols.contract.types import AXES, FloatArray, IntArray, Prediction
from stiff_protocols.scoring.bootstrap import pose_errors
from stiff_protocols.scoring.metrics import absolute_errors, norm_errors


def corrected_over_axes(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Correct the axes' p-values for one another (Holm); the length is a question of its own."""
    *of_axes, length = estimates
    return [*corrected(of_axes), length]


NORM = "norm"
ERRORS = (*AXES, NORM)
"""What is compared: the absolute error along each axis, and the length of the error vector."""


@dataclass(frozen=True)
class Row:
    """One kind of error of A and of B.

    Attributes:
        error: one of `ERRORS`.
        mean_a, mean_b: mean absolute errors, m.
        over_splits: by the corrected t test; None where there is one split or all are pooled.
        over_poses: by the bootstrap over poses, with the fitted models held fixed.
        decision: on all of them together; without splits it is of the fitted models alone.
    """

    error: str
    mean_a: float
    mean_b: float
    over_splits: Estimate | None
    over_poses: Estimate
    decision: Decision

    @property
    def verdict(self) -> Verdict:
        """Who is better."""
        return self.decision.verdict

    @property
    def difference(self) -> float:
        """A less B, m; negative where A is better."""
        return self.mean_a - self.mean_b

    @property
    def main(self) -> Estimate:
        """The estimate that is shown first: over splits where there is one."""
        return self.over_splits or self.over_poses

    @property
    def cautious(self) -> Estimate:
        """The estimate with the wider interval: the one to speak of where one alone is named."""
        return max(self.main, self.over_poses, key=lambda one: one.high - one.low)

    @property
    def cautious_over(self) -> Literal["splits", "poses"]:
        """What the cautious estimate's spread is over."""
        return "splits" if self.cautious is self.over_splits else "poses"


@dataclass(frozen=True)
class Comparison:
    """A and B in one contest.

    Attributes:
        name: of the contest.
        a, b: what must stand beside their numbers.
        n_splits: that both have.
        sizes: rows that the splits train and test on.
        n_poses: that were tested.
        same_test: several splits test the same rows.
        rows: one for each of `ERRORS`.
        missing: what A or B lacks, or both of what was asked for, one line each.
    """

    name: ContestName
    a: Presentation
    b: Presentation
    n_splits: int
    sizes: SplitSizes
    n_poses: int
    same_test: bool
    rows: tuple[Row, ...]
    missing: tuple[str, ...]

    def row(self, error: str) -> Row:
        """Return the row of one kind of error."""
        return self.rows[ERRORS.index(error)]

    @property
    def splits_text(self) -> str:
        """The number of shared splits, for people."""
        return counted(self.n_splits, "split")

    @property
    def over_splits(self) -> bool:
        """Whether the spread over splits is known."""
        return self.rows[0].over_splits is not None

    @property
    def selects_on_test(self) -> bool:
        """Whether the protocol lets models choose on the test part."""
        return self.a.selects_on_test or self.b.selects_on_test


@dataclass(frozen=True, eq=False)
class PairedErrors:
    """The errors of A and of B at the same test rows, all shared splits one after another.

    Attributes:
        rows: (n,) row numbers in the data set; a row that several splits test stands here as often.
        split: (n,) which of the shared splits it is of, from 0.
        a, b: (n, 4) sizes of the errors, m, one column for each of `ERRORS`.
    """

    rows: IntArray
    split: IntArray
    a: FloatArray
    b: FloatArray


def paired_errors(contest: Contest, a: str, b: str) -> PairedErrors:
    """Return the errors of two competitors of a contest on the splits that both have.

    Raises:
        DataError: one has no results there, or they share no split.
    """
    slots = _shared(contest, a, b)
    of_a, of_b = (_predictions(contest.results(name, slots)) for name in (a, b))
    counts = [len(one.rows) for one in of_a]
    return PairedErrors(
        rows=np.concatenate([one.rows for one in of_a]),
        split=np.repeat(np.arange(len(slots)), counts),
        a=np.concatenate([_sizes(one) for one in of_a]),
        b=np.concatenate([_sizes(one) for one in of_b]),
    )


def _predictions(results: Sequence[CellResult]) -> list[Prediction]:
    return [result.prediction for result in results if result.prediction is not None]


def _sizes(prediction: Prediction) -> FloatArray:
    return np.column_stack([absolute_errors(prediction), norm_errors(prediction)])


def compare(contest: Contest, a: str, b: str, data: StoredData, question: Question) -> Comparison:
    """Compare two competitors of a contest on the splits that both have.

    Raises:
        DataError: one has no results there, they share no split, or one pose alone was tested.
    """
    paired = paired_errors(contest, a, b)
    slots = contest.shared_slots([a, b])
    shown = contest.competitors[a].shown
    sizes = split_sizes(contest.results(a, slots), len(data.samples))
    frame = Comparison(
        name=contest.name,
        a=shown,
        b=contest.competitors[b].shown,
        n_splits=len(slots),
        sizes=sizes,
        n_poses=len(np.unique(data.samples.pose_id[paired.rows])),
        same_test=len(slots) > 1 and len(np.unique(paired.rows)) == sizes.n_test,
        rows=(),
        missing=tuple(_missing(contest, a, b)),
    )
    by_split = len(slots) > 1 and not shown.pooled
    return replace(
        frame, rows=_rows(paired, data, sizes.test_share if by_split else None, question)
    )


def _rows(
    paired: PairedErrors, data: StoredData, test_share: float | None, question: Question
) -> tuple[Row, ...]:
    """Return the rows with their verdicts; over splits too where these have a test share."""
    pose_id = data.samples.pose_id[paired.rows]
    a, b = (pose_errors(pose_id, errors) for errors in (paired.a, paired.b))
    over_poses = corrected_over_axes(estimates_over_poses(a, b, question))
    mean_a, mean_b = a.mean, b.mean  # (4,) m
    over_splits: Sequence[Estimate | None] = [None] * len(ERRORS)
    if test_share is not None:
        of_a, of_b = (_split_means(errors, paired.split) for errors in (paired.a, paired.b))
        over_splits = corrected_over_axes(estimates_over_splits(of_a - of_b, test_share, question))
        mean_a, mean_b = of_a.mean(axis=0), of_b.mean(axis=0)
    return tuple(
        Row(
            error=error,
            mean_a=float(mean_a[k]),
            mean_b=float(mean_b[k]),
            over_splits=over_splits[k],
            over_poses=over_poses[k],
            decision=decide(
                [one for one in (over_splits[k], over_poses[k]) if one is not None],
                question.confidence,
            ),
        )
        for k, error in enumerate(ERRORS)
    )


def _split_means(errors: FloatArray, split: IntArray) -> FloatArray:
    """Return the (J, 4) mean errors of each split."""
    return np.array([errors[split == number].mean(axis=0) for number in np.unique(split)])


def _shared(contest: Contest, a: str, b: str) -> list[Slot]:
    """Return the splits that both have, or say why there are none."""
    for name in (a, b):
        if not contest.competitors[name].done:
            first = next(iter(contest.competitors[name].failures.values()))
            raise DataError(f"{name} has no result ({first.why_none})")
    slots = contest.shared_slots([a, b])
    if not slots:
        raise DataError(f"{a} and {b} have no result on the same split")
    return slots


def _missing(contest: Contest, a: str, b: str) -> list[str]:
    """Say how many splits were never run, on how many A or B has no result, and why."""
    found = []
    shared = len(contest.shared_slots([a, b]))
    asked = {
        slot
        for name in (a, b)
        for slot in (*contest.competitors[name].done, *contest.competitors[name].failures)
    }
    wanted = max((one.n_splits for name in (a, b) for one in contest.results(name)), default=0)
    if len(asked) < wanted:
        found.append(f"{len(asked)} of {wanted} splits asked for were run")
    for name in (a, b):
        competitor = contest.competitors[name]
        lacking = sorted(asked - set(competitor.done))
        if lacking:
            failures = [competitor.failures.get(slot) for slot in lacking]
            reasons = dict.fromkeys(one.why_none if one else "not run" for one in failures)
            found.append(
                f"{name} lacks {len(lacking)} of {len(asked)} splits ({'; '.join(reasons)}); "
                f"compared on the {shared} that both have"
            )
    return found
