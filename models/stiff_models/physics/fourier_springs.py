"""Joint springs whose compliance is a Fourier series of the shoulder's and the elbow's angle.

The posture of the second and third joint decides how the weights and links load every gear and
bearing. Here the compliance of joint j depends on these angles a and b:

    d = sum_j J_v,j (J_j^T w) c_j(a, b),    c_j(a, b) = sum_kl x_jkl g_k(a) g_l(b), x >= 0
    g(a) = 1, 1 + cos a, 1 - cos a, 1 + sin a, 1 - sin a

which is a Fourier series of first order in each angle that is nowhere negative. The idea of a
Fourier series is from arXiv 2510.19962, 2025. The deflection is linear in x; ridge regression keeps
x small in units of a typical compliance, and left-out poses choose its strength. SI: rad, N, N m,
m.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from stiff_models.fitted_model import FittedModel
from stiff_models.physics.curve_springs import LINE_SHARE, best_strength
from stiff_models.physics.vjm import compliance_regressor, warn_unexplained
from stiff_protocols.contract.errors import ModelError
from stiff_protocols.contract.types import FloatArray, Robot, Samples
from stiff_protocols.kinematics.serial_chain import AT_TCP
from stiff_protocols.springs.identification import typical_joints
from stiff_protocols.springs.unseen_joints import unseen_columns

SHOULDER_AND_ELBOW = slice(1, 3)
"""Second and third joint; a prismatic joint, or one that a robot does not have, has no angle."""
STRENGTHS = np.geomspace(1e-6, 1e2, 9)
"""Penalties to choose from, in units of the mean square of a column."""


@dataclass(kw_only=True, eq=False, repr=False)
class FourierSprings(FittedModel):
    """One spring per joint; its compliance depends on the shoulder's and the elbow's angle.

    Attributes:
        coefficients_: (n_joints, n_terms) x, rad/(N m) or m/N.
        diagnostics_: number of coefficients that are not zero, and the penalty.
    """

    takes_directions: ClassVar[bool] = True
    takes_levers: ClassVar[bool] = True

    def _fit(self, train: Samples, robot: Robot, validation: Samples | None, seed: int) -> None:
        springs = compliance_regressor(robot, train.q, train.wrench, train.levers)
        if not springs.any():
            raise ModelError("no joint spring can be identified: no wrench turns any joint")
        typical = typical_joints(robot)
        terms = _terms(robot, train.q)
        columns = ((springs * typical)[..., None] * terms[:, None, None]).reshape(len(train), 3, -1)
        columns, readings = train.read(columns), train.values
        shares = np.ones((robot.n_joints, terms.shape[1]))
        shares[:, 0] = LINE_SHARE  # of the constant term

        def solved(rows: Any, strength: float) -> FloatArray:
            return _solved(columns[rows], readings[rows], strength * shares.ravel())

        strength = best_strength(train, columns, solved, STRENGTHS, seed)
        of_typical = solved(slice(None), strength).reshape(shares.shape)
        moved = train.read(springs * typical)
        explained = moved.sum(axis=2)
        factor = float((explained * readings).sum() / (explained**2).sum())
        # of joints that no reading shows: by their sizes, at every angle
        of_typical[unseen_columns(moved), 0] = max(factor, 0.0)
        self.coefficients_ = of_typical * typical[:, None]
        self.diagnostics_ = {
            "coefficients": float(np.count_nonzero(of_typical)),
            "penalty": strength,
        }
        warn_unexplained(self.coefficients_, train)

    def compliance(self, q: FloatArray) -> FloatArray:
        """Return the (n, n_joints) compliances [rad/(N m) or m/N] at (n, n_joints) positions."""
        return np.asarray(_terms(self.robot_, q) @ self.coefficients_.T)

    def predict_at_point(self, q: FloatArray, wrench: FloatArray, point: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection [m] of a point of the tool; see `StiffnessModel`."""
        return self._deflection(replace(self.robot_, tcp=point), *self._checked(q, wrench))

    def predict_reading(
        self, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        """Return the (n, 3) deflection [m] of the points of levers; see `StiffnessModel`."""
        return self._deflection(self.robot_, *self._checked(q, wrench), levers)

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        return self._deflection(self.robot_, q, wrench)

    def _deflection(
        self, robot: Robot, q: FloatArray, wrench: FloatArray, levers: FloatArray = AT_TCP
    ) -> FloatArray:
        springs = compliance_regressor(robot, q, wrench, levers)
        return np.asarray((springs @ self.compliance(q)[..., None])[..., 0])


def _terms(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the (n, n_terms) products g_k(a) g_l(b), which are >= 0; the first is 1."""
    terms = np.ones((len(q), 1))
    for angle in q[:, SHOULDER_AND_ELBOW][:, robot.turns[SHOULDER_AND_ELBOW]].T:
        waves = np.stack([np.cos(angle), -np.cos(angle), np.sin(angle), -np.sin(angle)], axis=1)
        of_angle = np.hstack([np.ones((len(q), 1)), 1.0 + waves])
        terms = (terms[:, :, None] * of_angle[:, None]).reshape(len(q), -1)
    return terms


def _solved(columns: FloatArray, readings: FloatArray, penalties: FloatArray) -> FloatArray:
    """Return the (n_columns,) coefficients >= 0 of (n, m, n_columns) and (n, m) readings."""
    rows, target = columns.reshape(-1, columns.shape[2]), readings.reshape(-1)
    # of joints that no wrench turns, too, the normal equations stay positive definite
    penalty = penalties * float((rows**2).mean()) * len(columns)
    factor = cholesky(rows.T @ rows + np.diag(penalty))
    return np.asarray(nnls(factor, solve_triangular(factor, rows.T @ target, trans="T"))[0])
