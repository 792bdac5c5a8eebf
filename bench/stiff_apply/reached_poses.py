"""Joint positions over a grid of points: one configuration per point, or the reason for none.

Along a path the arm keeps one configuration (`inverse.follow`). Points of a map have no order, so
each has the configuration that is nearest to a training pose of the model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiff_apply.grid_configurations import grid_configurations
from stiff_protocols.contract.arrays import BoolArray, FloatArray, TextArray
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.paths.compensation import BEYOND_LIMITS, OUT_OF_REACH
from stiff_protocols.paths.inverse import (
    LIMIT_SLACK,
    free_joints,
    is_singular,
    turns_to,
)

SINGULAR_POSE = "singular"
BLANK_REASONS = (OUT_OF_REACH, BEYOND_LIMITS, SINGULAR_POSE)
"""Reasons why a point has no joint positions."""
SAME_DISTANCE = 1e-6
"""rad or m: configurations whose distances from training differ by less are equally near."""


@dataclass(frozen=True, eq=False)
class ReachedPoses:
    """Joint positions at n points.

    Attributes:
        q: (n, n_joints) rad or m; NaN where there are none.
        blank: (n,) reason why there are none, of `BLANK_REASONS`; "" for a point
            that is reached.
    """

    q: FloatArray
    blank: TextArray

    @property
    def reached(self) -> BoolArray:
        """(n,) whether the point has joint positions."""
        return np.asarray(self.blank == "")


def reached_poses(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    training_range: TrainingRange,
    held: FloatArray | None = None,
) -> ReachedPoses:
    """Return the configuration at each grid point whose joints are nearest to a training pose.

    Only configurations inside the joint limits count; joints turn by whole turns towards the
    middle of the training range. A point is blank where the nearest configuration is singular
    (`inverse.SINGULAR`): another one there would be an island in the map.

    Args:
        robot: of at most six joints that move.
        position: (n_rows, n_columns, 3) of the TCP, base frame, m, at even distances.
        rotation: (3, 3) of the last joint's frame at every point.
        training_range: of the model.
        held: see `inverse.free_joints`.

    Returns:
        The n = n_rows * n_columns points, row by row.
    """
    held = np.full(robot.n_joints, np.nan) if held is None else held
    free = free_joints(robot, held)
    q = grid_configurations(robot, position, rotation, held)
    middle = 0.5 * (training_range.lower + training_range.upper)
    q += np.where(free, turns_to(middle, robot, q[None]), 0.0)
    low, high = robot.lower - LIMIT_SLACK, robot.upper + LIMIT_SLACK
    inside: BoolArray = np.asarray(((q >= low) & (q <= high)).all(axis=2))  # not those of NaN
    distance = np.full(inside.shape, np.inf)
    distance[inside] = training_range.pose_distance(q[inside])
    nearest = np.argmin((distance / SAME_DISTANCE).round(), axis=1)
    q = q[np.arange(len(q)), nearest]
    has_any = ~np.isnan(q).any(axis=1)
    blank = np.where(has_any, BEYOND_LIMITS, OUT_OF_REACH)
    rows = np.flatnonzero(inside.any(axis=1))
    blank[rows] = np.where(is_singular(robot, q[rows], free), SINGULAR_POSE, "")
    q[blank != ""] = np.nan
    return ReachedPoses(q, blank)
