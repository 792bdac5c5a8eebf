"""Write corrected targets into a program without other changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiff_datasets.programs.controller_poses import (
    ProgramPoses,
    controller_of,
    lengths_in_base,
    pose_numbers,
)
from stiff_datasets.programs.corrected_targets import CorrectedTargets
from stiff_datasets.programs.joint_choice import configuration_numbers
from stiff_datasets.programs.program_file import Edit, RobotProgram, edited_texts, number_text
from stiff_protocols.contract.types import FloatArray, IntArray, Robot

SAME_COMMAND_M, SAME_COMMAND_RAD = 1e-6, 1e-6
"""Differences up to which commands of one target are equal."""


def shared_target_conflicts(program: RobotProgram, targets: CorrectedTargets) -> IntArray:
    """Return the rows whose target also belongs to a motion with another command."""
    compensation = targets.at_targets
    key = np.column_stack([program.text_index, program.places[:, 0, 0]])
    _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
    first_row = first[group.ravel()]
    differs = (
        np.abs(compensation.position - compensation.position[first_row]).max(axis=1)
        > SAME_COMMAND_M
    )
    differs |= program.has_joints & (
        np.abs(compensation.q - compensation.q[first_row]).max(axis=1) > SAME_COMMAND_RAD
    )
    differs |= compensation.converged != compensation.converged[first_row]
    return np.asarray(np.flatnonzero(np.isin(first_row, first_row[differs])))


def corrected_texts(
    program: RobotProgram,
    robot: Robot,
    poses: ProgramPoses,
    targets: CorrectedTargets,
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
    compensation, index = targets.at_targets, program.frame_index
    position, q = compensation.position, compensation.q
    rows = np.flatnonzero(compensation.converged)
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
    edits = [*dict.fromkeys(edits), *_insertions(program, robot, poses, targets)]
    return edited_texts(program.texts, edits), sorted({*changed})


def _insertions(
    program: RobotProgram,
    robot: Robot,
    poses: ProgramPoses,
    targets: CorrectedTargets,
) -> list[Edit]:
    """Return the edits that insert motions between targets."""
    language, compensation = program.language, targets.compensation
    done = targets.at_targets.converged
    points = np.flatnonzero(~targets.is_target & compensation.converged & done[targets.row])
    if not len(points):
        return []
    index = program.frame_index[targets.row[points]]
    numbers = pose_numbers(
        language,
        poses.bases[index],
        poses.tools[index],
        compensation.position[points],
        targets.rotation[points],
    )
    config = configuration_numbers(language, robot, compensation.q[points]).astype(np.int64)
    texts = [_texts(values, language.decimals) for values in numbers.tolist()]
    return language.insert(program, targets.row[points].tolist(), texts, config.tolist())


def _texts(values: Sequence[float], decimals: tuple[int, int, int]) -> list[str]:
    """Return the texts of a pose's numbers."""
    return [
        number_text(value, "", decimals[0 if number < 3 else 2])
        for number, value in enumerate(values)
    ]
