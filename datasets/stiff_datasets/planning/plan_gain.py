"""What a measurement plan gains over random plans of its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from stiff_datasets.measured.identifiability import (
    DEFLECTION_NOISE,
    REFERENCE_COMPLIANCE,
    identifiability,
    per_joint,
)
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray


@dataclass(frozen=True)
class Criteria:
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
        efficiency: exp(difference of log_det to the mean random plan / number of joints): that
            plan would have to be measured so many times over to tell as much.
        efficiency_over_best: the same beside the best random plan.
    """

    joints: tuple[str, ...]
    n_random: int
    plan: Criteria
    random_mean: Criteria
    random_best: Criteria
    efficiency: float
    efficiency_over_best: float


def plan_gain(
    plan: FloatArray,
    candidates: FloatArray,
    joint_names: Sequence[str],
    *,
    reference_compliance: float | FloatArray = REFERENCE_COMPLIANCE,
    deflection_noise: float = DEFLECTION_NOISE,
    n_random: int = 20,
    seed: int = 0,
) -> PlanGain:
    """Compare a plan with random plans of its size.

    Args:
        plan: (n, 3, n_joints) regressors of the plan.
        candidates: (n_candidates, 3, n_joints) regressors that random plans are drawn from.
        joint_names: base to tip.
        reference_compliance: as `identifiability`.
        deflection_noise: as `identifiability`.
        n_random: number of random plans.
        seed: draws the random plans.

    Raises:
        DataError: as `identifiability`, or the candidates identify no joint or are too few.
    """
    if not 1 <= len(plan) <= len(candidates) or n_random < 1:
        raise DataError(
            f"{n_random} random plans of {len(plan)} samples from {len(candidates)} candidates; "
            "expected at least one plan, of 1 sample up to all candidates"
        )
    unknown = identifiability(candidates, joint_names).unidentifiable
    compared = [i for i, name in enumerate(joint_names) if name not in unknown]
    if not compared:
        raise DataError("the candidates identify no joint; is every force zero?")
    names = tuple(joint_names[i] for i in compared)
    reference = per_joint(reference_compliance, len(joint_names))[compared]

    def criteria(samples: FloatArray) -> Criteria:
        found = identifiability(
            samples[:, :, compared],
            names,
            reference_compliance=reference,
            deflection_noise=deflection_noise,
        )
        return Criteria(found.log_det, found.condition, float(found.relative_standard_error.max()))

    rng = np.random.default_rng(seed)
    drawn = [
        criteria(candidates[rng.choice(len(candidates), len(plan), replace=False)])
        for _ in range(n_random)
    ]
    log_dets, conditions, errors = np.array([astuple(each) for each in drawn]).T
    chosen = criteria(plan)
    mean = Criteria(float(log_dets.mean()), float(conditions.mean()), float(errors.mean()))
    best = Criteria(float(log_dets.max()), float(conditions.min()), float(errors.min()))
    return PlanGain(
        joints=names,
        n_random=n_random,
        plan=chosen,
        random_mean=mean,
        random_best=best,
        efficiency=float(np.exp((chosen.log_det - mean.log_det) / len(names))),
        efficiency_over_best=float(np.exp((chosen.log_det - best.log_det) / len(names))),
    )
