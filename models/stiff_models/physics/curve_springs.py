"""A parametric law of every joint's spring: three slopes and lost motion, solved by ridge.

18 virtual springs (three per joint) turn under the torque of the load. A spring across a joint's
axis is linear. A joint's own spring has a curve of the torque tau of weights and load

    phi(tau) = c1 tau + c2 clip(tau, -T1, T1) + c3 clip(tau, -T2, T2)
               + sum over h of m_h T atan(tau / (h T)),

with its slopes' ends T1 and T2 at thirds of the training torques and its largest training torque T.
The deflection is measured loaded minus unloaded, d = sum_s a_s [phi_s(tau_g + tau) - phi_s(tau_g)],
which is linear in all coefficients. They are small in units of a typical compliance; the strength
of this penalty is chosen on left-out poses. It is the yardstick for models that learn a curve: a
Gaussian process or a network must be better. SI: rad, N, N m, m.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from stiff_models.physics.fitted_geometry import GeometryModel
from stiff_models.physics.full_vjm import (
    spring_columns,
    spring_twists,
    typical_springs,
    warn_few_samples,
)
from stiff_models.physics.vjm import warn_no_masses, warn_unexplained
from stiff_models.pose_folds import folds_of_poses
from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import (
    AT_TCP,
    joint_torque,
    motion_at,
    unit_deflections,
)
from stiff_protocols.springs.unseen_joints import unseen_columns

SPRINGS_PER_JOINT: Literal[3] = 3
WIDTHS = (0.02, 0.1)
"""h, share of the largest torque within which lost motion is taken up."""
STRENGTHS = np.geomspace(1e-6, 1e2, 17)
"""Penalties to choose from, in units of the mean square of a column."""
LINE_SHARE = 0.01
"""Share of the penalty on straight lines, which every spring has."""
DEGREES_OF_FREEDOM, ROUNDS = 4.0, 10
"""Of Student's t distribution, and of its reweighting (Lange, Little and Taylor 1989)."""


@dataclass(kw_only=True, eq=False, repr=False)
class CurveSprings(GeometryModel):
    """Springs with three slopes and lost motion about the joints, and linear springs across them.

    Attributes:
        weights: weights of the samples: "equal", or "student": less for samples with large errors.
        ends_: (2, n_joints) T1 and T2, N m or N.
        torque_: (n_joints,) T, N m or N.
        coefficients_: (n_columns,) coefficients.
        typical_: (n_springs,) typical compliances, rad/(N m) or m/N: the coefficients' units.
        diagnostics_: number of coefficients, penalty, and the fitted geometry.
    """

    weights: Literal["equal", "student"] = "equal"

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        twists_of = partial(spring_twists, springs=SPRINGS_PER_JOINT)
        regressor = partial(unit_deflections, levers=train.levers)
        train, robot = self._placed(train, robot, twists_of, regressor)
        lines = regressor(twists_of(robot, train.q), train.wrench)
        if not lines.any():
            raise ModelError("no joint spring can be identified: no wrench turns any joint")
        warn_few_samples(train, lines.shape[2])
        warn_no_masses(robot)
        size = np.abs(np.vstack(self._torques(robot, train.q, train.wrench)))
        largest = size.max(axis=0)
        self.torque_ = np.where(largest > 0.0, largest, 1.0)  # of a joint without torque: any
        self.ends_ = np.quantile(size, [1.0 / 3.0, 2.0 / 3.0], axis=0)
        typical = typical_springs(robot, SPRINGS_PER_JOINT)
        moved = train.read(lines @ typical)
        scale = float((moved * train.values).sum() / ((moved**2).sum() or 1.0)) or 1.0
        self.typical_ = scale * typical
        columns = train.read(self._columns(robot, train.q, train.wrench, train.levers))
        readings, counts = train.values, train.is_read.sum(axis=1)

        def solved(rows: Any, strength: float) -> FloatArray:
            return self._solved(columns[rows], readings[rows], counts[rows], strength)

        power = 1.0 if self.weights == "student" else 2.0
        strength = best_strength(train, columns, solved, STRENGTHS, seed, power)
        self.coefficients_ = solved(slice(None), strength)
        n_lines = lines.shape[2]
        unseen = unseen_columns(columns[:, :, :n_lines])
        self.coefficients_[:n_lines][unseen] = 1.0  # by the joints' sizes
        self.diagnostics_ = {
            "coefficients": float(columns.shape[2]),
            "penalty": strength,
            **self._geometry_report(),
        }
        warn_unexplained(self.coefficients_, train)

    def _deflection(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        return np.asarray(self._columns(robot, q, wrench, levers) @ self.coefficients_)

    def _torques(
        self, robot: Robot, q: FloatArray, wrench: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the (n, n_joints) torques [N m or N] on the joints without and with the load."""
        unloaded = robot.gravity_torque(q)
        return unloaded, unloaded + joint_torque(robot.jacobian(q), wrench)

    def _columns(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray
    ) -> FloatArray:
        """Return the (n, 3, n_columns) deflection [m] by each part, at a typical compliance.

        The lines of all springs come first.
        """
        twists = spring_twists(robot, q, SPRINGS_PER_JOINT)
        lines = unit_deflections(twists, wrench, levers) * self.typical_
        kind = np.array(spring_columns(robot, SPRINGS_PER_JOINT)) % SPRINGS_PER_JOINT
        is_own = kind == SPRINGS_PER_JOINT - 1
        move = motion_at(twists, levers)[:, :, is_own] * self.typical_[is_own]
        unloaded, loaded = self._torques(robot, q, wrench)
        parts = [
            *(np.clip(loaded, -end, end) - np.clip(unloaded, -end, end) for end in self.ends_),
            *(
                self.torque_
                * (
                    np.arctan(loaded / (h * self.torque_))
                    - np.arctan(unloaded / (h * self.torque_))
                )
                for h in WIDTHS
            ),
        ]
        return np.concatenate([lines, *(move * part[:, None] for part in parts)], axis=2)

    def _solved(
        self, columns: FloatArray, readings: FloatArray, counts: IntArray, strength: float
    ) -> FloatArray:
        """Return the (n_columns,) coefficients of (n, m, n_columns) and (n, m) readings [m].

        `counts` (n,) are the numbers that were read in each sample.
        """
        n, most, n_columns = columns.shape
        n_lines = len(self.torque_) * SPRINGS_PER_JOINT
        shares = np.where(np.arange(n_columns) < n_lines, LINE_SHARE, 1.0)
        penalty = np.diag(strength * shares * float((columns**2).mean()) * n)
        rows, target, weights = columns.reshape(-1, n_columns), readings.reshape(-1), np.ones(n)
        for _ in range(ROUNDS if self.weights == "student" else 1):
            weighed = rows * np.repeat(weights, most)[:, None]
            solved = np.linalg.solve(weighed.T @ rows + penalty, weighed.T @ target)
            squares = ((target - rows @ solved) ** 2).reshape(n, most).sum(axis=1) / counts
            middle = float((weights * squares).mean()) or 1.0
            weights = (DEGREES_OF_FREEDOM + counts) / (
                DEGREES_OF_FREEDOM + counts * squares / middle
            )
        return np.asarray(solved)


def best_strength(
    train: Samples,
    columns: FloatArray,
    solved: Callable[[Any, float], FloatArray],
    strengths: FloatArray,
    seed: int,
    power: float = 2.0,
) -> float:
    """Return the penalty with the least error at left-out poses; of one pose, the middle one.

    Args:
        train: training samples.
        columns: (n, m, n_columns) readings [m] by each coefficient.
        solved: returns the (n_columns,) coefficients of rows and a penalty.
        strengths: penalties to choose from, weakest first.
        seed: seed of the folds.
        power: of the 3-D errors that are summed.
    """
    if len(np.unique(train.pose_id)) < 2:
        return float(strengths[len(strengths) // 2])
    errors = np.zeros(len(strengths))
    for fitted, left_out in folds_of_poses(train, seed):
        for number, strength in enumerate(strengths):
            error = columns[left_out] @ solved(fitted, strength) - train.values[left_out]
            errors[number] += float((np.linalg.norm(error, axis=1) ** power).sum())
    return float(strengths[errors.argmin()])
