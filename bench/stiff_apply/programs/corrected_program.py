"""Correct a program's targets, decide which stay as they are, and write the others into it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np

from stiff_apply.programs.configurations import configuration_numbers
from stiff_apply.programs.flow import LAST, Flow, Setting, State
from stiff_apply.programs.frames import ProgramPoses, controller_of, lengths_in_base
from stiff_apply.programs.program import Edit, RobotProgram, edited_texts, number_text
from stiff_protocols.contract.types import (
    BoolArray,
    Deflection,
    FloatArray,
    IntArray,
    Robot,
    TextArray,
)
from stiff_protocols.paths.compensation import Compensation, compensate
from stiff_protocols.paths.path import ToolPath

BLOCK = 20_000
"""Points per correction step, so that memory is limited for a million targets."""
SAME_COMMAND_M, SAME_COMMAND_RAD = 1e-6, 1e-6
"""Differences up to which commands of one target are equal."""
SHARED = "another motion has this target with another command"


def corrected_rows(targets: Compensation) -> Compensation:
    """Return the targets that were corrected."""
    done = targets.converged
    return Compensation(
        **{item.name: getattr(targets, item.name)[done] for item in fields(targets)}
    )


def correct_targets(
    predict_of: Callable[[FloatArray], Deflection],
    robot: Robot,
    point: FloatArray,
    position: FloatArray,
    rotation: FloatArray,
    q: FloatArray,
    wrench: FloatArray,
    problem: TextArray,
    *,
    tolerance_m: float,
    max_iterations: int,
) -> Compensation:
    """Return the commands of a program's targets; targets with a problem do not change.

    Args:
        predict_of: returns the function that predicts deflections at a (3,) TCP.
        robot: robot of the joint positions.
        point: (n, 3) TCP in the last joint's frame, m.
        position: (n, 3) TCP, base frame, m.
        rotation: (n, 3, 3) orientation of the last joint's frame.
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
        problem: (n,) reason why a target is not corrected; "" for corrected targets.
        tolerance_m: see `compensate`, m.
        max_iterations: see `compensate`.
    """
    n = len(position)
    zeros = np.zeros((n, 3))
    result = Compensation(
        position, position.copy(), q.copy(), zeros, zeros.copy(), np.zeros(n, dtype=np.int64),
        np.full(n, np.nan), problem.astype(object),
    )  # fmt: skip
    driven = np.flatnonzero(problem == "")
    points, number = np.unique(point[driven], axis=0, return_inverse=True)
    for index, tcp in enumerate(points):
        of_tool = driven[number.ravel() == index]
        arm = robot if np.array_equal(tcp, robot.tcp) else replace(robot, tcp=tcp)
        for first in range(0, len(of_tool), BLOCK):
            rows = of_tool[first : first + BLOCK]
            path = ToolPath("", position[rows], rotation[rows], wrench[rows])
            compensation = compensate(
                predict_of(tcp),
                arm,
                path,
                q[rows],
                tolerance_m=tolerance_m,
                max_iterations=max_iterations,
            )
            for item in fields(result):
                getattr(result, item.name)[rows] = getattr(compensation, item.name)
    return replace(result, problem=result.problem.astype(str))


class Steps(Flow):
    """Find steps between corrected and uncorrected motions of one continuous path.

    Attributes:
        steps: pairs of numbers of a corrected and an uncorrected motion.
    """

    def __init__(
        self, program: RobotProgram, is_corrected: BoolArray, is_loaded: BoolArray
    ) -> None:
        """Follow a program; (n_motions,) which motions are corrected, and which are loaded."""
        self.number = {motion: index for index, motion in enumerate(program.motions)}
        self.is_corrected, self.is_loaded = is_corrected, is_loaded
        self.steps = set[tuple[int, int]]()
        super().__init__(program.reading.routines, {})

    def apply(self, item: Any, state: State) -> State:
        """Return the state after a motion: the last motions with and without correction."""
        if isinstance(item, Setting):
            return state
        index = self.number[item]
        if item.kind == "joint" or not self.is_loaded[index]:
            return {LAST: None}
        if item.is_relative:
            return state
        corrected, uncorrected = state.get("corrected"), state.get("uncorrected")
        if self.is_corrected[index]:
            self.steps |= {(index, uncorrected)} if uncorrected is not None else set()
            return {LAST: None, "corrected": index}
        self.steps |= {(corrected, index)} if corrected is not None else set()
        return {LAST: None, "uncorrected": index}

    def common(self, key: str, first: Any, second: Any) -> Any:
        """Return one of two motions, or the one that there is."""
        numbers = [number for number in (first, second) if isinstance(number, int)]
        return min(numbers) if numbers else None


def shared_targets(program: RobotProgram, is_corrected: BoolArray) -> dict[int, int]:
    """Return uncorrected motions that move with the target of a corrected one, and this one.

    They have the same target, or an expression with its name.

    Args:
        program: the motions.
        is_corrected: (n_motions,) true for corrected motions.
    """
    rows = np.flatnonzero(is_corrected[program.motion])
    places = sorted(
        (int(program.text_index[row]), int(program.places[row, 0, 0]), int(program.motion[row]))
        for row in rows
    )
    names, shared = program.reading.names, dict[int, int]()
    for index, motion in enumerate(program.motions):
        if is_corrected[index]:
            continue
        text = program.texts[0][motion.start : motion.end]
        spans = [
            (goal.text_index, goal.numbers[0].start, goal.numbers[0].start + 1)
            for goal in motion.goals
            if goal.numbers and goal.numbers[0]
        ]
        for name in names.mentioned(text):
            declared, _ = names.find(motion.routine, name)
            if declared is not None:
                start = declared.statement.start
                spans.append((declared.text_index, start, start + len(declared.statement.text)))
        for text_index, start, end in spans:
            after = bisect_left(places, (text_index, start, -1))
            if after < len(places) and places[after] < (text_index, end, -1):
                shared[index] = places[after][2]
    return shared


def left_rows(
    program: RobotProgram, targets: Compensation, is_loaded: BoolArray
) -> tuple[Compensation, dict[int, str]]:
    """Leave targets that cannot be corrected without others; return reasons by motion, too.

    A target that several motions share has one command. A circle is corrected with all its points,
    its start too, or left with all of them.
    """
    problem = targets.problem.astype(object)
    number = {motion: index for index, motion in enumerate(program.motions)}
    start_of = {
        number[motion]: number.get(state[LAST])
        for motion, state in program.states.items()
        if motion.kind == "circle"
    }
    rows_of: dict[int, list[int]] = {}
    for row, index in enumerate(program.motion.tolist()):
        rows_of.setdefault(index, []).append(row)
    reasons = {index: reason for index, reason in enumerate(program.reasons) if reason}

    def leave(index: int, reason: str) -> None:
        reasons.setdefault(index, reason)
        for row in rows_of.get(index, ()):
            problem[row] = problem[row] or reason

    while True:
        before = (problem != "").sum()
        for row in _conflicts(program, targets, problem):
            problem[row] = problem[row] or SHARED
        for index, rows in rows_of.items():
            if reason := next((problem[row] for row in rows if problem[row]), ""):
                leave(index, reason)
        for index, start in sorted(start_of.items()):
            line = "not known" if start is None else f"in line {program.motion_lines[start]}"
            if index in reasons:
                continue
            if start is None or start in reasons:
                leave(index, f"the start of the circle, {line}, is left")
            elif is_loaded[start] != is_loaded[index]:
                leave(index, f"the start of the circle, {line}, has another load")
        for index, start in sorted(start_of.items(), reverse=True):
            if index in reasons and start is not None and start not in reasons:
                leave(start, f"start of the circle in line {program.motion_lines[index]}")
        if (problem != "").sum() == before:
            return replace(targets, problem=problem.astype(str)), reasons


def _conflicts(program: RobotProgram, targets: Compensation, problem: TextArray) -> IntArray:
    """Return the rows whose target also belongs to a motion with another command."""
    key = np.column_stack([program.text_index, program.places[:, 0, 0]])
    _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    first_row = first[group.ravel()]

    def apart(values: FloatArray) -> FloatArray:
        return np.asarray(np.nan_to_num(np.abs(values - values[first_row])).max(axis=1))

    differs = apart(targets.position) > SAME_COMMAND_M
    differs |= program.has_joints & (apart(targets.q) > SAME_COMMAND_RAD)
    differs |= (problem == "") != (problem == "")[first_row]
    return np.asarray(np.flatnonzero(np.isin(first_row, first_row[differs])))


def corrected_texts(
    program: RobotProgram,
    robot: Robot,
    poses: ProgramPoses,
    targets: Compensation,
    q_before: FloatArray,
) -> tuple[list[str], list[int]]:
    """Return the texts of the corrected program, and rows with a new configuration.

    Args:
        program: the original program.
        robot: robot of the joint positions.
        poses: frames of the program.
        targets: the commands.
        q_before: (n, n_joints) joint positions at the original targets, rad or m.
    """
    language, index, q = program.language, program.frame_index, targets.q
    rows = np.flatnonzero(targets.converged)
    pose_rows, joint_rows = rows[~program.has_joints[rows]], rows[program.has_joints[rows]]
    numbers = np.full((len(program), 7), np.nan)
    bases = poses.bases[index[pose_rows]]  # orientations do not change
    numbers[pose_rows, :3] = lengths_in_base(language, bases, targets.position[pose_rows])
    angles = controller_of(robot).from_description(q[joint_rows]) / language.radians
    numbers[joint_rows, : robot.n_joints] = angles
    edits: dict[tuple[int, ...], Edit] = {}
    columns = (rows, program.text_index[rows], program.places[rows], numbers[rows])
    for row, text_index, places, values in zip(*(c.tolist() for c in columns), strict=True):
        text, has_joints = program.texts[text_index], bool(program.has_joints[row])
        for column, ((start, end), value) in enumerate(zip(places, values, strict=True)):
            if value == value:
                new = number_text(value, text[start:end], language.decimals[has_joints])
                name = f"A{column + 1}" if has_joints else "XYZ"[column]
                new = new if end > start else f",{name} {new}"
                edits[text_index, start, end, column] = Edit(text_index, start, end, new)
    changed = []
    if language.configurations is not None and len(pose_rows):
        before = configuration_numbers(language, robot, q_before[pose_rows])
        after = configuration_numbers(language, robot, q[pose_rows])
        written = program.config[pose_rows, : before.shape[1]]
        for i, j in np.argwhere((written == before) & (after != before)).tolist():
            row = int(pose_rows[i])
            start, end = program.config_places[row, j].tolist()
            text_index = int(program.text_index[row])
            edits[text_index, start, end, -1] = Edit(text_index, start, end, str(int(after[i, j])))
            changed.append(row)
    return edited_texts(program.texts, [*edits.values()]), sorted({*changed})
