"""Joint positions along a path of the tool: inverse kinematics of all points at once.

`solved` is Newton's method with damping, for n poses from n seeds. `follow` finds the seeds: it
marches along the path in steps that are so short that the arm cannot leave its configuration, and
interpolates the joint positions between them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from stiff_protocols.contract.arrays import FloatArray, IntArray
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.robot import ChainPoses, Robot

BoolArray = NDArray[np.bool_]

REACHED_M, REACHED_RAD = 1e-8, 1e-8
"""How near the joint positions come to the pose that was asked for."""
STEPS = 40
"""Newton's steps at most; in reach and away from singularities it takes three to five."""
PATIENCE = 8
"""A point whose error has not halved in so many steps is given up."""
LARGEST_TURN = 0.3
"""rad or m, of a joint in one Newton step."""
LENGTH = 0.5
"""m that count as 1 rad in the damping and the condition of a Jacobian."""

STRIDE_M, STRIDE_RAD = 0.05, 0.2
"""One step along the path is so long at most."""
SHORTEST = 1 / 128
"""Part of it that a step is shortened to where a joint moves far."""
JUMP = 0.5
"""rad or m: a joint that moves further in the shortest step has changed the configuration."""

SINGULAR = 100.0
"""Condition of the Jacobian from which a point counts as singular. On the shipped six-axis arms
it is about 10 in the middle of the workspace, and 100 with joint 5 a few degrees from straight."""

LIMIT_SLACK = 1e-6
"""rad or m beyond a limit that still count as at it."""
STARTS = 128
"""Random seeds for the first point, where no start is given."""
COMPARED_AT = 100
"""Points of a path at which configurations are compared."""
SAME_CONFIGURATION = 0.01
"""rad or m between joint positions that are one configuration."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Joint positions along a path, and where they cannot be driven.

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
        """(n,) whether the Jacobian is near the loss of its rank."""
        return self.condition > SINGULAR

    @property
    def ok(self) -> BoolArray:
        """(n,) whether the row can be driven."""
        return self.reached & ~self.beyond.any(axis=1) & ~self.singular & ~self.flips

    def take(self, rows: slice) -> Followed:
        """Return some rows."""
        return Followed(*(getattr(self, each.name)[rows] for each in fields(self)))


def solved(
    robot: Robot, position: FloatArray, rotation: FloatArray, seed: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return joint positions at which the TCP has each pose, and whether it reaches it.

    Newton's method with the damping of Sugihara (IEEE Trans. Robotics 27, 2011), which shrinks with
    the remaining error. Limits of the joints are not looked at.

    Args:
        robot: of up to six joints.
        position: (n, 3) of the TCP, base frame, m.
        rotation: (n, 3, 3) of the last joint's frame.
        seed: (n, n_joints) where to begin, rad or m.
    """
    from scipy.spatial.transform import Rotation

    q, reached = np.array(seed, dtype=np.float64), np.zeros(len(seed), dtype=bool)
    rows, left = np.arange(len(q)), np.full((STEPS, len(q)), np.inf)
    for step in range(STEPS):
        stands = robot.forward(q[rows])
        turn = Rotation.from_matrix(rotation[rows] @ stands.rotation.transpose(0, 2, 1))
        error = np.hstack([position[rows] - stands.points[:, -1], turn.as_rotvec()])
        near = np.linalg.norm(error.reshape(-1, 2, 3), axis=2) <= (REACHED_M, REACHED_RAD)
        reached[rows[near.all(axis=1)]] = True
        error[:, :3] /= LENGTH
        left[step, rows] = np.linalg.norm(error, axis=1)
        on = ~near.all(axis=1)
        if step >= PATIENCE:
            on &= left[step, rows] < 0.5 * left[step - PATIENCE, rows]
        rows, error = rows[on], error[on]
        if not len(rows):
            break
        jacobian = _even(robot.jacobian_at(ChainPoses(stands.points[on], stands.rotations[on])))
        transposed = jacobian.transpose(0, 2, 1)
        damping = 0.5 * np.einsum("ni,ni->n", error, error) + 1e-14
        normal = transposed @ jacobian + damping[:, None, None] * np.eye(robot.n_joints)
        turned = np.linalg.solve(normal, transposed @ error[..., None])[..., 0]
        largest = np.abs(turned).max(axis=1, keepdims=True)
        q[rows] += turned * np.minimum(1.0, LARGEST_TURN / np.maximum(largest, LARGEST_TURN))
    return q, reached


def refuse_redundant(robot: Robot) -> None:
    """Refuse a robot for which a pose of the tool does not say where the joints are.

    Raises:
        DataError: it has more than six joints.
    """
    if robot.n_joints > 6:
        raise DataError(
            f"robot {robot.name!r} is redundant: {robot.n_joints} joints (valid: at most 6)"
        )


def judged(robot: Robot, q: FloatArray) -> Followed:
    """Return what can be said of joint positions (n, n_joints) that are given, rad or m."""
    jacobian = _even(robot.jacobian(q))
    flips = np.zeros(len(q), dtype=bool)
    if robot.n_joints == 6:  # the sign is that of shoulder, elbow and wrist together
        sign = np.sign(np.linalg.det(jacobian))
        flips[1:] = sign[1:] * sign[:-1] < 0.0
    beyond = (q < robot.lower - LIMIT_SLACK) | (q > robot.upper + LIMIT_SLACK)
    reached = np.ones(len(q), dtype=bool)
    return Followed(q, reached, beyond, np.linalg.cond(jacobian), flips)


def follow(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    start: FloatArray | None = None,
    *,
    near: FloatArray | None = None,
) -> Followed:
    """Return joint positions along a path, on one continuous branch.

    Args:
        robot: of up to six joints.
        position: (n, 3) of the TCP, base frame, m, in the order of the path.
        rotation: (n, 3, 3) of the last joint's frame.
        start: (n_joints,) joint positions near the first point, which choose the configuration;
            None: of all configurations that are found, the one that can be driven furthest, and of
            several the nearest to `near`.
        near: (n_joints,) rad or m; None: the middle of the joints' limits.

    Raises:
        DataError: the robot has more than six joints: it has a choice at every point.
    """
    refuse_redundant(robot)
    if start is None:
        starts = _configurations(robot, position[0], rotation[0])
    else:
        starts = robot.checked_positions(np.atleast_2d(start))
    near = _middle(robot) if near is None else near
    seeds, breaks = _marched(robot, position, rotation, starts)

    def driven(branch: int, rows: IntArray) -> Followed:
        return _driven(
            robot,
            position[rows],
            rotation[rows],
            seeds[branch][rows],
            breaks[branch][rows],
            near=near if start is None else None,
        )

    some = np.unique(np.linspace(0, len(position) - 1, COMPARED_AT).astype(int))
    best, least = 0, (np.inf, np.inf, np.inf)
    for branch in range(len(starts) if len(starts) > 1 else 0):
        found = driven(branch, some)
        cost = (
            float(breaks[branch].sum()),
            float((~found.ok).sum()),
            float(np.linalg.norm(found.q.mean(axis=0) - near)),
        )
        if cost < least:
            best, least = branch, cost
    return driven(best, np.arange(len(position)))


def _even(jacobian: FloatArray) -> FloatArray:
    """Return (n, 6, n_joints) Jacobians with `LENGTH` as the unit of length."""
    return np.concatenate([jacobian[:, :3] / LENGTH, jacobian[:, 3:]], axis=1)


def _configurations(robot: Robot, position: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return (m, n_joints) the different joint positions at which the TCP has one pose.

    The nearest where none is reached. Turns of 360 deg are not different.
    """
    turns = np.array([kind == "revolute" for kind in robot.joint_types])
    lower = np.where(turns, -np.pi, np.clip(robot.lower, -2.0, 2.0))
    upper = np.where(turns, np.pi, np.clip(robot.upper, -2.0, 2.0))
    seeds = np.random.default_rng(0).uniform(lower, upper, size=(STARTS, robot.n_joints))
    poses = (np.tile(position, (STARTS, 1)), np.tile(rotation, (STARTS, 1, 1)))
    q, reached = solved(robot, *poses, seeds)
    if not reached.any():
        away = np.linalg.norm(robot.tcp_position(q) - position, axis=1)
        return q[[np.argmin(away)]]
    different: list[FloatArray] = []
    for each in np.where(turns, (q[reached] + np.pi) % (2.0 * np.pi) - np.pi, q[reached]):
        others = [
            np.where(turns, np.sin(0.5 * (each - other)), each - other) for other in different
        ]
        if not any(np.abs(one).max() < SAME_CONFIGURATION for one in others):
            different.append(each)
    return np.array(different)


def _marched(
    robot: Robot, position: FloatArray, rotation: FloatArray, starts: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return seeds (m, n, n_joints) of each start's branch, and (m, n) where it breaks.

    The march takes poses between the points, too, where these are far apart.
    """
    from scipy.spatial.transform import Rotation, Slerp

    turn = Rotation.from_matrix(rotation)
    angle = (turn[1:] * turn[:-1].inv()).magnitude()
    distance = np.linalg.norm(np.diff(position, axis=0), axis=1)
    # Every row needs an own place on the path, repeated points too
    strides = np.maximum(np.maximum(distance / STRIDE_M, angle / STRIDE_RAD), 1e-9)
    place = np.r_[0.0, np.cumsum(strides)]
    turned = Slerp(place, turn) if len(place) > 1 else None
    m = len(starts)

    def at(where: float) -> tuple[FloatArray, FloatArray]:
        point = np.array([np.interp(where, place, axis) for axis in position.T])
        matrix = rotation[0] if turned is None else turned([where]).as_matrix()[0]
        return np.tile(point, (m, 1)), np.tile(matrix, (m, 1, 1))

    first, _ = solved(robot, *at(0.0), starts)
    places, branch = [0.0], [first]
    breaks, broken = np.zeros((m, len(place)), dtype=bool), np.zeros(m, dtype=bool)
    here, stride = 0.0, 1.0
    while here < place[-1]:
        there = min(here + stride, place[-1])
        q, reached = solved(robot, *at(there), branch[-1])
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
    along = np.stack(branch, axis=1)  # (m, knots, n_joints)
    seeds = [
        np.stack([np.interp(place, places, joint) for joint in each.T], axis=1) for each in along
    ]
    return np.array(seeds), breaks


def _driven(
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    seeds: FloatArray,
    breaks: BoolArray,
    *,
    near: FloatArray | None,
) -> Followed:
    """Return the branch of (n, n_joints) seeds; by turns of 360 deg next to `near`, if given."""
    q, reached = solved(robot, position, rotation, seeds)
    away = np.abs(np.diff(q - seeds, axis=0)).max(axis=1, initial=0.0) > JUMP
    flips = breaks | np.r_[False, away & reached[1:] & reached[:-1]]
    if near is not None:
        q = q + _turns_to(near, robot, q)
    found = judged(robot, q)
    return replace(found, reached=reached, flips=flips | found.flips)


def _middle(robot: Robot) -> FloatArray:
    """Return the (n_joints,) middle of the limits; zero for a joint without."""
    bounded = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    middle = np.zeros(robot.n_joints)
    middle[bounded] = 0.5 * (robot.lower + robot.upper)[bounded]
    return middle


def _turns_to(near: FloatArray, robot: Robot, q: FloatArray) -> FloatArray:
    """Return the (n_joints,) turns of 360 deg that bring a branch next to a point in the limits."""
    low, high = q.min(axis=0), q.max(axis=0)
    whole = np.rint((near - 0.5 * (low + high)) / (2.0 * np.pi))
    whole += (low + 2.0 * np.pi * whole < robot.lower - LIMIT_SLACK).astype(float)
    whole -= high + 2.0 * np.pi * whole > robot.upper + LIMIT_SLACK
    turns = np.array([kind == "revolute" for kind in robot.joint_types])
    return np.asarray(2.0 * np.pi * np.where(turns, whole, 0.0))
