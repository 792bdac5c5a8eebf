"""How well samples identify each joint's compliance.

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
"""A joint that moves the TCP less than this share of what the strongest joint does is not
excited: the share goes with the square of the lever, so this is 1 mm beside 1 m. Also the share
of the largest singular value, columns scaled, below which joints cannot be told apart."""

DEFLECTION_NOISE = np.sqrt(2.0) * 1e-5
"""m, standard deviation an axis: a tracker that repeats 0.01 mm, read with and without load."""

REFERENCE_COMPLIANCE = 1.0 / 5e4
"""rad/(N m); assumption, the order of the KR10's A1 to A3. Wrists are softer."""


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What samples tell of each joint's compliance.

    Attributes:
        condition: condition number of the regressor with columns scaled to unit length; infinite
            where a joint cannot be identified.
        log_det: natural logarithm of the determinant of the information matrix of the *relative*
            compliances c_i / c_ref,i; -inf where a joint cannot be identified. Between two plans of
            one robot the difference depends neither on the reference nor on the noise.
        relative_standard_error: (n_joints,) standard error of the least squares compliance over
            c_ref,i; infinite where it cannot be identified. It is proportional to the noise and
            to 1 / c_ref,i.
        unidentifiable: names of the joints that are hardly excited, or that the samples cannot
            tell from other joints.
    """

    condition: float
    log_det: float
    relative_standard_error: FloatArray
    unidentifiable: tuple[str, ...]


def regressor(robot: Robot, q: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the deflection by each joint at unit compliance.

    Args:
        robot: that is measured.
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
    """Say how well samples identify each joint by linear least squares.

    Args:
        regressors: (n, 3, n_joints), as `regressor` gives.
        joint_names: base to tip.
        reference_compliance: that errors are relative to, rad/(N m) (m/N for prismatic joints); one
            for all joints or (n_joints,).
    """
    n = len(joint_names)
    matrix = regressors.reshape(-1, n)
    size = np.linalg.norm(matrix, axis=0)
    excited = size > TOLERANCE * size.max()
    _, singular, axes = np.linalg.svd(matrix[:, excited] / size[excited], full_matrices=False)
    kept = singular > TOLERANCE * singular.max(initial=0.0)
    # a joint is identifiable when its unit vector lies in the span of the kept directions
    known = excited.copy()
    known[excited] = (axes[kept] ** 2).sum(axis=0) > 1.0 - 1e-6
    variance = np.full(n, np.inf)  # of compliance times column length, at unit noise
    variance[excited] = ((axes[kept] / singular[kept, None]) ** 2).sum(axis=0)
    signal = size * reference_compliance / DEFLECTION_NOISE  # columns' length, relative compliance
    error = np.full(n, np.inf)
    error[known] = np.sqrt(variance[known]) / signal[known]
    condition, log_det = np.inf, -np.inf
    if known.all():
        condition = singular[0] / singular[-1]
        log_det = 2.0 * (np.log(singular).sum() + np.log(signal).sum())
    return Identifiability(
        condition=float(condition),
        log_det=float(log_det),
        relative_standard_error=error,
        unidentifiable=tuple(name for name, k in zip(joint_names, known, strict=True) if not k),
    )
