"""Joint positions at which a robot reaches the targets of a program."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from stiff_datasets.programs.arm_shape import arm_signs
from stiff_datasets.programs.controller_poses import controller_of
from stiff_datasets.programs.program_file import Language, RobotProgram
from stiff_protocols.contract.types import BoolArray, FloatArray, IntArray, Robot, TextArray
from stiff_protocols.paths.inverse import LIMIT_SLACK, all_configurations, is_singular

BLOCK = 2000
"""Targets whose configurations are compared at once."""
OUT_OF_REACH, BEYOND_LIMITS = "out of reach", "beyond the joint limits in every configuration"
OTHER_CONFIGURATION = "not reachable in the configuration that is written"
SINGULAR = "singular: the joints cannot correct it"
FLIPS = "on the other side of a singularity than the target before"
LONGEST_PROBLEM = 64
"""Characters of a problem."""


@dataclass(frozen=True, eq=False)
class ChosenJoints:
    """Joint positions at a program's targets.

    Attributes:
        q: (n, n_joints) of the description, rad or m; NaN where there are none.
        problem: (n,) why the target cannot be driven or corrected; "" if it can.
        config_fits: (n,) the numbers of the configuration are those of `q`; true where none are
            written.
        possible: row of a target that is not reachable in its configuration -> those in which it
            is.
    """

    q: FloatArray
    problem: TextArray
    config_fits: BoolArray
    possible: dict[int, str]


def configuration_numbers(language: Language, robot: Robot, q: FloatArray) -> FloatArray:
    """Return (n, k) the numbers of a language for configurations; (n, 0) if it has none."""
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
) -> ChosenJoints:
    """Return joint positions for each target.

    A written configuration decides; without one, or along a straight line whose language does not
    bind it, the joints move least from the target before. The first target is nearest to `start`.

    Args:
        program: the targets.
        robot: that drives them.
        position: (n, 3) of `ProgramPoses`.
        rotation: (n, 3, 3) of `ProgramPoses`.
        q: (n, n_joints) of `ProgramPoses`.
        start: (n_joints,) joint positions near the first target, rad or m.
    """
    n = len(program)
    chosen, problem = q.copy(), np.full(n, "", dtype=f"<U{LONGEST_PROBLEM}")
    config_fits, before = np.ones(n, dtype=bool), start
    possible: dict[int, str] = {}
    for first in range(0, n, BLOCK):
        rows = np.arange(first, min(first + BLOCK, n))
        poses = rows[~program.has_joints[rows]]
        candidates, numbers = _candidates(program.language, robot, position[poses], rotation[poses])
        for row in rows[program.has_joints[rows]]:
            beyond = (q[row] < robot.lower - LIMIT_SLACK) | (q[row] > robot.upper + LIMIT_SLACK)
            problem[row] = "beyond the joint limits" if beyond.any() else ""
        number_of = dict(zip(poses.tolist(), range(len(poses)), strict=True))
        for row in rows.tolist():
            index = number_of.get(row)
            if index is None:
                before = q[row]
                continue
            reached = ~np.isnan(candidates[index, :, 0])
            inside = reached & _inside(robot, candidates[index])
            if not inside.any():
                problem[row] = BEYOND_LIMITS if reached.any() else OUT_OF_REACH
                continue
            fits = inside & _fits(program, row, numbers[index])
            is_bound = not program.is_linear[row] or program.language.config_of_linear
            if is_bound and not fits.any() and not program.is_linear[row]:
                problem[row] = OTHER_CONFIGURATION
                possible[row] = _possible(program, row, numbers[index][inside])
                continue
            pool = fits if is_bound and fits.any() else inside
            ways = candidates[index][pool]
            before = chosen[row] = ways[np.argmin(np.linalg.norm(ways - before, axis=1))]
            config_fits[row] = fits.any() or not is_bound
    driven = np.flatnonzero(problem == "")
    if len(driven):
        free = np.ones(robot.n_joints, dtype=bool)
        singular = is_singular(robot, chosen[driven], free)
        problem[driven[singular]] = SINGULAR
        sign = np.sign(np.linalg.det(robot.jacobian(chosen[driven]))) if robot.n_joints == 6 else 0
        flips = np.r_[False, np.diff(sign) != 0] & program.is_linear[driven]
        flips &= np.r_[False, np.diff(driven) == 1] & program.follows[driven] & ~singular
        problem[driven[flips]] = FLIPS
    return ChosenJoints(chosen, problem, config_fits, possible)


def _candidates(
    language: Language, robot: Robot, position: FloatArray, rotation: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (n, m, n_joints) all joint positions, with full turns, and (n, m, k) their numbers."""
    if not len(position):
        return np.empty((0, 0, robot.n_joints)), np.empty((0, 0, 0))
    found = all_configurations(robot, position, rotation)  # (n, m, n_joints)
    choices = [
        (-1.0, 0.0, 1.0) if turns and high - low > 2.0 * np.pi else _needed(low, high, turns)
        for turns, low, high in zip(robot.turns, robot.lower, robot.upper, strict=True)
    ]
    turns = 2.0 * np.pi * np.array([*product(*choices)])
    candidates = (found[:, :, None] + turns).reshape(len(position), -1, robot.n_joints)
    if language.configurations is None or robot.n_joints != 6:
        return candidates, np.empty((*candidates.shape[:2], 0))
    signs, reached = np.zeros((*found.shape[:2], 3)), ~np.isnan(found[..., 0])
    controller = controller_of(robot)
    wrist = controller.from_description(found[reached])[:, 4]
    signs[reached] = arm_signs(robot, found[reached], wrist)
    angles = controller.from_description(candidates.reshape(-1, robot.n_joints))
    numbers = language.configurations(signs.repeat(len(turns), axis=1).reshape(-1, 3), angles)
    return candidates, numbers.reshape(*candidates.shape[:2], -1)


def _needed(low: float, high: float, turns: bool) -> tuple[float, ...]:
    """Return the full turns by which an angle within +-180 deg can be inside the limits."""
    if not turns:
        return (0.0,)
    upwards, downwards = high > np.pi, low < -np.pi
    return (*([-1.0] if downwards else []), 0.0, *([1.0] if upwards else []))


def _inside(robot: Robot, q: FloatArray) -> BoolArray:
    beyond = (q < robot.lower - LIMIT_SLACK) | (q > robot.upper + LIMIT_SLACK)
    return np.asarray(~beyond.any(axis=1))


def _possible(program: RobotProgram, row: int, numbers: FloatArray) -> str:
    """Return the configurations (m, k) of a pose, next to the one that is written."""
    names, ways = program.language.config_names, np.unique(numbers, axis=0).astype(int).tolist()
    written = program.config[row, : len(names)].astype(int).tolist()
    texts = [
        ", ".join(f"{name} {number}" for name, number in zip(names, way, strict=True))
        for way in (written, *ways)
    ]
    return f"{texts[0]}; the pose is reached with {' or '.join(texts[1:])}"


def _fits(program: RobotProgram, row: int, numbers: FloatArray) -> BoolArray:
    """Return (m,) whether numbers of configurations are those that are written."""
    written = program.config[row]
    needed: IntArray = np.flatnonzero(~np.isnan(written))
    return np.asarray((numbers[:, needed] == written[needed]).all(axis=1))
