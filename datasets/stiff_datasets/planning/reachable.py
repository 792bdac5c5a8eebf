"""Draw poses inside the joint limits, clear of the robot's base and the ground.

Both distances are checked for the arm's centre lines from the elbow on (joint 3; joint 4 of an arm
with seven joints). These are the straight lines between joint origins and to the tool centre point
(TCP). The shape of links and tool, the upper arm and objects around the robot are not checked.

Prismatic joints at the base (a track, a lift) carry the whole arm. Its joints are counted from the
first revolute joint, and its base column is below the carriage. With fewer than three joints behind
the prismatic ones, only the TCP is checked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import BoolArray, FloatArray, Robot

CLEARANCE = 0.2
"""m, default distance between the centre lines of arm and base column. The paper's 151 poses of the
KR10 have at least 0.22 m. Larger robots need more."""

LOWEST_HEIGHT = 0.15
"""m above the mounting plane (z = 0 of the base frame), for the arm's centre line: half the
thickness of forearm and tool. The paper's 151 poses have at least 0.20 m."""

LIMIT_MARGINS = np.deg2rad(2.0), 0.01
"""rad and m, distance of planned positions from the limits of revolute and prismatic joints: a
controller stops before its limit, and its readings scatter."""
MAX_MARGIN_SHARE = 0.1
"""Largest margin at each limit, as a share of the joint's range."""

DRAWS_PER_CANDIDATE = 50
"""Largest number of random poses per requested candidate."""


def reachable_poses(
    robot: Robot,
    n: int,
    rng: np.random.Generator,
    clearance: float = CLEARANCE,
    at_zero: Sequence[int] = (),
    *,
    margins: tuple[float, float] = (0.0, 0.0),
) -> FloatArray:
    """Return (n, n_joints) random poses inside limits and clearances, rad or m.

    Joint angles are uniform inside the limits. A revolute joint with a range above 360 deg uses
    the 360 deg about the middle of its limits (+-180 deg without limits). This includes every pose
    and twists cables least.

    Args:
        robot: the robot.
        n: number of poses.
        rng: draws the poses.
        clearance: smallest distance of the arm from the base column, m.
        at_zero: columns of joints that stay at zero.
        margins: smallest distances from the limits of revolute [rad] and prismatic joints [m];
            less for joints of a small range (`MAX_MARGIN_SHARE`).

    Raises:
        ConfigError: `clearance` is out of range, or too few random poses have the clearances.
    """
    if not (np.isfinite(clearance) and clearance >= 0.0):
        raise ConfigError(f"clearance is {clearance:g}, expected m, 0 or more")
    lower, upper = _joint_ranges(robot, margins)
    poses = np.empty((0, len(lower)))
    for _ in range(DRAWS_PER_CANDIDATE):
        q = rng.uniform(lower, upper, size=(n, len(lower)))
        q[:, at_zero] = 0.0
        poses = np.concatenate([poses, q[keeps_clear(robot, q, clearance)]])
        if len(poses) >= n:
            return poses[:n]
    raise ConfigError(
        f"{len(poses)} of {n * DRAWS_PER_CANDIDATE} random poses of {robot.name} keep a clearance "
        f"of {clearance:g} m to the base and {LOWEST_HEIGHT:g} m to the mounting plane; expected "
        f"{n} candidates: give a smaller clearance or fewer candidates"
    )


def keeps_clear(robot: Robot, q: FloatArray, clearance: float) -> BoolArray:
    """Return (n,) true if poses (n, n_joints) have `clearance` [m] and the least height."""
    slides = robot.n_slides
    base, height = arm_distances(robot.forward(q).points, slides, robot.stand)
    is_arm = slides < robot.n_joints  # otherwise no joint can move towards the base
    return (height >= LOWEST_HEIGHT) & ((base >= clearance) | (not is_arm))


def arm_distances(
    points: FloatArray, slides: int = 0, stand: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return (n,) smallest distances [m] of the arm to the base column and to z = 0.

    The arm begins at the elbow. The column is the segment from below `stand`, or from below
    the carriage, to joint 2 (joint 1 of a shorter arm).

    Args:
        points: (n, n_joints + 1, 3) from `Robot.forward`.
        slides: number of prismatic joints at the base; joints are counted from the next one.
        stand: (3,) where an arm without such joints stands, base frame, m; None: the origin.
    """
    last = points.shape[1] - 1
    n_extra_joints = max(last - slides - 6, 0)  # a seventh joint turns the upper arm about itself
    elbow = min(slides + 2 + n_extra_joints, last)
    place = np.zeros(3) if stand is None else stand
    carriage = points[:, slides - 1 : slides] if slides else place[None, None]
    column_start = carriage * (1.0, 1.0, 0.0)
    column_end = points[:, [slides + 1 if elbow < last else slides]]
    arm_start = points[:, elbow : max(last, elbow + 1)]
    base = _segment_distance(arm_start, points[:, min(elbow + 1, last) :], column_start, column_end)
    return base.min(axis=1), points[:, elbow:, 2].min(axis=1)


def _segment_distance(a0: FloatArray, a1: FloatArray, b0: FloatArray, b1: FloatArray) -> FloatArray:
    """Return the distances of segments a0-a1 and b0-b1, arrays (..., 3) that broadcast.

    C. Ericson, Real-Time Collision Detection (2005), 5.1.9: each position is clipped to its segment
    and gives the nearest position on the other segment.
    """
    first_direction, second_direction, offset = a1 - a0, b1 - b0, a0 - b0
    aa, ab, bb = (
        _dot(first_direction, first_direction),
        _dot(first_direction, second_direction),
        _dot(second_direction, second_direction),
    )
    da, db = _dot(first_direction, offset), _dot(second_direction, offset)
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel, or of no length
        s = np.clip(np.nan_to_num((ab * db - bb * da) / (aa * bb - ab**2)), 0.0, 1.0)
        t = np.clip(np.nan_to_num((ab * s + db) / bb), 0.0, 1.0)
        s = np.clip(np.nan_to_num((ab * t - da) / aa), 0.0, 1.0)
    gap = offset + s[..., None] * first_direction - t[..., None] * second_direction
    return np.asarray(np.linalg.norm(gap, axis=-1))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray((a * b).sum(axis=-1))


def _joint_ranges(robot: Robot, margins: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Return the (n_joints,) lower and upper ends of the joint ranges to draw from."""
    endless = np.isinf(robot.lower)  # a continuous joint
    share = MAX_MARGIN_SHARE * (robot.upper - robot.lower)
    margin = np.minimum(np.where(robot.turns, *margins), share)
    lower = np.where(endless, -np.pi, robot.lower + margin)
    upper = np.where(endless, np.pi, robot.upper - margin)
    middle, half = (lower + upper) / 2.0, (upper - lower) / 2.0
    wide = robot.turns & (half > np.pi)
    return np.where(wide, middle - np.pi, lower), np.where(wide, middle + np.pi, upper)
