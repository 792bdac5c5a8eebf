"""Postures at the points of a task with a tool that may turn about its axis; the best postures.

At each point there are some turns about the axis, and at each turn up to eight configurations of a
six-axis arm: its *branches*, which singularities separate. A motion keeps its branch. Dynamic
programming (Viterbi) finds the turns along a path with the smallest sum of costs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiff_protocols.contract.arrays import FloatArray, IntArray
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.robot import Robot
from stiff_protocols.paths.inverse import (
    LIMIT_SLACK,
    all_configurations,
    free_joints,
    is_singular,
)

BRANCHES = tuple(
    f"{shoulder} {elbow} {wrist}"
    for shoulder in ("front", "back")
    for elbow in ("up", "down")
    for wrist in ("+", "-")
)
"""Names of the branches: shoulder, elbow, sign of joint 5.

The shoulder is in front where the arm reaches to the side that it points to at zero joint
positions, the elbow up where it is above the line from shoulder to wrist (of an arm that reaches
back: as before the turn of joint 1).
"""
Direction = Literal["along", "across"]
"""Part of a deflection, seen from the axis of the tool."""
LARGEST_STEP = 0.5 * np.pi
"""rad or m that a joint moves at most between two points."""
FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False, repr=False)
class Postures(BriefFields):
    """Joint positions at n points, for each of m turns and each branch; NaN where there are none.

    Attributes:
        q: (n, m, 8, n_joints) rad or m, inside the limits, away from singularities.
        n_reached: (n,) configurations in reach, without the checks of limits and singularities.
        n_inside: (n,) configurations in reach and inside the limits of the joints.
    """

    q: FloatArray
    n_reached: IntArray
    n_inside: IntArray


@dataclass(frozen=True, eq=False, repr=False)
class Course(BriefFields):
    """One turn and branch along all points.

    Attributes:
        branch: number of the name in `BRANCHES`.
        turn: number of the turn.
        q: (n, n_joints) rad or m, continuous.
        cost: mean over the points.
    """

    branch: int
    turn: int
    q: FloatArray
    cost: float


@dataclass(frozen=True, eq=False, repr=False)
class RatedPosture(BriefFields):
    """A posture at each of n points of a task with its predicted deflection.

    Attributes:
        turn: turn of the tool about its axis, counted from the given posture, deg.
        branch: shoulder, elbow and wrist, such as "front up +".
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m, base frame.
        deflection: (n, 3) predicted at the TCP, m, base frame.
        size: (n,) length of the deflection along or across the axis, m.
        half_width: (n,) of its interval, m; None without a coverage.
        extrapolates: (n,) words of `TrainingRange.extrapolates`.
    """

    turn: float
    branch: str
    q: FloatArray
    wrench: FloatArray
    deflection: FloatArray
    size: FloatArray
    half_width: FloatArray | None
    extrapolates: tuple[str, ...]


def turned(rotation: FloatArray, axis: FloatArray, angles: FloatArray) -> FloatArray:
    """Return (n, m, 3, 3) orientations after m turns [rad] about an axis of the turning frame.

    Args:
        rotation: (n, 3, 3).
        axis: (3,) unit vector in the frame that turns.
        angles: (m,) rad.
    """
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
    return np.asarray(rotation[:, None] @ turns)


def all_postures(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    *,
    near: FloatArray,
    held: FloatArray | None = None,
) -> Postures:
    """Return the postures at n points and m turns of the tool.

    Args:
        robot: six revolute joints move.
        position: (n, 3) of the TCP, base frame, m.
        rotation: (n, m, 3, 3) of the last joint's frame (`turned`).
        near: (n_joints,) rad or m: of whole turns of a joint, the one nearest to it is taken.
        held: see `inverse.free_joints`.

    Raises:
        ConfigError: other joints than six revolute ones move.
    """
    free = free_joints(robot, held)
    if free.sum() != 6 or not robot.turns[free].all():
        raise ConfigError(
            f"{robot.name}: {free.sum()} joints move, {(free & robot.turns).sum()} of them turn "
            "(valid: an arm of six revolute joints)",
            "robot",
        )
    n, m = rotation.shape[:2]
    every = all_configurations(
        robot, np.repeat(position, m, axis=0), rotation.reshape(-1, 3, 3), held
    )
    row, column = np.nonzero(~np.isnan(every[..., 0]))
    q = nearest_turns(robot, every[row, column], near)
    inside = ((q >= robot.lower - LIMIT_SLACK) & (q <= robot.upper + LIMIT_SLACK)).all(axis=1)
    regular = inside & ~is_singular(robot, q, free)
    postures = np.full((n * m, len(BRANCHES), robot.n_joints), np.nan)
    postures[row[regular], branch_numbers(robot, q[regular], held)] = q[regular]
    counts = [np.bincount(row[rows] // m, minlength=n) for rows in (..., inside)]
    return Postures(postures.reshape(n, m, len(BRANCHES), robot.n_joints), *counts)


def nearest_turns(robot: Robot, q: FloatArray, near: FloatArray) -> FloatArray:
    """Return (n, n_joints) `q` by whole turns of a joint next to `near`, in the limits if it can.

    Prismatic joints stay.
    """
    turns = robot.turns
    shifted = np.where(turns, q + FULL_TURN * np.rint((near - q) / FULL_TURN), q)
    up, down = (shifted < robot.lower - LIMIT_SLACK), (shifted > robot.upper + LIMIT_SLACK)
    return np.asarray(np.where(turns, shifted + FULL_TURN * up - FULL_TURN * down, q))


def branch_numbers(robot: Robot, q: FloatArray, held: FloatArray | None = None) -> IntArray:
    """Return (n,) numbers in `BRANCHES` of joint positions (n, n_joints) of a six-axis arm.

    With the joint axes z1 to z6, z2 across the arm's plane: the shoulder is the side of axis 1 on
    which the wrist is, the elbow the side of the line from shoulder to wrist on which axis 3 is,
    the wrist the side to which joint 5 bends axis 6 away from axis 4.
    """
    joints = np.flatnonzero(free_joints(robot, held))
    zero = np.zeros((1, robot.n_joints)) if held is None else np.nan_to_num(held)[None]
    reach, elbow, wrist, aligned = _sides(robot, np.concatenate([zero, q]), joints)
    front = np.sign(reach[1:] * np.where(reach[0], reach[0], 1.0))
    up = elbow[1:] * np.sign(reach[1:])
    bend = wrist[1:] * (-1.0 if aligned[0] < -1e-9 else 1.0)
    return np.asarray(4 * (front < 0.0) + 2 * (up < 0.0) + (bend < 0.0))


def _sides(robot: Robot, q: FloatArray, joints: IntArray) -> tuple[FloatArray, ...]:
    """Return (n,) signed sizes of shoulder, elbow and wrist, and the cosine of axes 4 and 6."""
    poses = robot.forward(q)
    z = np.einsum("nkij,kj->kni", poses.rotations, robot.axes)[joints]  # (6, n, 3)
    p = poses.points.swapaxes(0, 1)[joints]
    height = _dot(z[0], p[1] - robot.arm_base(poses.points))
    upwards = z[0] * np.where(height < 0.0, -1.0, 1.0)[:, None]
    forwards = np.cross(z[1], upwards)
    hand = _foot(p[5], z[5], p[4], z[4])  # the wrist's centre, or where axes 5 and 6 cross
    knuckle = _foot(p[4], z[4], p[3], z[3])
    reach = _dot(hand - p[0], forwards)
    bend = _dot(np.cross(p[2] - p[1], knuckle - p[2]), z[1])
    return reach, bend, _dot(z[4], np.cross(z[3], z[5])), _dot(z[3], z[5])


def _foot(
    point: FloatArray, axis: FloatArray, second_point: FloatArray, second_axis: FloatArray
) -> FloatArray:
    """Return (n, 3) the points of axes that are nearest to other axes."""
    along = _dot(axis, second_axis)
    apart = second_point - point
    share = (_dot(apart, axis) - along * _dot(apart, second_axis)) / np.maximum(
        1.0 - along**2, 1e-12
    )
    return np.asarray(point + share[:, None] * axis)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ni,ni->n", a, b))


def best_courses(robot: Robot, q: FloatArray, cost: FloatArray, near: FloatArray) -> list[Course]:
    """Return the courses along all points with one turn and branch, in order of mean cost.

    Args:
        robot: robot of these joints.
        q: (n, m, 8, n_joints) rad or m, of `Postures`.
        cost: (n, m, 8), at least 0; a missing posture has any cost.
        near: (n_joints,) rad or m: of whole turns of a joint along the course, the ones nearest.
    """
    n = len(q)
    cost = np.where(np.isnan(q[..., 0]), np.inf, cost)
    total = cost[0].copy()
    joined = low = high = np.nan_to_num(q[0])  # continuous joint positions, and their ends so far
    for point in range(1, n):
        step = np.nan_to_num(q[point]) - joined
        step -= np.where(robot.turns, FULL_TURN * np.rint(step / FULL_TURN), 0.0)
        joined = joined + step
        low, high = np.minimum(low, joined), np.maximum(high, joined)
        drivable = (np.abs(step) <= LARGEST_STEP).all(axis=-1)
        drivable &= ~np.isnan(_whole_turns(robot, low, high, near)).any(axis=-1)
        total = np.where(drivable, total + cost[point], np.inf)
    courses = [
        Course(
            int(branch),
            int(turn),
            _continuous(robot, q[:, turn, branch], near),
            float(total[turn, branch]) / n,
        )
        for turn, branch in np.argwhere(np.isfinite(total))
    ]
    return sorted(courses, key=lambda course: course.cost)


def _continuous(robot: Robot, q: FloatArray, near: FloatArray) -> FloatArray:
    """Return (n, n_joints) `q` without jumps by whole turns, next to `near` inside the limits.

    One posture stays as it is.
    """
    if len(q) == 1:
        return q
    joined = np.where(robot.turns, np.unwrap(q, axis=0), q)
    return np.asarray(
        joined + FULL_TURN * _whole_turns(robot, joined.min(axis=0), joined.max(axis=0), near)
    )


def _whole_turns(robot: Robot, low: FloatArray, high: FloatArray, near: FloatArray) -> FloatArray:
    """Return the whole turns of joints that move low..high inside the limits; NaN: impossible.

    Arguments and result have the shape (.., n_joints).
    """
    least, most = turn_limits(robot, low, high)
    nearest = np.rint((near - 0.5 * (low + high)) / FULL_TURN)
    return np.asarray(np.where(least > most, np.nan, np.clip(nearest, least, most)))


def turn_limits(robot: Robot, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the least and the most whole turns of joints that move low..high inside the limits.

    The result has the shape (2, .., n_joints); where least > most there are none.
    """
    least = np.ceil((robot.lower - LIMIT_SLACK - low) / FULL_TURN)
    most = np.floor((robot.upper + LIMIT_SLACK - high) / FULL_TURN)
    slides = ~robot.turns  # they have no whole turns
    least[..., slides] = least[..., slides].clip(min=0.0)
    most[..., slides] = most[..., slides].clip(max=0.0)
    return np.array([least, most])
