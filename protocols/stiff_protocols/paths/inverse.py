"""Joint positions along a path of the tool: inverse kinematics of all points at once.

`Robot.inverse` is Newton's method, for n poses from n seeds. `follow` computes the seeds: it moves
along the path in steps too short for the arm to leave its configuration, and interpolates the joint
positions between them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiff_protocols.contract.arrays import BoolArray, FloatArray, IntArray
from stiff_protocols.contract.errors import ConfigError, DataError, unknown_name
from stiff_protocols.contract.robot import Robot
from stiff_protocols.kinematics.serial_chain import LENGTH

STRIDE_M, STRIDE_RAD = 0.05, 0.2
"""Longest step along the path."""
SHORTEST = 1 / 128
"""Share of the longest step to which a step is shortened if a joint moves far."""
NEIGHBOURS = 1 / 8
"""Share of the longest step between the points that are solved first, as seeds of the others."""
JUMP = 0.5
"""rad or m: a joint that moves further in the shortest step has changed the configuration."""

SINGULAR = 100.0
"""Condition of the Jacobian from which a point counts as singular. On the shipped six-axis arms
it is about 10 in the middle of the workspace, and 100 with joint 5 a few degrees from straight."""

STARTS = 128
"""Random seeds for the first point, where no start is given."""
LANDMARK_SEEDS, LANDMARK_M, LANDMARK_TURN = 40, 0.15, 0.5
"""Seeds, and the size of a neighbourhood in which configurations are searched for once: m, and
difference in an entry of the rotation matrix."""
COMPARED_AT = 200
"""Points of a path at which configurations are compared."""
LIMIT_SLACK = 1e-6
"""rad or m beyond a limit that still count as at it."""
SAME_CONFIGURATION = 0.01
"""rad or m between joint positions that are one configuration."""
SHORT_TURN = 0.05
"""rad or m of a joint between the positions at which a motion is tested for singularities."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Joint positions along a path, and reasons why rows cannot be driven.

    Attributes:
        q: (n, n_joints) rad or m; the nearest that was found where the pose is not reached.
        reached: (n,) whether the pose is.
        beyond: (n, n_joints) whether the joint is beyond its limits.
        condition: (n,) of the Jacobian, with `LENGTH` m counted as 1 rad.
        flips: (n,) whether the configuration of shoulder, elbow or wrist differs from the row
            before: the arm passes through a singularity, or jumps.
    """

    q: FloatArray
    reached: BoolArray
    beyond: BoolArray
    condition: FloatArray
    flips: BoolArray

    @property
    def singular(self) -> BoolArray:
        """(n,) true if the Jacobian is nearly rank-deficient."""
        return self.condition > SINGULAR

    @property
    def ok(self) -> BoolArray:
        """(n,) true if the row can be driven."""
        return self.reached & ~self.beyond.any(axis=1) & ~self.singular & ~self.flips


def free_joints(robot: Robot, held: FloatArray | None = None) -> BoolArray:
    """Return (n_joints,) true for joints that move along a path and that a pose determines.

    Args:
        robot: of any number of joints.
        held: (n_joints,) rad or m at which joints are held, NaN for a joint that moves; None: all
            move.

    Raises:
        DataError: more than six joints move.
    """
    free = np.ones(robot.n_joints, dtype=bool) if held is None else np.isnan(held)
    if free.sum() > 6:
        raise DataError(
            f"robot {robot.name!r} is redundant: {free.sum()} joints move (valid: at most 6; hold "
            "the others)"
        )
    return free


def joint_number(joint_names: Sequence[str], name: str) -> int:
    """Return the number, from 0, of a joint by its name or by J1, q1 or 1.

    Raises:
        ConfigError: no joint has this name or number.
    """
    if name in joint_names:
        return joint_names.index(name)
    number = re.fullmatch(r"[AJQajq]?([1-9]\d?)", name)
    if number is None or int(number[1]) > len(joint_names):
        raise unknown_name("joint", name, joint_names)
    return int(number[1]) - 1


def held_position(
    name: str, value: float | None, turns: bool | np.bool_, lower: float, upper: float
) -> float:
    """Return the position, rad or m, of a joint that is held at a value in deg or mm.

    Raises:
        ConfigError: the value is missing, or beyond the limits `lower` and `upper`, rad or m.
    """
    unit, factor = ("deg", 180.0 / np.pi) if turns else ("mm", 1000.0)
    if value is None:
        raise ConfigError(f"{name}: the value is missing; use {name}=VALUE, in {unit}", "hold")
    if not (np.isfinite(value) and factor * lower <= value <= factor * upper):
        valid = f"{factor * lower:g}..{factor * upper:g} {unit}"
        raise ConfigError(f"{name}={value:g} (valid: {valid})", "hold")
    return value / factor


def is_singular(robot: Robot, q: FloatArray, free: BoolArray) -> BoolArray:
    """Return (n,) true if the Jacobian of the `free` joints is nearly rank-deficient."""
    return np.asarray(np.linalg.cond(_even(robot.jacobian(q)[:, :, free])) > SINGULAR)


def judged(robot: Robot, q: FloatArray, held: FloatArray | None = None) -> Followed:
    """Return the properties of given joint positions (n, n_joints), rad or m.

    Between two rows the joints move in proportion. If this motion passes a singularity, a part of
    the arm flips. If two parts flip at once, the sign of the determinant does not change.
    """
    free = free_joints(robot, held)
    followed = _described(robot, q, np.ones(len(q), dtype=bool), free)
    flips, clear = followed.flips.copy(), ~followed.singular
    far = np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0) > JUMP
    for row in np.flatnonzero(far & clear[1:] & clear[:-1]):
        turn = q[row + 1] - q[row]
        n = int(np.abs(turn).max() / SHORT_TURN) + 1
        between = q[row] + np.arange(1, 2 * n)[:, None] / (2 * n) * turn  # the middle is one
        flips[row + 1] |= is_singular(robot, between, free).any()
    return replace(followed, flips=flips)


def _described(robot: Robot, q: FloatArray, reached: BoolArray, free: BoolArray) -> Followed:
    """Return the properties of single joint positions (n, n_joints)."""
    jacobian = _even(robot.jacobian(q)[:, :, free])
    flips = np.zeros(len(q), dtype=bool)
    if free.sum() == 6:  # the sign is that of shoulder, elbow and wrist together
        sign = np.sign(np.linalg.det(jacobian))
        flips[1:] = sign[1:] * sign[:-1] < 0.0
    beyond = (q < robot.lower - LIMIT_SLACK) | (q > robot.upper + LIMIT_SLACK)
    return Followed(q, reached, beyond, np.linalg.cond(jacobian), flips)


def follow(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    start: FloatArray | None = None,
    *,
    near: FloatArray | None = None,
    held: FloatArray | None = None,
) -> Followed:
    """Return joint positions along a path, on one continuous branch.

    Args:
        robot: of any number of joints.
        position: (n, 3) of the TCP, base frame, m, in the order of the path.
        rotation: (n, 3, 3) of the last joint's frame.
        start: (n_joints,) joint positions near the first point, which choose the configuration;
            None: of all configurations that are found, the one that can be driven furthest, and of
            several the nearest to `near`.
        near: (n_joints,) rad or m; None: the middle of the joints' limits.
        held: see `free_joints`.

    Raises:
        DataError: more than six joints move: they have a choice at every point.
    """
    free, held = free_joints(robot, held), np.full(robot.n_joints, np.nan) if held is None else held
    if start is None:
        starts = _configurations(robot, position[0], rotation[0], held)
    else:
        starts = np.where(free, robot.checked_positions(np.atleast_2d(start)), held)
    near = np.where(free, _middle(robot) if near is None else near, held)
    seeds, breaks = _marched(robot, position, rotation, starts, free)

    def driven(branch: int, rows: IntArray) -> Followed:
        return _driven(
            robot,
            position[rows],
            rotation[rows],
            seeds[branch][rows],
            breaks[branch][rows],
            free,
            near=near if start is None else None,
        )

    compared_rows = evenly_spaced(len(position))

    def cost(branch: int) -> tuple[float, ...]:
        followed = driven(branch, compared_rows)
        away = np.linalg.norm(followed.q.mean(axis=0) - near)
        return float((~followed.ok).sum()), float(breaks[branch].sum()), float(away)

    best = min(range(len(starts)), key=cost) if len(starts) > 1 else 0
    return driven(best, np.arange(len(position)))


def evenly_spaced(n: int, most: int = COMPARED_AT) -> IntArray:
    """Return at most `most` of n rows, including the first and the last.

    By default these are the rows at which configurations are compared. Rounding instead of
    truncating would compare other rows, and change stored results.
    """
    return np.unique(np.linspace(0, n - 1, most).astype(np.int64))


def _even(jacobian: FloatArray) -> FloatArray:
    """Return (n, 6, n_joints) Jacobians with `LENGTH` as the unit of length."""
    return np.concatenate([jacobian[:, :3] / LENGTH, jacobian[:, 3:]], axis=1)


def _configurations(
    robot: Robot, position: FloatArray, rotation: FloatArray, held: FloatArray
) -> FloatArray:
    """Return the (m, n_joints) different joint positions with the same pose of the TCP.

    If none is reached, return the nearest. Turns of 360 deg are not different.
    """
    q, reached = _from_seeds(
        robot, position[None], rotation[None], _random_seeds(robot, held), held
    )
    if not reached.any():
        away = np.linalg.norm(robot.tcp_position(q[:, 0]) - position, axis=1)
        return q[[np.argmin(away)], 0]
    return np.asarray(different_positions(robot, q, reached, held)[0])


def all_configurations(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    held: FloatArray | None = None,
    n_seeds: int = LANDMARK_SEEDS,
) -> FloatArray:
    """Return the different joint positions at which the TCP has each of n poses.

    Joint limits are ignored, and turns of 360 deg are not different: revolute joints that move are
    within +-pi. Near a singularity some configurations may be missing. Poses of a neighbourhood
    share the search: it uses `n_seeds` random seeds for the first pose, whose configurations are
    the seeds of the other poses.

    Args:
        robot: of at most six joints that move.
        position: (n, 3) of the TCP, base frame, m.
        rotation: (n, 3, 3) of the last joint's frame.
        held: see `free_joints`.
        n_seeds: random joint positions to search from, at most `STARTS`.

    Returns:
        (n, m, n_joints) rad or m, m the largest number of configurations of a pose; rows of NaN
        where a pose has fewer.

    Raises:
        DataError: more than six joints move, or a number is not finite.
    """
    free_joints(robot, held)
    held = np.full(robot.n_joints, np.nan) if held is None else held
    if not len(position):
        return np.empty((0, 0, robot.n_joints))
    place = np.hstack([position / LANDMARK_M, rotation.reshape(-1, 9) / LANDMARK_TURN]).round()
    _, firsts, region = np.unique(place, axis=0, return_index=True, return_inverse=True)
    seeds = _random_seeds(robot, held)[:n_seeds]
    landmarks = different_positions(
        robot, *_from_seeds(robot, position[firsts], rotation[firsts], seeds, held), held
    )
    if len(firsts) == len(position):
        return np.asarray(landmarks[region.ravel()])
    near = landmarks[region.ravel()].swapaxes(0, 1)  # (m, n, n_joints)
    has_seed: BoolArray = np.asarray(~np.isnan(near).any(axis=2))
    q, reached = np.where(has_seed[..., None], near, 0.0), np.zeros(has_seed.shape, dtype=bool)
    rows = np.nonzero(has_seed)
    free = np.isnan(held)
    q[rows], reached[rows] = robot.inverse(position[rows[1]], rotation[rows[1]], q[rows], free)
    configurations = different_positions(robot, q, reached, held)
    lost = np.flatnonzero((~np.isnan(configurations[..., 0])).sum(axis=1) < has_seed.sum(axis=0))
    if len(lost):  # the landmark's seeds do not reach all of them here
        again = different_positions(
            robot, *_from_seeds(robot, position[lost], rotation[lost], seeds, held), held
        )
        more = max(configurations.shape[1], again.shape[1])
        configurations, again = (
            np.pad(ways, ((0, 0), (0, more - ways.shape[1]), (0, 0)), constant_values=np.nan)
            for ways in (configurations, again)
        )
        better = (~np.isnan(again[..., 0])).sum(axis=1) > (
            ~np.isnan(configurations[lost, :, 0])
        ).sum(axis=1)
        configurations[lost[better]] = again[better]
    return configurations


def _random_seeds(robot: Robot, held: FloatArray) -> FloatArray:
    """Return (STARTS, n_joints) random joint positions to search from."""
    turns = robot.turns
    lower = np.where(turns, -np.pi, np.clip(robot.lower, -2.0, 2.0))
    upper = np.where(turns, np.pi, np.clip(robot.upper, -2.0, 2.0))
    seeds = np.random.default_rng(0).uniform(lower, upper, size=(STARTS, robot.n_joints))
    return np.where(np.isnan(held), seeds, held)


def _from_seeds(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    seeds: FloatArray,
    held: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """Return the (n_seeds, n, n_joints) ends of the searches, and which poses are reached."""
    n = len(position)
    q = np.repeat(seeds[:, None], n, axis=1).reshape(-1, robot.n_joints)
    poses = np.tile(position, (len(seeds), 1)), np.tile(rotation, (len(seeds), 1, 1))
    q, reached = robot.inverse(*poses, q, np.isnan(held))
    return q.reshape(len(seeds), n, -1), reached.reshape(len(seeds), n)


def different_positions(
    robot: Robot, q: FloatArray, reached: BoolArray, held: FloatArray
) -> FloatArray:
    """Return the (n, m, n_joints) different positions of (n_seeds, n, n_joints); else NaN."""
    turns, free = robot.turns, np.isnan(held)
    q = np.where(turns & free, (q + np.pi) % (2.0 * np.pi) - np.pi, q)
    new = reached.copy()
    for seed in range(1, len(q)):
        away = q[seed] - q[:seed]
        away = np.abs(np.where(turns, np.sin(0.5 * away), away)).max(axis=2)
        new[seed] &= ~((away < SAME_CONFIGURATION) & new[:seed]).any(axis=0)
    order = np.argsort(~new, axis=0, kind="stable")[: max(new.sum(axis=0).max(initial=0), 1)]
    q = np.where(new[..., None], q, np.nan)
    return np.asarray(np.take_along_axis(q, order[..., None], axis=0).swapaxes(0, 1))


def _marched(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    starts: FloatArray,
    free: BoolArray,
) -> tuple[FloatArray, BoolArray]:
    """Return seeds (m, n, n_joints) of each start's branch, and (m, n) where it breaks.

    The march takes poses between the points, too, where these are far apart.
    """
    from scipy.spatial.transform import Rotation, Slerp

    chord = np.linalg.norm(np.diff(rotation, axis=0), axis=(1, 2)) / np.sqrt(8.0)
    angle = 2.0 * np.arcsin(np.minimum(chord, 1.0))
    distance = np.linalg.norm(np.diff(position, axis=0), axis=1)
    # Every row needs an own place on the path, repeated points too
    strides = np.maximum(np.maximum(distance / STRIDE_M, angle / STRIDE_RAD), 1e-9)
    place = np.r_[0.0, np.cumsum(strides)]
    m = len(starts)

    def at(where: float) -> tuple[FloatArray, FloatArray]:
        row = max(int(np.searchsorted(place, where)), 1)
        ends = slice(row - 1, row + 1)
        point = [np.interp(where, place[ends], axis[ends]) for axis in position.T]
        turn = Slerp(place[ends], Rotation.from_matrix(rotation[ends]))
        return np.tile(point, (m, 1)), np.tile(turn([where]).as_matrix(), (m, 1, 1))

    begin = np.repeat(position[:1], m, axis=0), np.repeat(rotation[:1], m, axis=0)
    first, _ = robot.inverse(*begin, starts, free)
    places, branch = [0.0], [first]
    breaks, broken = np.zeros((m, len(place)), dtype=bool), np.zeros(m, dtype=bool)
    here, stride = 0.0, 1.0
    while here < place[-1]:
        there = min(here + stride, place[-1])
        q, reached = robot.inverse(*at(there), branch[-1], free)
        bad = ~reached | (np.abs(q - branch[-1]).max(axis=1) > JUMP)
        if (bad & ~broken).any() and stride > SHORTEST:
            stride *= 0.5
            continue
        row = int(np.searchsorted(place, there))
        breaks[bad & reached, row] = True
        broken |= bad
        places.append(there)
        branch.append(q)
        here, stride = there, min(1.0, 2.0 * stride)
    seeds = [_between(place, np.array(places), along) for along in np.stack(branch, axis=1)]
    regular = np.r_[np.arange(0.0, place[-1], NEIGHBOURS), place[-1]]
    regular_rows = np.unique(np.searchsorted(place, regular))
    if 2 * len(regular_rows) < len(place):
        for i, along in enumerate(seeds):
            q, reached = robot.inverse(
                position[regular_rows], rotation[regular_rows], along[regular_rows], free
            )
            is_close = reached & (np.abs(q - along[regular_rows]).max(axis=1) < JUMP)
            seeds[i] = _between(
                place, place[regular_rows], np.where(is_close[:, None], q, along[regular_rows])
            )
    return np.array(seeds), breaks


def _between(place: FloatArray, known_places: FloatArray, q: FloatArray) -> FloatArray:
    """Return (n, n_joints) at (n,) places, linear between (k, n_joints) `q` at `known_places`."""
    return np.stack([np.interp(place, known_places, joint) for joint in q.T], axis=1)


def _driven(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    seeds: FloatArray,
    breaks: BoolArray,
    free: BoolArray,
    *,
    near: FloatArray | None,
) -> Followed:
    """Return the branch of (n, n_joints) seeds; by turns of 360 deg next to `near`, if given."""
    q, reached = robot.inverse(position, rotation, seeds, free)
    away = np.abs(np.diff(q - seeds, axis=0)).max(axis=1, initial=0.0) > JUMP
    flips = breaks | np.r_[False, away & reached[1:] & reached[:-1]]
    if near is not None:
        q = q + np.where(free, turns_to(near, robot, q), 0.0)
    followed = _described(robot, q, reached, free)
    return replace(followed, flips=flips | followed.flips)


def _middle(robot: Robot) -> FloatArray:
    """Return the (n_joints,) middle of the limits; zero for a joint without."""
    bounded = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    middle = np.zeros(robot.n_joints)
    middle[bounded] = 0.5 * (robot.lower[bounded] + robot.upper[bounded])
    return middle


def turns_to(near: FloatArray, robot: Robot, q: FloatArray) -> FloatArray:
    """Return the turns of 360 deg that bring each branch next to a point in the limits, rad.

    Args:
        near: (n_joints,) rad or m.
        robot: with the limits.
        q: (n, ..., n_joints) n points along each branch, rad or m.

    Returns:
        (..., n_joints) rad; 0 for a joint that slides.
    """
    low, high = q.min(axis=0), q.max(axis=0)
    n_turns = np.rint((near - 0.5 * (low + high)) / (2.0 * np.pi))
    n_turns += (low + 2.0 * np.pi * n_turns < robot.lower - LIMIT_SLACK).astype(float)
    n_turns -= high + 2.0 * np.pi * n_turns > robot.upper + LIMIT_SLACK
    return np.asarray(2.0 * np.pi * np.where(robot.turns, n_turns, 0.0))
