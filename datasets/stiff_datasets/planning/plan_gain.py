"""Compare a measurement plan with random plans of its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stiff_datasets.measured.identifiability import identifiability
from stiff_datasets.planning.design import Design
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, IntArray

N_RANDOM = 20
"""Number of random plans in a comparison."""


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
    """Criteria of a plan; see `Identifiability`.

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
    """Comparison of a plan with random plans of the same size and candidates.

    Attributes:
        joints: names of the compared joints, which all candidates together identify.
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
        """Number of repeats of the mean random plan with the same information."""
        return float(np.exp((self.plan.log_det - self.random_mean.log_det) / len(self.joints)))

    @property
    def efficiency_over_best(self) -> float:
        """Number of repeats of the best random plan with the same information."""
        return float(np.exp((self.plan.log_det - self.random_best.log_det) / len(self.joints)))


def plan_gain(
    plan: FloatArray,
    candidates: FloatArray,
    joint_names: Sequence[str],
    *,
    seed: int = 0,
) -> PlanGain:
    """Compare a plan with random plans of its size.

    Args:
        plan: (n, 3, n_joints) regressors of the plan.
        candidates: (n_candidates, 3, n_joints) regressors of the candidates for random plans.
        joint_names: base to tip.
        seed: draws the random plans.

    Raises:
        DataError: the candidates are too few.
    """
    random_rows = random_plans(len(plan), len(candidates), seed)
    unidentifiable = identifiability(candidates, joint_names).unidentifiable
    compared = [i for i, name in enumerate(joint_names) if name not in unidentifiable]
    names = tuple(joint_names[i] for i in compared)

    def criteria(samples: FloatArray) -> Criteria:
        information = identifiability(samples[:, :, compared], names)
        return Criteria(
            information.log_det,
            information.condition,
            float(information.relative_standard_error.max()),
        )

    random_criteria = np.array([criteria(candidates[rows]) for rows in random_rows])
    mean, lowest = (
        Criteria(*random_criteria.mean(axis=0).tolist()),
        random_criteria.min(axis=0).tolist(),
    )
    best = Criteria(float(random_criteria[:, 0].max()), *lowest[1:])
    return PlanGain(names, criteria(plan), mean, best)


class VarianceGain(NamedTuple):
    """Mean variances [m²] of a prediction over the workspace, without noise; less is better.

    Attributes:
        before: variance without new samples.
        plan: variance after measuring the plan.
        random_mean: mean over random plans of the same size.
        random_best: least variance of a random plan.
    """

    before: float
    plan: float
    random_mean: float
    random_best: float

    @property
    def ratio(self) -> float:
        """Decrease of the variance relative to the mean random plan; NaN if it was infinite.

        It is 1 if neither lowers the variance.
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
        design: the design that chose the plan.
        plan: (n,) row numbers of candidates.
        n_candidates: number of candidates for random plans.
        seed: draws the random plans.

    Raises:
        DataError: the plan is empty or larger than the candidates.
    """
    drawn = [design.variance(rows) for rows in random_plans(len(plan), n_candidates, seed)]
    before = design.variance(plan[:0])
    return VarianceGain(before, design.variance(plan), float(np.mean(drawn)), min(drawn))
