"""What a measurement plan gains over random plans of its size, from the same candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stiff_datasets.measured.identifiability import REFERENCE_COMPLIANCE, identifiability
from stiff_datasets.planning.design import Design
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, IntArray

N_RANDOM = 20
"""Random plans that a plan is compared with."""


def random_plans(n: int, n_candidates: int, seed: int) -> list[IntArray]:
    """Draw `N_RANDOM` plans, each (n,) row numbers of candidates.

    Raises:
        DataError: a plan is empty or larger than the candidates.
    """
    if not 1 <= n <= n_candidates:
        raise DataError(
            f"random plans of {n} samples from {n_candidates} candidates; expected 1 "
            "sample up to all candidates"
        )
    rng = np.random.default_rng(seed)
    return [rng.choice(n_candidates, n, replace=False) for _ in range(N_RANDOM)]


class Criteria(NamedTuple):
    """What a plan is judged by; the attributes are those of `Identifiability`.

    Attributes:
        log_det: more is better.
        condition: less is better.
        worst_error: largest relative standard error of a joint; less is better.
    """

    log_det: float
    condition: float
    worst_error: float


@dataclass(frozen=True)
class PlanGain:
    """A plan beside random plans of the same size from the same candidates.

    Attributes:
        joints: names of the joints compared: those that all candidates together identify.
        plan: criteria of the plan.
        random_mean: mean of each criterion over the random plans.
        random_best: best of each criterion over the random plans.
    """

    joints: tuple[str, ...]
    plan: Criteria
    random_mean: Criteria
    random_best: Criteria

    @property
    def efficiency(self) -> float:
        """How often the mean random plan would have to be measured to tell as much."""
        return float(np.exp((self.plan.log_det - self.random_mean.log_det) / len(self.joints)))

    @property
    def efficiency_over_best(self) -> float:
        """The same of the best random plan."""
        return float(np.exp((self.plan.log_det - self.random_best.log_det) / len(self.joints)))


def plan_gain(
    plan: FloatArray,
    candidates: FloatArray,
    joint_names: Sequence[str],
    *,
    reference_compliance: float | FloatArray = REFERENCE_COMPLIANCE,
    seed: int = 0,
) -> PlanGain:
    """Compare a plan with random plans of its size.

    Args:
        plan: (n, 3, n_joints) regressors of the plan.
        candidates: (n_candidates, 3, n_joints) regressors that random plans are drawn from.
        joint_names: base to tip.
        reference_compliance: as `identifiability`.
        seed: draws the random plans.

    Raises:
        DataError: the candidates are too few.
    """
    drawn = random_plans(len(plan), len(candidates), seed)
    unknown = identifiability(candidates, joint_names).unidentifiable
    compared = [i for i, name in enumerate(joint_names) if name not in unknown]
    names = tuple(joint_names[i] for i in compared)
    reference = np.broadcast_to(reference_compliance, len(joint_names))[compared]

    def criteria(samples: FloatArray) -> Criteria:
        found = identifiability(samples[:, :, compared], names, reference_compliance=reference)
        return Criteria(found.log_det, found.condition, float(found.relative_standard_error.max()))

    found = np.array([criteria(candidates[rows]) for rows in drawn])
    mean, lowest = Criteria(*found.mean(axis=0).tolist()), found.min(axis=0).tolist()
    best = Criteria(float(found[:, 0].max()), *lowest[1:])
    return PlanGain(names, criteria(plan), mean, best)


class VarianceGain(NamedTuple):
    """Mean variances [m²] of a prediction over the workspace, without noise; less is better.

    Attributes:
        before: as it is.
        plan: with the plan measured.
        random_mean: mean over random plans of the same size.
        random_best: best of them.
    """

    before: float
    plan: float
    random_mean: float
    random_best: float

    @property
    def ratio(self) -> float:
        """How much more the plan lowers the variance than the mean random plan; NaN: from infinity.

        One where neither lowers it.
        """
        if not np.isfinite(self.before):
            return np.nan
        by_random = self.before - self.random_mean
        return (self.before - self.plan) / by_random if by_random > 0.0 else 1.0


def variance_gain(
    design: Design, plan: IntArray, n_candidates: int, *, seed: int = 0
) -> VarianceGain:
    """Compare chosen candidates with random ones.

    Args:
        design: that chose.
        plan: (n,) row numbers of candidates.
        n_candidates: that random plans are drawn from.
        seed: draws them.

    Raises:
        DataError: the plan is empty or larger than the candidates.
    """
    drawn = [design.variance(rows) for rows in random_plans(len(plan), n_candidates, seed)]
    before = design.variance(plan[:0])
    return VarianceGain(before, design.variance(plan), float(np.mean(drawn)), min(drawn))
