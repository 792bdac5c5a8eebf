"""All configurations of the arm at the points of a grid, by spreading from point to point.

Random seeds find the configurations at some points of the grid (`inverse.all_configurations`). From
these they spread in waves: a point with fewer configurations than a neighbour is solved again from
the neighbour's. So the edge of the reach is found to one point of the grid.
"""

from __future__ import annotations

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, IntArray
from stiff_protocols.contract.robot import Robot
from stiff_protocols.paths.inverse import LANDMARK_M, all_configurations, different_positions

MOST_WAVES = 2_000


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
