"""Poses a robot can take: inside its joint limits, clear of its own base and of the ground.

Both distances are checked for centre lines from the elbow on (joint 3, of an arm of seven joints
joint 4): the straight lines between joint origins, and on to the tool centre point (TCP). Nothing
else is checked: neither the shape of links and tool, nor the upper arm, nor what stands around the
robot.

Prismatic joints at the base (a track, a lift) carry the whole arm: its joints are counted from the
first one that turns, and its base column stands below the carriage. With fewer than three joints
behind them, only the TCP is checked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import BoolArray, FloatArray, Robot

CLEARANCE = 0.2
"""m, default distance of the arm's centre line to the base column's. The paper's 151 poses of the
KR10 keep 0.22 m. Larger robots need more."""

LOWEST_HEIGHT = 0.15
"""m above the mounting plane (z = 0 of the base frame), for the arm's centre line: room for the
thickness of forearm and tool. The paper's 151 poses keep 0.20 m."""

DRAWS_PER_CANDIDATE = 50
"""Random poses drawn at most for each candidate asked for."""


def reachable_poses(
    robot: Robot,
    n: int,
    rng: np.random.Generator,
    clearance: float = CLEARANCE,
    at_zero: Sequence[int] = (),
) -> FloatArray:
    """Return (n, n_joints) random poses inside the limits that keep the clearances, rad or m.

    Joint angles are uniform inside the limits. A revolute joint that turns further than once is
    drawn from the 360 deg about the middle of its limits (+-180 deg if it has none): no pose is
    lost, and cables are twisted least.

    Args:
        robot: whose poses they are.
        n: how many.
        rng: draws them.
        clearance: smallest distance of the arm from the base column, m.
        at_zero: columns of joints that stay at zero.

    Raises:
        ConfigError: `clearance` is out of range, or too few random poses keep the clearances.
    """
    if not (np.isfinite(clearance) and clearance >= 0.0):
        raise ConfigError(f"clearance is {clearance:g}, expected m, 0 or more")
    lower, upper = _drawn_ranges(robot)
    found = np.empty((0, len(lower)))
    for _ in range(DRAWS_PER_CANDIDATE):
        q = rng.uniform(lower, upper, size=(n, len(lower)))
        q[:, at_zero] = 0.0
        found = np.concatenate([found, q[keeps_clear(robot, q, clearance)]])
        if len(found) >= n:
            return found[:n]
    raise ConfigError(
        f"{len(found)} of {n * DRAWS_PER_CANDIDATE} random poses of {robot.name} keep a clearance "
        f"of {clearance:g} m to the base and {LOWEST_HEIGHT:g} m to the mounting plane; expected "
        f"{n} candidates: ask for a smaller clearance or fewer candidates"
    )


def keeps_clear(robot: Robot, q: FloatArray, clearance: float) -> BoolArray:
    """Return (n,) whether poses (n, n_joints) keep `clearance` [m] to the base and the height."""
    slides = robot.n_slides
    base, height = arm_distances(robot.forward(q).points, slides)
    is_arm = slides < robot.n_joints  # otherwise nothing turns towards the base
    return (height >= LOWEST_HEIGHT) & ((base >= clearance) | (not is_arm))


def arm_distances(points: FloatArray, slides: int = 0) -> tuple[FloatArray, FloatArray]:
    """Return (n,) smallest distances [m] of the arm from the elbow on: to the base column, z = 0.

    The column is the segment to joint 2 (of a shorter arm joint 1) from the base frame's origin, or
    from below the carriage.

    Args:
        points: (n, n_joints + 1, 3) as `Robot.forward` gives.
        slides: number of prismatic joints at the base, from behind which joints are counted.
    """
    last = points.shape[1] - 1
    spare = max(last - slides - 6, 0)  # a seventh joint turns the upper arm about itself
    elbow = min(slides + 2 + spare, last)
    foot = points[:, slides - 1 : slides] * (1.0, 1.0, 0.0) if slides else np.zeros((1, 1, 3))
    top = points[:, [slides + 1 if elbow < last else slides]]
    begin = points[:, elbow : max(last, elbow + 1)]
    base = _segment_distance(begin, points[:, min(elbow + 1, last) :], foot, top)
    return base.min(axis=1), points[:, elbow:, 2].min(axis=1)


def _segment_distance(a0: FloatArray, a1: FloatArray, b0: FloatArray, b1: FloatArray) -> FloatArray:
    """Return the distances of segments a0-a1 and b0-b1, arrays (..., 3) that broadcast.

    C. Ericson, Real-Time Collision Detection (2005), 5.1.9: each position on a segment is clipped
    to it and gives the nearest one on the other.
    """
    along, other, between = a1 - a0, b1 - b0, a0 - b0
    aa, ab, bb = _dot(along, along), _dot(along, other), _dot(other, other)
    da, db = _dot(along, between), _dot(other, between)
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel, or of no length
        s = np.clip(np.nan_to_num((ab * db - bb * da) / (aa * bb - ab**2)), 0.0, 1.0)
        t = np.clip(np.nan_to_num((ab * s + db) / bb), 0.0, 1.0)
        s = np.clip(np.nan_to_num((ab * t - da) / aa), 0.0, 1.0)
    gap = between + s[..., None] * along - t[..., None] * other
    return np.asarray(np.linalg.norm(gap, axis=-1))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray((a * b).sum(axis=-1))


def _drawn_ranges(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Return the (n_joints,) lower and upper ends of the joint ranges to draw from."""
    endless = np.isinf(robot.lower)  # a continuous joint
    lower = np.where(endless, -np.pi, robot.lower)
    upper = np.where(endless, np.pi, robot.upper)
    middle, half = (lower + upper) / 2.0, (upper - lower) / 2.0
    wide = robot.turns & (half > np.pi)
    return np.where(wide, middle - np.pi, lower), np.where(wide, middle + np.pi, upper)
