"""Write corrected targets into a program without other changes."""

from __future__ import annotations

import numpy as np

from stiff_apply.programs.controller_poses import (
    ProgramPoses,
    controller_of,
    lengths_in_base,
)
from stiff_apply.programs.joint_choice import configuration_numbers
from stiff_apply.programs.program_file import Edit, RobotProgram, edited_texts, number_text
from stiff_protocols.contract.types import FloatArray, IntArray, Robot
from stiff_protocols.paths.compensation import Compensation

SAME_COMMAND_M, SAME_COMMAND_RAD = 1e-6, 1e-6
"""Differences up to which commands of one target are equal."""


def shared_target_conflicts(program: RobotProgram, targets: Compensation) -> IntArray:
    """Return the rows whose target also belongs to a motion with another command."""
    key = np.column_stack([program.text_index, program.places[:, 0, 0]])
    _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    first_row = first[group.ravel()]
    differs = np.abs(targets.position - targets.position[first_row]).max(axis=1) > SAME_COMMAND_M
    differs |= program.has_joints & (
        np.abs(targets.q - targets.q[first_row]).max(axis=1) > SAME_COMMAND_RAD
    )
    differs |= targets.converged != targets.converged[first_row]
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
    edits: list[Edit] = []
    language = program.language
    index, position, q = program.frame_index, targets.position, targets.q
    rows = np.flatnonzero(targets.converged)
    pose_rows, joint_rows = rows[~program.has_joints[rows]], rows[program.has_joints[rows]]
    numbers = np.full((len(program), 7), np.nan)
    if len(pose_rows):
        bases = poses.bases[index[pose_rows]]  # orientations do not change
        numbers[pose_rows, :3] = lengths_in_base(language, bases, position[pose_rows])
    if len(joint_rows):
        angles = controller_of(robot).from_description(q[joint_rows]) / language.radians
        numbers[joint_rows, : robot.n_joints] = angles
    edited_places = set[tuple[int, int]]()
    for row in rows.tolist():
        text_index = int(program.text_index[row])
        decimals = language.decimals[1 if program.has_joints[row] else 0]
        text = program.texts[text_index]
        target_place = (text_index, int(program.places[row, 0, 0]))
        if target_place in edited_places:
            continue
        edited_places.add(target_place)
        for value, (start, end) in zip(
            numbers[row].tolist(), program.places[row].tolist(), strict=True
        ):
            if value == value:
                edits.append(
                    Edit(text_index, start, end, number_text(value, text[start:end], decimals))
                )
    changed = []
    if program.config.size and len(pose_rows):
        before = configuration_numbers(language, robot, q_before[pose_rows])
        after = configuration_numbers(language, robot, q[pose_rows])
        written = program.config[pose_rows, : before.shape[1]]
        for i, j in np.argwhere((written == before) & (after != before)).tolist():
            row = int(pose_rows[i])
            start, end = program.config_places[row, j].tolist()
            text_index = int(program.text_index[row])
            edits.append(Edit(text_index, start, end, str(int(after[i, j]))))
            changed.append(row)
    return edited_texts(program.texts, [*dict.fromkeys(edits)]), sorted({*changed})
