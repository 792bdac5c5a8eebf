"""Commands that correct a path for a model's predicted deflection.

The loaded tool is at ``p_cmd + d(q(p_cmd), w)``. Its target is p, so the command is the fixed point
of ``p_cmd = p - d(q(p_cmd), w)``, iterated for all points at once. A deflection hardly changes over
its own length, so each step is about a hundredth of the previous step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_protocols.contract.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    TextArray,
    frozen_array,
)
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.types import Deflection
from stiff_protocols.paths.inverse import free_joints
from stiff_protocols.paths.path import ToolPath

TOLERANCE_M, MAX_ITERATIONS = 1e-6, 20

NOT_CONVERGED, OUT_OF_REACH, BEYOND_LIMITS = "not converged", "out of reach", "joint limits"
"""Why a row is left uncorrected."""


@dataclass(frozen=True, eq=False, repr=False)
class Compensation(BriefFields):
    """A corrected path; uncorrected rows keep their original commands and deflections.

    Attributes:
        target: (n, 3) points of the path, base frame, m.
        position: (n, 3) commanded TCP, base frame, m.
        q: (n, n_joints) commanded joint positions, rad or m.
        deflection: (n, 3) predicted at the command, base frame, m.
        before: (n, 3) predicted at the uncorrected pose, base frame, m.
        iterations: (n,) predictions of each row.
        contraction: (n,) ratio of the last two steps; below 1 they shrink. NaN where the first one
            was within the tolerance.
        problem: (n,) why a row was not corrected: one of the words above; "" if it was.
    """

    target: FloatArray
    position: FloatArray
    q: FloatArray
    deflection: FloatArray
    before: FloatArray
    iterations: IntArray
    contraction: FloatArray
    problem: TextArray

    @property
    def removed(self) -> FloatArray:
        """(n, 3) predicted deflection that the command removes, base frame, m."""
        return self.target - self.position

    @property
    def residual(self) -> FloatArray:
        """(n, 3) from the target point to the predicted position of the loaded tool, base frame, m.

        It measures the convergence of the iteration, not the robot's accuracy.
        """
        return self.position + self.deflection - self.target

    @property
    def converged(self) -> BoolArray:
        """(n,) true for corrected rows."""
        return np.asarray(self.problem == "")


def compensate(
    predict: Deflection,
    robot: Robot,
    path: ToolPath,
    q: FloatArray,
    *,
    held: FloatArray | None = None,
    tolerance_m: float = TOLERANCE_M,
    max_iterations: int = MAX_ITERATIONS,
) -> Compensation:
    """Return the commands with which the predicted loaded tool is on the path.

    Orientation and configuration are the same as for `q`.

    Args:
        predict: function that returns deflections of a model.
        robot: robot with any number of joints.
        path: target path with its loads.
        q: (n, n_joints) joint positions at the points of the path, rad or m (`inverse.follow`).
        held: see `inverse.free_joints`; a held joint keeps its position in `q`.
        tolerance_m: largest remaining distance to the target point, m.
        max_iterations: most predictions per row.

    Raises:
        DataError: more than six joints move, or `predict` returns another shape or a number that is
            not finite.
        ConfigError: the tolerance or the number of iterations is not above zero.
    """
    if not (tolerance_m > 0.0 and max_iterations > 0):
        raise ConfigError(
            f"tolerance {tolerance_m:g} m, {max_iterations} iterations (valid: above 0)"
        )
    free = free_joints(robot, held)
    n = len(path)
    path_q = frozen_array(robot.checked_positions(q), "q", (n, robot.n_joints))
    command, position = path_q.copy(), path.position.copy()
    deflection, before = np.zeros((n, 3)), np.zeros((n, 3))
    iterations, contraction = np.zeros(n, dtype=np.int64), np.full(n, np.nan)
    step = np.full(n, np.nan)
    problem = np.full(n, NOT_CONVERGED, dtype=f"<U{len(NOT_CONVERGED)}")
    rows = np.arange(n)
    for iteration in range(max_iterations):
        bent = np.asarray(predict(command[rows], path.wrench[rows]), dtype=np.float64)
        deflection[rows] = frozen_array(bent, "the prediction", (len(rows), 3))
        if iteration == 0:
            before = deflection.copy()
        iterations[rows] += 1
        off = path.position[rows] - deflection[rows] - position[rows]  # the step to be made
        length = np.linalg.norm(off, axis=1)
        if iteration > 0:
            contraction[rows] = length / step[rows]
        step[rows] = length
        done = length <= tolerance_m
        problem[rows[done]] = ""
        goes_on = ~done & ~(contraction[rows] >= 1.0)  # a step that grows leads nowhere
        rows, off = rows[goes_on], off[goes_on]
        if not len(rows) or iteration == max_iterations - 1:
            break
        position[rows] += off
        command[rows], reached = robot.inverse(
            position[rows], path.rotation[rows], command[rows], free
        )
        problem[rows[~reached]] = OUT_OF_REACH
        rows = rows[reached]
    beyond = (command < np.minimum(robot.lower, path_q)) | (
        command > np.maximum(robot.upper, path_q)
    )
    problem[(problem == "") & beyond.any(axis=1)] = BEYOND_LIMITS
    uncorrected = problem != ""
    position[uncorrected], command[uncorrected] = path.position[uncorrected], path_q[uncorrected]
    deflection[uncorrected] = before[uncorrected]
    return Compensation(
        path.position, position, command, deflection, before, iterations, contraction, problem
    )
