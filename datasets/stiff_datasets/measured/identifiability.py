"""Measure how well samples identify each joint's compliance.

The linear virtual joint model, with the Jacobian J at the tool centre point (TCP) and its
translational rows J_v: deflection = sum_i J_v,i (J_i^T w) c_i, linear in the compliances c_i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.types import FloatArray, Robot
from stiff_protocols.kinematics.serial_chain import unit_deflections

TOLERANCE = 1e-6
"""A joint is not excited if it moves the TCP less than this share of the strongest joint's motion.
The share is proportional to the square of the lever: it corresponds to 1 mm compared with 1 m. With
scaled columns it is also the share of the largest singular value below which joints cannot be told
apart."""

DEFLECTION_NOISE = np.sqrt(2.0) * 1e-5
"""m, standard deviation per axis: a tracker that repeats 0.01 mm, read with and without load."""

REFERENCE_COMPLIANCE = 1.0 / 5e4
"""rad/(N m); assumption: order of magnitude of the KR10's A1 to A3. Wrists are softer."""


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Information of samples about each joint's compliance.

    Attributes:
        condition: condition number of the regressor with columns scaled to unit length; infinite
            if a joint cannot be identified.
        log_det: natural logarithm of the determinant of the information matrix of the *relative*
            compliances c_i / c_ref,i; -inf if a joint cannot be identified. The difference between
            two plans of one robot depends neither on the reference nor on the noise.
        relative_standard_error: (n_joints,) standard error of the least squares compliance over
            c_ref,i; infinite if the joint cannot be identified. It is proportional to the noise and
            to 1 / c_ref,i.
        unidentifiable: names of the joints that are hardly excited, or that cannot be told from
            other joints in the samples.
    """

    condition: float
    log_det: float
    relative_standard_error: FloatArray
    unidentifiable: tuple[str, ...]


def regressor(robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the deflection by each joint at unit compliance.

    Args:
        robot: the measured robot.
        q: (n, n_joints) joint positions, rad or m.
        wrench: (n, 6) load at the TCP, force [N] then torque [N m], base frame.

    Returns:
        (n, 3, n_joints), m per rad/(N m) (m per m/N for prismatic joints), base frame.
    """
    return unit_deflections(robot.jacobian(q), wrench)


def identifiability(
    regressors: FloatArray,
    joint_names: Sequence[str],
    *,
    reference_compliance: float | FloatArray = REFERENCE_COMPLIANCE,
) -> Identifiability:
    """Measure how well linear least squares identifies each joint.

    Args:
        regressors: (n, 3, n_joints), from `regressor`.
        joint_names: base to tip.
        reference_compliance: reference of relative errors, rad/(N m) (m/N for prismatic joints);
            one number for all joints or (n_joints,).
    """
    n = len(joint_names)
    matrix = regressors.reshape(-1, n)
    size = np.linalg.norm(matrix, axis=0)
    excited = size > TOLERANCE * size.max()
    _, singular, axes = np.linalg.svd(matrix[:, excited] / size[excited], full_matrices=False)
    is_significant = singular > TOLERANCE * singular.max(initial=0.0)
    # a joint is identifiable if its unit vector lies in the span of the significant directions
    is_identifiable = excited.copy()
    is_identifiable[excited] = (axes[is_significant] ** 2).sum(axis=0) > 1.0 - 1e-6
    variance = np.full(n, np.inf)  # of compliance times column length, at unit noise
    variance[excited] = ((axes[is_significant] / singular[is_significant, None]) ** 2).sum(axis=0)
    signal = size * reference_compliance / DEFLECTION_NOISE  # columns' length, relative compliance
    error = np.full(n, np.inf)
    error[is_identifiable] = np.sqrt(variance[is_identifiable]) / signal[is_identifiable]
    condition, log_det = np.inf, -np.inf
    if is_identifiable.all():
        condition = singular[0] / singular[-1]
        log_det = 2.0 * (np.log(singular).sum() + np.log(signal).sum())
    return Identifiability(
        condition=float(condition),
        log_det=float(log_det),
        relative_standard_error=error,
        unidentifiable=tuple(
            name
            for name, identifiable_joint in zip(joint_names, is_identifiable, strict=True)
            if not identifiable_joint
        ),
    )
