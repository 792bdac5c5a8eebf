"""Choose the joint positions at a program's targets, by the configuration that it states."""

from __future__ import annotations

from itertools import product

import numpy as np

from stiff_apply.posture_math import FULL_TURN, turn_limits
from stiff_apply.programs.frames import controller_of
from stiff_apply.programs.program import Language, RobotProgram
from stiff_protocols.contract.types import BoolArray, FloatArray, Robot, TextArray
from stiff_protocols.paths.inverse import LIMIT_SLACK, STARTS, all_configurations, is_singular

NEAR_RAD = float(np.radians(2.0))
"""A joint this near to a change of sign or turn may have either: programs are rounded, and
controllers ignore the turn there."""
BLOCK = 2000
"""Number of targets per comparison of configurations."""
OUT_OF_REACH, BEYOND_LIMITS = "out of reach", "beyond the joint limits in every configuration"
OTHER_CONFIGURATION = "not reachable in the configuration that is written"
SINGULAR = "singular: the joints cannot correct it"
FLIPS = "on the other side of a singularity than the target before"


def configuration_numbers(language: Language, robot: Robot, q: FloatArray) -> FloatArray:
    """Return (n, k) configuration numbers of a language; (n, 0) if it has none."""
    if language.configurations is None or robot.n_joints != 6:
        return np.empty((len(q), 0))
    angles = controller_of(robot).from_description(q)
    return language.configurations(arm_signs(robot, q, angles[:, 4]), angles)


def choose_joints(
    program: RobotProgram,
    robot: Robot,
    position: FloatArray,
    rotation: FloatArray,
    q: FloatArray,
    start: FloatArray,
    problem: TextArray,
) -> tuple[FloatArray, TextArray, BoolArray]:
    """Return joint positions for each target.

    The written configuration is used. If there is none, or if the language does not require it on
    straight lines, the joints move least from the previous target. The first target is nearest to
    `start`.

    Args:
        program: the targets.
        robot: the robot that executes the program.
        position: (n, 3) TCP of the robot, description's base frame, m; NaN for joint angles.
        rotation: (n, 3, 3) see `ProgramPoses`.
        q: (n, n_joints) see `ProgramPoses`.
        start: (n_joints,) joint positions near the first target, rad or m.
        problem: (n,) why a target is not known; "" if it is.

    Returns:
        (n, n_joints) joint positions of the description, rad or m, NaN if there are none; (n,)
        reasons why targets cannot be reached or corrected, "" if they can; (n,) true if the written
        configuration fits, or none is written.
    """
    n, problem = len(program), problem.astype(object)
    chosen = q.copy()
    config_fits, before = np.ones(n, dtype=bool), start
    is_bound = ~np.isnan(program.config[:, 0])
    is_bound &= ~program.is_linear | program.language.config_of_linear
    for first in range(0, n, BLOCK):
        rows = np.arange(first, min(first + BLOCK, n))
        poses = rows[~program.has_joints[rows] & (problem[rows] == "")]
        ways_of = all_configurations(robot, position[poses], rotation[poses])
        is_reached = ~np.isnan(ways_of[..., 0]).all(axis=1)
        problem[poses[~is_reached]] = OUT_OF_REACH
        bound = np.flatnonzero(is_bound[poses] & is_reached)
        turned, *numbers = _with_turns(program.language, robot, ways_of[bound])
        bound_of = dict(zip(poses[bound].tolist(), range(len(bound)), strict=True))
        limits = turn_limits(robot, ways_of, ways_of)
        number_of = dict(zip(poses.tolist(), range(len(poses)), strict=True))
        for row in rows[problem[rows] == ""].tolist():
            if row not in number_of:
                before = q[row]
                problem[row] = "" if _inside(robot, q[[row]])[0] else "beyond the joint limits"
                continue
            ways = np.empty((0, robot.n_joints))
            if row in bound_of:
                low, high, exact = (values[bound_of[row]] for values in numbers)
                written = program.config[row, : exact.shape[1]]
                fits = program.language.matches(written, low, high).all(axis=1)
                inside = _inside(robot, turned[bound_of[row]])
                ways = turned[bound_of[row]][fits & inside]
                config_fits[row] = len(ways) > 0
                if not len(ways) and inside.any() and not program.is_linear[row]:
                    numbers_text = _possible(program, row, exact[inside])
                    problem[row] = f"{OTHER_CONFIGURATION}: {numbers_text}"
                    continue
            if not len(ways):
                ways = _nearest_turns(ways_of[number_of[row]], limits[:, number_of[row]], before)
            if not len(ways):  # near a singularity some are missed
                place = position[[row]], rotation[[row]]
                more = all_configurations(robot, *place, n_seeds=STARTS)[0]
                ways = _nearest_turns(more, turn_limits(robot, more, more), before)
            if not len(ways):
                problem[row] = BEYOND_LIMITS
                continue
            before = chosen[row] = ways[np.argmin(((ways - before) ** 2).sum(axis=1))]
    driven = np.flatnonzero(problem == "")
    if len(driven):
        free = np.ones(robot.n_joints, dtype=bool)
        singular = is_singular(robot, chosen[driven], free)
        problem[driven[singular]] = SINGULAR
        sign = np.sign(np.linalg.det(robot.jacobian(chosen[driven]))) if robot.n_joints == 6 else 0
        flips = np.r_[False, np.diff(sign) != 0] & program.is_linear[driven]
        flips &= np.r_[False, np.diff(driven) == 1] & program.follows[driven] & ~singular
        problem[driven[flips]] = FLIPS
    return chosen, problem.astype(str), config_fits


def _with_turns(language: Language, robot: Robot, ways: FloatArray) -> list[FloatArray]:
    """Return configurations (n, m, n_joints) with full turns, and three (n, m, k) numbers.

    The numbers belong to slightly smaller and larger joint angles, and to the angles themselves.
    """
    if not len(ways) or language.configurations is None:
        return [np.empty((0, 0, robot.n_joints)), *([np.empty((0, 0, 0))] * 3)]
    choices = []
    for turns, low, high in zip(robot.turns, robot.lower, robot.upper, strict=True):
        back, forth = [-1.0] * bool(low < -np.pi), [1.0] * bool(high > np.pi)
        choices.append([*back, 0.0, *forth] if turns else [0.0])
    turns = FULL_TURN * np.array([*product(*choices)])
    turned = (ways[:, :, None] + turns).reshape(len(ways), -1, robot.n_joints)
    signs, reached = np.zeros((*ways.shape[:2], 3)), ~np.isnan(ways[..., 0])
    controller = controller_of(robot)
    wrist = controller.from_description(ways[reached])[:, 4]
    signs[reached] = arm_signs(robot, ways[reached], wrist)
    angles = controller.from_description(turned.reshape(-1, robot.n_joints))
    shapes = signs.repeat(len(turns), axis=1).reshape(-1, 3)
    numbers = [
        language.configurations(shapes, angles + shift).reshape(*turned.shape[:2], -1)
        for shift in (-NEAR_RAD, NEAR_RAD, 0.0)
    ]
    return [turned, *numbers]


def _nearest_turns(ways: FloatArray, limits: FloatArray, before: FloatArray) -> FloatArray:
    """Return configurations (m, n_joints) inside the limits, with turns nearest to `before`."""
    least, most = limits
    turns = np.minimum(np.maximum(np.rint((before - ways) / FULL_TURN), least), most)
    return np.asarray((ways + FULL_TURN * turns)[(least <= most).all(axis=1)])


def _inside(robot: Robot, q: FloatArray) -> BoolArray:
    beyond = (q < robot.lower - LIMIT_SLACK) | (q > robot.upper + LIMIT_SLACK)
    return np.asarray(~beyond.any(axis=1))


def _possible(program: RobotProgram, row: int, numbers: FloatArray) -> str:
    """Describe the written and the possible configurations (m, k) of a pose."""
    names, ways = program.language.config_names, np.unique(numbers, axis=0).astype(int).tolist()
    written = program.config[row, : len(names)].astype(int).tolist()
    texts = [
        ", ".join(f"{name} {number}" for name, number in zip(names, way, strict=True))
        for way in (written, *ways)
    ]
    return f"{texts[0]}; the pose is reached with {' or '.join(texts[1:])}"


def arm_signs(robot: Robot, q: FloatArray, wrist_angle: FloatArray) -> FloatArray:
    """Return (n, 3) signs of an arm with vertical first axis and intersecting wrist axes.

    The first is 1 if the wrist centre is in front of axis 1, -1 if it is behind. The second is 1 if
    the elbow of a forward arm is above the line from joint 2 to the wrist centre (KUKA's joint 3
    beyond the straight arm), else -1. The third is the sign of joint 5.

    Args:
        robot: a robot with six joints.
        q: (n, 6) joint positions of the description, rad.
        wrist_angle: (n,) the controller's joint 5, rad.
    """
    link_poses = robot.forward(q)
    at_zero = robot.forward(np.zeros((1, robot.n_joints))).rotations[0, 0]
    turn_of_joint_1 = link_poses.rotations[:, 0] @ at_zero.T  # by joint 1 from its zero
    forward, sideways = turn_of_joint_1[:, :, 0], turn_of_joint_1[:, :, 1]
    points = link_poses.points
    axis, shoulder, elbow, wrist = points[:, 0], points[:, 1], points[:, 2], points[:, 4]
    reach = np.einsum("ni,ni->n", forward, wrist - axis)
    bend = np.einsum("ni,ni->n", sideways, np.cross(elbow - shoulder, wrist - elbow))
    sign = np.where(np.column_stack([reach, bend]) >= 0.0, 1.0, -1.0)
    return np.column_stack([sign, np.sign(wrist_angle)])
