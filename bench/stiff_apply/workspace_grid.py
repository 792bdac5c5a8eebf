"""Grids of points in planes of the workspace, and the part of a plane that a robot can reach."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray
from stiff_protocols.contract.robot import Robot

PLANES = {"xy": (0, 1, 2), "xz": (0, 2, 1), "yz": (1, 2, 0)}
"""Name of a plane -> numbers of its first axis, its second axis and its normal, base frame."""
REACH_POSES, COARSE_POINTS = 20_000, 12
"""Random joint positions that outline the reach, and points along the longer edge of the coarse
grid that narrows it to the poses of one orientation."""
EDGE_M = 0.01
"""m to which the edges of a region are rounded outward."""


def plane_grid(plane: str, levels: FloatArray, region: FloatArray, n_points: int) -> FloatArray:
    """Return (n_planes, n_rows, n_columns, 3) points of parallel planes, base frame, m.

    Columns run along the plane's first axis, rows along its second one, at about equal distances.

    Args:
        plane: name, of `PLANES`.
        levels: (n_planes,) place of each plane on its normal, m.
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
    points = np.empty((len(levels), len(sides[1]), len(sides[0]), 3))
    points[..., first], points[..., second] = np.meshgrid(*sides)
    points[..., normal] = levels[:, None, None]
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
    levels: FloatArray,
    region: FloatArray,
    is_reached: Callable[[FloatArray], BoolArray],
) -> FloatArray:
    """Return the (3, 2) part of a region that a coarse grid reaches, with a margin of one cell.

    If nothing is reached, return the region itself.

    Args:
        plane: see `plane_grid`.
        levels: see `plane_grid`.
        region: see `plane_grid`.
        is_reached: returns whether each of (n_rows, n_columns, 3) points, base frame, m, is
            reached.
    """
    points = plane_grid(plane, levels, region, COARSE_POINTS)
    reached = np.concatenate([grid[is_reached(grid)] for grid in points])
    if not len(reached):
        return region
    cell = point_distance(plane, region, COARSE_POINTS)
    ends = np.stack([reached.min(axis=0) - cell, reached.max(axis=0) + cell], axis=1)
    return np.clip(_rounded_out(ends), region[:, :1], region[:, 1:])


def _rounded_out(ends: FloatArray) -> FloatArray:
    """Return (3, 2) ends rounded outward to `EDGE_M`."""
    low, high = ends.T / EDGE_M
    return np.stack([np.floor(low), np.ceil(high)], axis=1) * EDGE_M
