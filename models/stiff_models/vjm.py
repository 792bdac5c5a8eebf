"""The linear virtual joint model (VJM): one torsion spring a joint.

With the Jacobian J at the TCP and its translational rows J_v, the deflection under a wrench w is
``d = J_v K^-1 J^T w = sum_i J_v,i (J_i^T w) c_i``, which is linear in the compliances
``c_i = 1/k_i``. They are identified by least squares with ``c >= 0``.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.optimize import nnls
from sklearn.base import BaseEstimator

from stiff_models.kinematics import jacobian
from stiff_protocols.errors import ModelError, NotFittedError, StiffBenchWarning
from stiff_protocols.types import FloatArray, Robot, Samples

RANK_TOLERANCE = 1e-8
"""Singular values of the column-scaled regressor below this share of the largest count as zero:
far above rounding, far below what a measurement with instrument noise could resolve."""


@dataclass(frozen=True, eq=False)
class IdentifiedJoints:
    """Joint springs identified from samples.

    Attributes:
        names: joint names, base to tip.
        compliance: (n_joints,) rad/(N m), non-negative. Of joints that the data cannot tell apart
            only the sum of their effects on the samples means anything.
        stiffness: (n_joints,) N m/rad; infinite for a joint found rigid, NaN where the data
            cannot tell.
        standard_error: (n_joints,) of the stiffness, N m/rad, from the residual variance; NaN
            where there is none (not identifiable, rigid, or no degree of freedom left).
        rank: rank of the regressor.
        condition: condition number of the column-scaled regressor over its identifiable part.
        unidentifiable: names of the joints that the data cannot identify.
    """

    names: tuple[str, ...]
    compliance: FloatArray
    stiffness: FloatArray
    standard_error: FloatArray
    rank: int
    condition: float
    unidentifiable: tuple[str, ...]


def compliance_regressor(robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the (n, 3, n_joints) deflection [m] by each joint at unit compliance."""
    rows = jacobian(robot, q)  # (n, 6, n_joints)
    torque = np.einsum("nki,nk->ni", rows, wrench)  # (n, n_joints)
    return np.asarray(rows[:, :3] * torque[:, None, :])


def identify_joints(robot: Robot, samples: Samples) -> IdentifiedJoints:
    """Identify one spring a joint by non-negative least squares.

    Raises:
        ModelError: no joint can be identified (for example, every wrench is zero).
    """
    regressor = compliance_regressor(robot, samples.q, samples.wrench)
    matrix, target = regressor.reshape(-1, robot.n_joints), samples.deflection.reshape(-1)
    size = np.linalg.norm(matrix, axis=0)
    if not size.any():
        raise ModelError("no joint spring can be identified: no wrench turns any joint")
    turned = size > RANK_TOLERANCE * size.max()  # False: no sample bends this joint
    scaled = matrix[:, turned] / size[turned]
    _, singular, axes = np.linalg.svd(scaled, full_matrices=False)
    kept = singular > RANK_TOLERANCE * singular[0]
    # a joint is identifiable when its unit vector lies in the span of the kept directions
    known = turned.copy()
    known[turned] = (axes[kept] ** 2).sum(axis=0) > 1.0 - 1e-6
    # Joints that the data cannot tell apart stay in: left out, the others would absorb their share.
    compliance = np.zeros(robot.n_joints)
    compliance[turned] = nnls(scaled, target)[0] / size[turned]
    with np.errstate(divide="ignore"):
        stiffness = np.where(known, 1.0 / compliance, np.nan)
    return IdentifiedJoints(
        names=robot.joint_names,
        compliance=compliance,
        stiffness=stiffness,
        standard_error=np.where(known, _standard_error(matrix, target, compliance), np.nan),
        rank=int(kept.sum()),
        condition=float(singular[0] / singular[kept][-1]),
        unidentifiable=tuple(
            name
            for name, identified in zip(robot.joint_names, known, strict=True)
            if not identified
        ),
    )


def _standard_error(matrix: FloatArray, target: FloatArray, compliance: FloatArray) -> FloatArray:
    """Return the (n_joints,) standard errors of the stiffnesses; NaN where there is none."""
    error = np.full(len(compliance), np.nan)
    free = np.flatnonzero(compliance > 0.0)
    degrees = len(target) - len(free)
    if degrees > 0 and len(free):
        residual = target - matrix @ compliance
        size = np.linalg.norm(matrix[:, free], axis=0)
        scaled = matrix[:, free] / size
        variance = np.diag(np.linalg.pinv(scaled.T @ scaled)) * (residual @ residual) / degrees
        # first order: dk = dc / c^2
        error[free] = np.sqrt(variance) / size / compliance[free] ** 2
    return error


class VirtualJointModel(BaseEstimator):  # type: ignore[misc]
    """The linear VJM as a model.

    Attributes:
        robot_: the robot it was fitted for; `predict` is valid for that robot alone.
        joints_: what was identified.
        diagnostics_: stiffnesses, rank and condition number, by name and unit.
    """

    robot_: Robot
    joints_: IdentifiedJoints
    diagnostics_: dict[str, float]

    def fit(
        self,
        train: Samples,
        *,
        robot: Robot,
        validation: Samples | None = None,
        seed: int = 0,
    ) -> Self:
        """Identify the springs on `train`; `validation` and `seed` are not used.

        Raises:
            ModelError: no joint can be identified.
        """
        self.joints_ = identify_joints(robot, train)
        self.robot_ = robot
        self.diagnostics_ = _diagnostics(self.joints_, robot)
        warn_unidentifiable(self.joints_)
        if not self.joints_.compliance.any():
            warnings.warn(
                "no joint spring explains any of the deflections: is the sign or the frame of the "
                "wrench wrong? `bench data validate` compares them",
                StiffBenchWarning,
                stacklevel=2,
            )
        return self

    def predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection, m, base frame.

        Raises:
            NotFittedError: `fit` was not called.
        """
        if not hasattr(self, "joints_"):
            raise NotFittedError("VirtualJointModel: call fit before predict")
        return joint_deflection(self.robot_, self.joints_.compliance, q, wrench)


def _diagnostics(joints: IdentifiedJoints, robot: Robot) -> dict[str, float]:
    named: dict[str, float] = {}
    for i, name in enumerate(joints.names):
        unit = "Nm/rad" if robot.joint_types[i] == "revolute" else "N/m"
        named[f"stiffness {name} [{unit}]"] = float(joints.stiffness[i])
        named[f"standard error {name} [{unit}]"] = float(joints.standard_error[i])
    return named | {"rank": float(joints.rank), "condition number": joints.condition}


def joint_deflection(
    robot: Robot, compliance: FloatArray, q: FloatArray, wrench: FloatArray
) -> FloatArray:
    """Return the (n, 3) deflection [m] of springs with `compliance` (n_joints,) rad/(N m)."""
    return np.asarray(compliance_regressor(robot, q, wrench) @ compliance)


def warn_unidentifiable(joints: IdentifiedJoints) -> None:
    """Warn which joints the data cannot identify."""
    if joints.unidentifiable:
        warnings.warn(
            f"joint stiffness not identifiable from the training samples: "
            f"{', '.join(joints.unidentifiable)} (regressor rank {joints.rank} of "
            f"{len(joints.names)}); no value is given, predictions use their joint effect alone",
            StiffBenchWarning,
            stacklevel=3,
        )
