"""Points in a plane of the workspace, and the configuration of the arm at each of them.

Along a path the arm keeps one configuration (`inverse.follow`). Points of a map have no order, so
each has the configuration that is nearest to a training pose of the model. Random seeds find all
configurations at some points (`inverse.all_configurations`). From these they spread in waves: a
point with fewer configurations than a neighbour is solved again from the neighbour's. So the edge
of the reach is found to one point of the grid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, IntArray, TextArray
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.paths.compensation import BEYOND_LIMITS, OUT_OF_REACH
from stiff_protocols.paths.inverse import (
    LANDMARK_M,
    LIMIT_SLACK,
    all_configurations,
    different_positions,
    free_joints,
    is_singular,
    turns_to,
)

PLANES = {"xy": (0, 1, 2), "xz": (0, 2, 1), "yz": (1, 2, 0)}
"""Name of a plane -> numbers of its first axis, its second axis and its normal, base frame."""
REACH_POSES, COARSE_POINTS = 20_000, 12
"""Random joint positions that outline the reach, and points along the longer edge of the coarse
grid that narrows it to the poses of one orientation."""
EDGE_M = 0.01
"""m to which the edges of a region are rounded outward."""
SINGULAR_POSE = "singular"
BLANK_REASONS = (OUT_OF_REACH, BEYOND_LIMITS, SINGULAR_POSE)
"""Reasons why a point has no joint positions."""
SAME_DISTANCE = 1e-6
"""rad or m: configurations whose distances from training differ by less are equally near."""
MOST_WAVES = 2_000


def plane_grid(plane: str, level: float, region: FloatArray, n_points: int) -> FloatArray:
    """Return (n_rows, n_columns, 3) points of a plane, base frame, m.

    Columns run along the plane's first axis, rows along its second one, at about equal distances.

    Args:
        plane: name, of `PLANES`.
        level: place of the plane on its normal, m.
        region: (3, 2) ends along x, y and z, m; those along the normal are not used, and of the
            others one pair may be equal.
        n_points: points along the longer edge, at least 2.
    """
    first, second, normal = PLANES[plane]
    lengths, distance = np.ptp(region, axis=1), point_distance(plane, region, n_points)
    sides = [
        np.linspace(region[axis, 0], region[axis, 1], 1 + round(lengths[axis] / distance))
        for axis in (first, second)
    ]
    points = np.empty((len(sides[1]), len(sides[0]), 3))
    points[..., first], points[..., second] = np.meshgrid(*sides)
    points[..., normal] = level
    return points


def point_distance(plane: str, region: FloatArray, n_points: int) -> float:
    """Return the distance of neighbours on the longer edge of a `plane_grid`, m."""
    first, second, _ = PLANES[plane]
    return float(np.ptp(region[[first, second]], axis=1).max()) / (n_points - 1)


def reach_box(robot: Robot, held: FloatArray | None = None) -> FloatArray:
    """Return (3, 2) ends of the robot's reach along x, y and z, base frame, m.

    They come from random joint positions inside the limits; a joint without limits turns by half
    a turn to either side, or slides by 1 m.

    Args:
        robot: of any number of joints.
        held: (n_joints,) rad or m at which joints are held, NaN for a joint that moves; None: all
            move.
    """
    far = np.where(robot.turns, np.pi, 1.0)
    lower = np.where(np.isfinite(robot.lower), robot.lower, -far)
    upper = np.where(np.isfinite(robot.upper), robot.upper, far)
    q = np.random.default_rng(0).uniform(lower, upper, (REACH_POSES, robot.n_joints))
    if held is not None:
        q = np.where(np.isnan(held), q, held)
    points = robot.tcp_position(q)
    return _rounded_out(np.stack([points.min(axis=0), points.max(axis=0)], axis=1))


def reachable_region(
    plane: str,
    level: float,
    region: FloatArray,
    is_reached: Callable[[FloatArray], BoolArray],
) -> FloatArray:
    """Return the (3, 2) part of a region that a coarse grid reaches, with a margin of one cell.

    If nothing is reached, return the region itself.

    Args:
        plane: see `plane_grid`.
        level: see `plane_grid`.
        region: see `plane_grid`.
        is_reached: returns whether each of (n_rows, n_columns, 3) points, base frame, m, is
            reached.
    """
    points = plane_grid(plane, level, region, COARSE_POINTS)
    reached = points[is_reached(points)]
    if not len(reached):
        return region
    cell = point_distance(plane, region, COARSE_POINTS)
    ends = np.stack([reached.min(axis=0) - cell, reached.max(axis=0) + cell], axis=1)
    return np.clip(_rounded_out(ends), region[:, :1], region[:, 1:])


def _rounded_out(ends: FloatArray) -> FloatArray:
    """Return (3, 2) ends rounded outward to `EDGE_M`."""
    low, high = ends.T / EDGE_M
    return np.stack([np.floor(low), np.ceil(high)], axis=1) * EDGE_M


def reached_poses(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    training_range: TrainingRange,
    held: FloatArray | None = None,
) -> tuple[FloatArray, TextArray]:
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
        (n_rows, n_columns, n_joints) joint positions, rad or m, NaN where there are none; and
        (n_rows, n_columns) reasons for none, of `BLANK_REASONS`, "" for a point that is reached.
    """
    held = np.full(robot.n_joints, np.nan) if held is None else held
    free = free_joints(robot, held)
    q = grid_configurations(robot, position, rotation, held)
    q += np.where(free, turns_to(training_range.middle, robot, q[None]), 0.0)
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
    shape = position.shape[:2]
    return q.reshape(*shape, -1), blank.reshape(shape)


def grid_configurations(
    robot: Robot, position: FloatArray, rotation: FloatArray, held: FloatArray
) -> FloatArray:
    """Return the different joint positions at which the TCP is at each point of a grid.

    Limits of the joints are not looked at, see `inverse.all_configurations`.

    Args:
        robot: of at most six joints that move.
        position: (n_rows, n_columns, 3) of the TCP, base frame, m, at even distances.
        rotation: (3, 3) of the last joint's frame at every point.
        held: (n_joints,) rad or m at which joints are held, NaN for a joint that moves.

    Returns:
        (n_rows * n_columns, m, n_joints) rad or m, m the largest number of configurations of a
        point; rows of NaN where a point has fewer.
    """
    n_rows, n_columns, _ = position.shape
    points, free = position.reshape(-1, 3), np.isnan(held)
    starts = _start_points(position)
    rotations = np.tile(rotation, (len(points), 1, 1))
    first = all_configurations(robot, points[starts], rotations[starts], held)
    q = np.full((len(points), *first.shape[1:]), np.nan)
    q[starts] = first
    counts, tried = _counts(q), np.zeros(len(points), dtype=np.int64)
    for _ in range(MOST_WAVES):
        neighbour = _richest_neighbours(counts.reshape(n_rows, n_columns))
        offered = counts[neighbour]
        rows = np.flatnonzero((offered > counts) & (offered > tried))
        if not len(rows):
            break
        tried[rows] = offered[rows]
        seeds = q[neighbour[rows]].swapaxes(0, 1)  # (m, n, n_joints)
        given: BoolArray = ~np.isnan(seeds[..., 0])
        solved, reached = np.where(given[..., None], seeds, 0.0), np.zeros(given.shape, dtype=bool)
        at = rows[np.nonzero(given)[1]]
        solved[given], reached[given] = robot.inverse(
            points[at], rotations[at], solved[given], free
        )
        earlier_q = q[rows].swapaxes(0, 1)
        is_earlier: BoolArray = ~np.isnan(earlier_q[..., 0])
        all_q = np.concatenate([np.where(is_earlier[..., None], earlier_q, 0.0), solved])
        merged = different_positions(robot, all_q, np.concatenate([is_earlier, reached]), held)
        if (missing := merged.shape[1] - q.shape[1]) > 0:
            q = np.pad(q, ((0, 0), (0, missing), (0, 0)), constant_values=np.nan)
        q[rows] = np.nan
        q[rows, : merged.shape[1]] = merged
        counts[rows] = _counts(merged)
    return q


def _start_points(position: FloatArray) -> IntArray:
    """Return the numbers of points at about `LANDMARK_M` from each other."""
    n_rows, n_columns, _ = position.shape
    numbers = np.arange(n_rows * n_columns).reshape(n_rows, n_columns)
    ends = position[-1, -1] - position[0, 0]
    distance = float(np.abs(ends).max()) / max(n_rows - 1, n_columns - 1, 1)
    stride = max(int(LANDMARK_M / distance), 1) if distance > 0.0 else 1
    row, column = (min(stride // 2, (n - 1) // 2) for n in (n_rows, n_columns))
    return np.asarray(numbers[row::stride, column::stride].ravel())


def _counts(q: FloatArray) -> IntArray:
    """Return (n,) numbers of configurations of (n, m, n_joints) q."""
    return np.asarray((~np.isnan(q[..., 0])).sum(axis=1))


def _richest_neighbours(counts: IntArray) -> IntArray:
    """Return (n,) the number of the neighbour with most configurations of each grid point."""
    numbers = np.arange(counts.size).reshape(counts.shape)
    best, most = numbers.copy(), counts.copy()
    for axis in (0, 1):
        for ours, theirs in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            here = (ours, slice(None)) if axis == 0 else (slice(None), ours)
            there = (theirs, slice(None)) if axis == 0 else (slice(None), theirs)
            richer = counts[there] > most[here]
            best[here] = np.where(richer, numbers[there], best[here])
            most[here] = np.where(richer, counts[there], most[here])
    return np.asarray(best.ravel())
