"""Correct a program's targets for the predicted deflection, optionally with points between."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from stiff_datasets.programs.program_file import RobotProgram
from stiff_protocols.contract.types import (
    BoolArray,
    Deflection,
    FloatArray,
    IntArray,
    Robot,
    TextArray,
)
from stiff_protocols.paths.compensation import Compensation, compensate
from stiff_protocols.paths.path import ToolPath

BLOCK = 20_000
"""Points per correction step, so that memory is limited for a million targets."""
SHARES = (0.25, 0.5, 0.75)
"""Shares of a straight motion at which the error between the corrected ends is predicted."""
MAX_SEGMENTS = 2000
"""Largest number of straight motions for this prediction, the longest first."""
NOT_REACHED = "out of reach between this target and the one before"


@dataclass(frozen=True, eq=False)
class CorrectedTargets:
    """Points of a program: its targets, and points on the way to them.

    Attributes:
        row: (n,) number of the motion's target.
        share: (n,) share of the path from the previous target; 1 at the target itself.
        rotation: (n, 3, 3) orientation of the last joint's frame.
        wrench: (n, 6) N and N m at the TCP, base frame.
        compensation: points, commands and predicted deflections.
        is_straight: (n,) true if the tool moves to the point along a straight line.
    """

    row: IntArray
    share: FloatArray
    rotation: FloatArray
    wrench: FloatArray
    compensation: Compensation
    is_straight: BoolArray

    @property
    def is_target(self) -> BoolArray:
        """(n,) true if the point is a target of the program, not a point between targets."""
        return np.asarray(self.share == 1.0)

    def without(self, rows: IntArray, reason: str) -> CorrectedTargets:
        """Return the targets with the `rows` left unchanged for a reason."""
        problem = self.compensation.problem.astype(object)
        problem[np.flatnonzero(self.is_target)[rows]] = reason
        return replace(self, compensation=replace(self.compensation, problem=problem.astype(str)))

    @property
    def at_targets(self) -> Compensation:
        """The program's targets, without points between."""
        return _part(self.compensation, self.is_target)

    @property
    def corrected(self) -> Compensation:
        """The program's targets that were corrected."""
        return _part(self.compensation, self.is_target & self.compensation.converged)


def _part(compensation: Compensation, rows: BoolArray) -> Compensation:
    values = {item.name: getattr(compensation, item.name)[rows] for item in fields(compensation)}
    return Compensation(**values)


def correct_targets(
    predict: Deflection,
    robot: Robot,
    program: RobotProgram,
    position: FloatArray,
    rotation: FloatArray,
    q: FloatArray,
    wrench: FloatArray,
    problem: TextArray,
    *,
    every_m: float | None,
    tolerance_m: float,
    max_iterations: int,
) -> CorrectedTargets:
    """Return the commands of a program's targets.

    Args:
        predict: returns the deflections of a model.
        robot: robot of the joint positions.
        program: the targets.
        position: (n, 3) TCP, base frame, m.
        rotation: (n, 3, 3) orientation of the last joint's frame.
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        problem: (n,) reason why a target is not corrected; "" for corrected targets.
        every_m: largest distance of points inserted in straight motions, m; None: no points.
        tolerance_m: see `compensate`, m.
        max_iterations: see `compensate`.
    """
    n = len(program)
    driven = problem == ""
    straight = np.zeros(n, dtype=bool)
    straight[1:] = program.is_linear[1:] & program.follows[1:] & driven[1:] & driven[:-1]
    count = np.ones(n, dtype=np.int64)
    if every_m is not None:  # a motion to joint angles cannot be copied with a pose
        length = np.r_[0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)]
        parts = np.ceil(np.nan_to_num(length) / every_m - 1e-9).astype(np.int64)
        count = np.where(straight & ~program.has_joints, np.maximum(parts, 1), 1)
    row = np.repeat(np.arange(n), count)
    part = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 1
    share = part / count[row]
    point, turn, joints, reason = position[row], rotation[row], q[row], problem[row]
    between = np.flatnonzero(share < 1.0)
    if len(between):
        point[between], turn[between], joints[between], reached = _interpolated_points(
            robot, position, rotation, q, row[between], share[between]
        )
        lost = {*row[between[~reached]].tolist()}
        kept_points = (share == 1.0) | ~np.isin(row, [*lost])
        row, share, point, turn = (
            row[kept_points],
            share[kept_points],
            point[kept_points],
            turn[kept_points],
        )
        joints, reason = joints[kept_points], reason[kept_points]
    compensation = _compensated(
        predict, robot, point, turn, joints, wrench[row], reason, tolerance_m, max_iterations
    )
    return CorrectedTargets(row, share, turn, wrench[row], compensation, straight[row])


def _interpolated_points(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    q: FloatArray,
    row: IntArray,
    share: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return positions, rotations and joints between rows, and true if reached."""
    from scipy.spatial.transform import Rotation

    part = share[:, None]
    point = (1.0 - part) * position[row - 1] + part * position[row]
    turn = rotation[row - 1].transpose(0, 2, 1) @ rotation[row]
    vector = share[:, None] * Rotation.from_matrix(turn).as_rotvec()
    turned = rotation[row - 1] @ Rotation.from_rotvec(vector).as_matrix()
    seed = (1.0 - part) * q[row - 1] + part * q[row]
    joints, reached = robot.inverse(point, turned, seed)
    return point, turned, joints, reached


def _compensated(
    predict: Deflection,
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    q: FloatArray,
    wrench: FloatArray,
    problem: TextArray,
    tolerance_m: float,
    max_iterations: int,
) -> Compensation:
    """Return the commands of points, block by block; points with a problem do not change."""
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


def errors_between(
    predict: Deflection, robot: Robot, targets: CorrectedTargets
) -> tuple[IntArray, FloatArray]:
    """Predict the errors on straight lines between corrected points.

    Only the ends of a motion are corrected. Between them the command is a straight line, but the
    deflection is not. Only the longest `MAX_SEGMENTS` motions are evaluated.

    Returns:
        (m,) numbers of the motions' end points, and (m,) largest error of each motion, m.
    """
    compensation = targets.compensation
    done = compensation.problem == ""
    ends = np.flatnonzero(targets.is_straight[1:] & done[1:] & done[:-1]) + 1
    length = np.linalg.norm(compensation.target[ends] - compensation.target[ends - 1], axis=1)
    ends = np.sort(ends[np.argsort(-length, kind="stable")[:MAX_SEGMENTS]])
    if not len(ends):
        return ends, np.empty(0)
    row, share = np.repeat(ends, len(SHARES)), np.tile(SHARES, len(ends))
    point, _, q, reached = _interpolated_points(
        robot, compensation.position, targets.rotation, compensation.q, row, share
    )
    part = share[:, None]
    target_points = (1.0 - part) * compensation.target[row - 1] + part * compensation.target[row]
    error_m = np.linalg.norm(point + predict(q, targets.wrench[row]) - target_points, axis=1)
    return ends, np.where(reached, error_m, np.nan).reshape(-1, len(SHARES)).max(axis=1)
