"""Deflection of linear joint springs, ``d = J_v diag(c) J^T w``, without the Jacobian.

For many samples at once, and for all wrenches at a pose; both are `stiff_models.physics.chain`'s
closed form.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stiff_models.physics.chain import Chain
from stiff_models.physics.kinematics import PROGRAMS_KEPT
from stiff_models.physics.straight_line import Program, half_angle, tape_with
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, Robot


def joint_deflection(
    robot: Robot, compliance: FloatArray, q: FloatArray, wrench: FloatArray
) -> FloatArray:
    """Return ``J_v diag(c) J^T w``, the deflection of joint springs, without the Jacobian.

    Args:
        robot: the serial chain.
        compliance: (n_joints,) rad/(N m) or m/N.
        q: (n, n_joints) joint positions, rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.

    Returns:
        (n, 3) m, base frame.

    Raises:
        DataError: a shape is another one, or a compliance is not finite.
    """
    q = robot.checked_positions(q)
    wrench, springs = np.asarray(wrench, dtype=np.float64), _checked_springs(robot, compliance)
    if wrench.shape != (len(q), 6):
        raise DataError(f"wrench has shape {wrench.shape}, expected ({len(q)}, 6)")
    deflection = np.empty((len(q), 3))
    _deflection_program(robot).run([q, wrench], deflection.T, springs)
    return deflection


def compliance_matrix(robot: Robot, compliance: FloatArray, q: FloatArray) -> FloatArray:
    """Return ``J_v diag(c) J^T``: how the TCP gives way to each component of a wrench.

    Args:
        robot: the serial chain.
        compliance: (n_joints,) rad/(N m) or m/N.
        q: (n, n_joints) joint positions, rad or m.

    Returns:
        (n, 3, 6) m/N, then m/(N m), base frame.

    Raises:
        DataError: a shape is another one, or a compliance is not finite.
    """
    q = robot.checked_positions(q)
    matrix = np.empty((len(q), 18))
    _compliance_program(robot).run([q], matrix.T, _checked_springs(robot, compliance))
    return matrix.reshape(-1, 3, 6)


@lru_cache(PROGRAMS_KEPT)
def _deflection_program(robot: Robot) -> Program:
    tape, (q, wrench, compliance) = tape_with(robot.n_joints, 6, robot.n_joints)
    return Program.of(tape, Chain.of(robot).deflection(compliance, q, wrench, half_angle))


@lru_cache(PROGRAMS_KEPT)
def _compliance_program(robot: Robot) -> Program:
    tape, (q, compliance) = tape_with(robot.n_joints, robot.n_joints)
    matrix = Chain.of(robot).compliance_matrix(compliance, q, half_angle)
    return Program.of(tape, [component for row in matrix for component in row])


def _checked_springs(robot: Robot, compliance: FloatArray) -> list[float]:
    compliance = np.asarray(compliance, dtype=np.float64)
    if compliance.shape != (robot.n_joints,):
        raise DataError(f"compliance has shape {compliance.shape}, expected ({robot.n_joints},)")
    if not np.isfinite(compliance).all():
        raise DataError(f"compliance is {compliance.tolist()}, expected finite numbers")
    values: list[float] = compliance.tolist()
    return values
