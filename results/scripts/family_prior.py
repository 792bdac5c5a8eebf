"""A prior of springs learned on other robots, tried and not offered (docs/decisions.md).

A plugin for `bench run --plugin results/scripts/family_prior.py`; the page has the whole command.
`vjm-family`, `vjm-full-family` and `vjm-multisegment-family` have the prior learned on 13 robots
without the one that is fitted; `vjm-narrow` and so on have today's law with a spread of 0.5.

With x_rs the ln compliance of spring s on robot r about today's law, identified from all of the
robot's samples with the standard deviation e_rs (springs that they do not identify count for
nothing),

    x_rs ~ N(a_r + b_s, v_s + e_rs^2),    b_s ~ N(0, (ln 5)^2).

a_r is free: the prior knows no robot's overall stiffness. b and v maximise the likelihood
(expectation maximisation); each v_s counts as 4 robots of the pooled variance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares

from stiff_datasets.measured.fanuc_r2000ic import FanucR2000iC
from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_datasets.twin.robot_twin import ARMS, ArmFamily, Ur5Twin
from stiff_models.fitted_model import FittedModel
from stiff_models.physics.full_vjm import spring_regressor, typical_springs
from stiff_models.physics.multi_segment_vjm import FIRST_SHARE, _loaded_joints
from stiff_models.physics.vjm import compliance_regressor, fitted_physics
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.springs.identification import (
    LEAST_NOISE,
    PRIOR_SPREAD,
    least_compliance,
    typical_joints,
)

KEYS = ("vjm", "vjm-full", "vjm-multisegment")
SHRUNK = 4.0  # robots
UNKNOWN = 10.0  # error of ln compliance of a spring that the samples do not identify
NARROW = 0.5  # of ln compliance


def law(key, robot):
    """Return today's (n_springs,) mean of ln compliance, up to a constant."""
    if key == "vjm-full":
        return np.log(typical_springs(robot, 3))
    return np.log(np.repeat(typical_joints(robot), 2 if key == "vjm-multisegment" else 1))


def regressors(key, robot, train) -> Callable:
    """Return what turns (q, wrench) into the (n, 3, n_springs) regressor of a model."""
    if key == "vjm":
        return lambda q, wrench: compliance_regressor(robot, q, wrench)
    if key == "vjm-full":
        return lambda q, wrench: spring_regressor(robot, q, wrench, 3)

    def segments(q, wrench):
        return _loaded_joints(robot, q, wrench, gravity=True)

    ends = segments(train.q, train.wrench).quantiles([FIRST_SHARE])
    return lambda q, wrench: segments(q, wrench).effects(ends).reshape(len(q), 3, -1)


@lru_cache
def learned(key):
    """Return the ln compliances about the law and their errors, by the robot's name."""
    arms = [ArmFamily(robot=number) for number in range(len(ARMS))]
    springs = {}
    for data in (dataset.load() for dataset in (*arms, Ur5Twin(), Kr10Twin(), FanucR2000iC())):
        identified = fitted_physics(key, data.samples, data.robot).springs_
        x = np.log(np.maximum(identified.compliance, 1e-300)) - law(key, data.robot)
        # the values of the others are today's prior's
        error = np.where(identified.is_identified, identified.log_error, UNKNOWN)
        springs[data.robot.name] = np.clip(x, np.median(x) - 8.0, np.median(x) + 8.0), error
    return springs


@lru_cache
def family(key, left_out):
    """Return b and the square root of v, both (n_springs,), learned without one robot."""
    x, error = np.stack([pair for name, pair in learned(key).items() if name != left_out], axis=1)
    mean, variance = np.zeros(x.shape[1]), np.full(x.shape[1], 0.25)
    for _ in range(200):
        weight = 1.0 / (error**2 + variance)
        factor = (weight * (x - mean)).sum(axis=1) / weight.sum(axis=1)
        deviation = x - factor[:, None]
        mean = (weight * deviation).sum(axis=0) / (weight.sum(axis=0) + PRIOR_SPREAD**-2)
        mean -= mean.mean()
        gain = variance * weight
        unsure = 1.0 / weight.sum(axis=1)[:, None] + 1.0 / (weight.sum(axis=0) + PRIOR_SPREAD**-2)
        squares = gain**2 * ((deviation - mean) ** 2 + unsure) + variance * (1.0 - gain)
        squares = squares.sum(axis=0)
        variance = (squares + SHRUNK * squares.sum() / x.size) / (len(x) + SHRUNK)
    return mean, np.sqrt(variance)


def most_probable(matrix, target, mean, spread):
    """Return (n_springs,) compliances: as `identification`, and all springs feel the prior."""
    fitted = least_compliance(matrix, target)
    residual = target - matrix @ fitted
    free = max(len(target) - int((fitted > 0.0).sum()), 0)
    noise = np.sqrt(
        (residual @ residual + LEAST_NOISE**2 * target @ target / len(target)) / (free + 1)
    )
    matrix, target = matrix / noise, target / noise
    weight = spread**-2.0  # the overall factor is left out of the prior
    prior = np.diag(1.0 / spread) - np.outer(1.0 / spread, weight) / weight.sum()
    usual = matrix @ np.exp(mean)
    factor = usual @ target / (usual @ usual)
    if factor <= 0.0:
        factor = np.median((fitted / np.exp(mean))[fitted > 0.0])
    start = mean + np.log(factor)

    def compliance(x):
        return np.exp(np.clip(start + x, -60.0, 60.0))

    return compliance(
        least_squares(
            lambda x: np.concatenate([matrix @ compliance(x) - target, prior @ x]),
            np.zeros(len(mean)),
            jac=lambda x: np.vstack([matrix * compliance(x), prior]),
            method="lm",
        ).x
    )


@dataclass(kw_only=True, eq=False, repr=False)
class OtherPrior(FittedModel):
    """A VJM with another prior."""

    key = prior = ""

    def _fit(self, train, robot, validation, seed):
        self.regressor_ = regressors(self.key, robot, train)
        mean, spread = law(self.key, robot), np.full(len(law(self.key, robot)), NARROW)
        if self.prior == "family":
            about, spread = family(self.key, robot.name)
            mean = mean + about
        matrix = self.regressor_(train.q, train.wrench).reshape(-1, len(mean))
        self.compliance_ = most_probable(matrix, train.deflection.reshape(-1), mean, spread)

    def _predict(self, q, wrench):
        return self.regressor_(q, wrench) @ self.compliance_


def variant(key, prior):
    """Return the class of a model with a prior."""
    name = f"{prior}_{key}".replace("-", "_")
    return type(name, (OtherPrior,), {"key": key, "prior": prior})


MODELS = [
    ModelInfo(key=f"{key}-{prior}", target=variant(key, prior), summary=f"{key}, prior: {prior}")
    for key in KEYS
    for prior in ("family", "narrow")
]
