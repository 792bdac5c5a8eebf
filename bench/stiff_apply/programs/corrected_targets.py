"""Correct a program's targets for the predicted deflection."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from stiff_protocols.contract.types import Deflection, FloatArray, IntArray, Robot, TextArray
from stiff_protocols.paths.compensation import Compensation, compensate
from stiff_protocols.paths.path import ToolPath

BLOCK = 20_000
"""Points per correction step, so that memory is limited for a million targets."""


def without_rows(targets: Compensation, rows: IntArray, reason: str) -> Compensation:
    """Return the targets with the `rows` left unchanged for a reason."""
    problem = targets.problem.astype(object)
    problem[rows] = reason
    return replace(targets, problem=problem.astype(str))


def corrected_rows(targets: Compensation) -> Compensation:
    """Return the targets that were corrected."""
    done = targets.converged
    return Compensation(
        **{item.name: getattr(targets, item.name)[done] for item in fields(targets)}
    )


def correct_targets(
    predict: Deflection,
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    q: FloatArray,
    wrench: FloatArray,
    problem: TextArray,
    *,
    tolerance_m: float,
    max_iterations: int,
) -> Compensation:
    """Return the commands of a program's targets; targets with a problem do not change.

    Args:
        predict: returns the deflections of a model.
        robot: robot of the joint positions.
        position: (n, 3) TCP, base frame, m.
        rotation: (n, 3, 3) orientation of the last joint's frame.
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        problem: (n,) reason why a target is not corrected; "" for corrected targets.
        tolerance_m: see `compensate`, m.
        max_iterations: see `compensate`.
    """
    n = len(position)
    command, joints, deflection, before = (
        position.copy(),
        q.copy(),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
    )
    iterations, contraction = np.zeros(n, dtype=np.int64), np.full(n, np.nan)
    reason = problem.copy()
    driven = np.flatnonzero(problem == "")
    for first in range(0, len(driven), BLOCK):
        rows = driven[first : first + BLOCK]
        path = ToolPath("", position[rows], rotation[rows], wrench[rows])
        compensation = compensate(
            predict, robot, path, q[rows], tolerance_m=tolerance_m, max_iterations=max_iterations
        )
        command[rows], joints[rows] = compensation.position, compensation.q
        deflection[rows], before[rows] = compensation.deflection, compensation.before
        iterations[rows], contraction[rows] = compensation.iterations, compensation.contraction
        reason[rows] = compensation.problem
    return Compensation(
        position, command, joints, deflection, before, iterations, contraction, reason
    )
