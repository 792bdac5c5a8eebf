"""What a measurement plan gains over random plans of its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stiff_datasets.measured.identifiability import (
    REFERENCE_COMPLIANCE,
    identifiability,
    per_joint,
)
from stiff_datasets.planning.design import N_RANDOM
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray


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
        n_random: number of random plans.
        plan: criteria of the plan.
        random_mean: mean of each criterion over the random plans.
        random_best: best of each criterion over the random plans.
    """

    joints: tuple[str, ...]
    n_random: int
    plan: Criteria
    random_mean: Criteria
    random_best: Criteria

    @property
    def efficiency(self) -> float:
        """How often the mean random plan would have to be measured to tell as much."""
        return self._over(self.random_mean)

    @property
    def efficiency_over_best(self) -> float:
        """The same of the best random plan."""
        return self._over(self.random_best)

    def _over(self, other: Criteria) -> float:
        return float(np.exp((self.plan.log_det - other.log_det) / len(self.joints)))


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
        DataError: as `identifiability`, or the candidates identify no joint or are too few.
    """
    if not 1 <= len(plan) <= len(candidates):
        raise DataError(
            f"random plans of {len(plan)} samples from {len(candidates)} candidates; expected 1 "
            "sample up to all candidates"
        )
    unknown = identifiability(candidates, joint_names).unidentifiable
    compared = [i for i, name in enumerate(joint_names) if name not in unknown]
    if not compared:
        raise DataError("the candidates identify no joint; is every force zero?")
    names = tuple(joint_names[i] for i in compared)
    reference = per_joint(reference_compliance, len(joint_names))[compared]

    def criteria(samples: FloatArray) -> Criteria:
        found = identifiability(samples[:, :, compared], names, reference_compliance=reference)
        return Criteria(found.log_det, found.condition, float(found.relative_standard_error.max()))

    rng = np.random.default_rng(seed)
    drawn = np.array(
        [
            criteria(candidates[rng.choice(len(candidates), len(plan), replace=False)])
            for _ in range(N_RANDOM)
        ]
    )
    mean, lowest = Criteria(*drawn.mean(axis=0).tolist()), drawn.min(axis=0).tolist()
    best = Criteria(float(drawn[:, 0].max()), *lowest[1:])
    return PlanGain(names, N_RANDOM, criteria(plan), mean, best)
