"""Stiffness of the TCP in space: from joint springs, or from any model's predictions.

Joint springs K = diag(k_1 .. k_n) give the TCP the compliance C_X = J K^-1 J^T. Its inverse is the
source paper's Eq. 6, K_X = J^-T K J^-1. The compliance also exists where a spring is rigid and at a
singularity, where the stiffness does not. Rows of J: translation, then rotation, base frame.
"""

from __future__ import annotations

import numpy as np

from stiff_protocols.contract.types import FloatArray

LARGEST_CONDITION = 1e12
"""Of a compliance scaled to a unit diagonal: beyond it, its inverse keeps few correct digits."""


def cartesian_compliance(jacobian: FloatArray, compliance: FloatArray) -> FloatArray:
    """Return C_X = J diag(c) J^T, (n, k, k) in m/N, 1/N and rad/(N m).

    Args:
        jacobian: (n, k, n_joints) rows of the Jacobian at the TCP, m/rad and rad/rad (prismatic
            joints: m/m and rad/m), k = 6 for all of them.
        compliance: (n_joints,) of the joints' springs, rad/(N m) or m/N; zero of a rigid one.
    """
    return np.asarray((jacobian * compliance) @ jacobian.transpose(0, 2, 1))


def cartesian_stiffness(jacobian: FloatArray, compliance: FloatArray) -> FloatArray:
    """Return K_X = J^-T K J^-1, (n, k, k) in N/m, N/rad and N m/rad.

    NaN where the compliance has no inverse: at a singularity, or with a rigid spring.

    Args:
        jacobian: see `cartesian_compliance`.
        compliance: see `cartesian_compliance`.
    """
    soft = cartesian_compliance(jacobian, compliance)
    stiffness = np.full(soft.shape, np.nan)
    size = np.sqrt(np.diagonal(soft, axis1=1, axis2=2))
    regular = (size > 0.0).all(axis=1)
    scale = size[regular, :, None] * size[regular, None, :]
    even = soft[regular] / scale
    invertible = np.linalg.cond(even) < LARGEST_CONDITION
    rows = np.flatnonzero(regular)[invertible]
    stiffness[rows] = np.linalg.inv(even[invertible]) / scale[invertible]
    return stiffness


def largest_compliance(compliance: FloatArray) -> FloatArray:
    """Return (n,) the largest deflection per force of (n, 3, 3) compliances, m/N.

    It is the largest principal compliance: the largest eigenvalue of a symmetric matrix.
    """
    return np.asarray(np.linalg.norm(compliance, ord=2, axis=(1, 2)))
