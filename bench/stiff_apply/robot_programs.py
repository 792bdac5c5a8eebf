"""Correct the motion targets of robot programs for the predicted deflection, in place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stiff_apply.expected_error import expected_error
from stiff_apply.programs.controller_poses import ProgramPoses, controller_of, program_poses
from stiff_apply.programs.corrected_program import corrected_texts, shared_target_conflicts
from stiff_apply.programs.corrected_targets import (
    correct_targets,
    corrected_rows,
    without_rows,
)
from stiff_apply.programs.joint_choice import SINGULAR, choose_joints
from stiff_apply.programs.load_lines import loads_by_line
from stiff_apply.programs.program_file import RobotProgram, write_texts
from stiff_apply.programs.program_reader import read_program
from stiff_apply.tool_paths import CorrectedPath
from stiff_apply.tool_task import LoadFrame, ToolTask, frame_matrix, tool_task
from stiff_bench.api.model import Model
from stiff_bench.console import printable
from stiff_bench.parameter_types import (
    FilePath,
    Fraction,
    Frame,
    Iterations,
    JointPositions,
    Load,
    Picture,
    Tolerance,
)
from stiff_bench.run.progress import display
from stiff_bench.tables.units import counted
from stiff_datasets.measured.rows_beyond_training import extrapolation_details
from stiff_datasets.measured.sample_columns import MM_PER_M
from stiff_protocols.contract.errors import ConfigError, DataError, ModelError
from stiff_protocols.contract.types import BoolArray, FloatArray, TextArray
from stiff_protocols.paths.compensation import MAX_ITERATIONS, TOLERANCE_M, Compensation

if TYPE_CHECKING:
    from stiff_bench.figures.prepared_figure import Prepared

SHARED = "another motion has this target with another command"
MOST_LISTED = 10
"""Largest number of listed motions or lines in the text."""


@dataclass(frozen=True, eq=False)
class LeftTarget:
    """A motion that was not corrected.

    Attributes:
        line: line of the program, from 1.
        text: statement.
        reason: reason why it was not corrected.
    """

    line: int
    text: str
    reason: str


@dataclass(frozen=True, eq=False)
class CorrectedProgram:
    """A robot program with corrected targets, which put the loaded tool at the original ones.

    Attributes:
        files: written files.
        language: language of the program.
        lines: (n,) line of each motion.
        path: corrected targets, in the order of the program.
        left_motions: motions that were not corrected.
        targets: points, commands and predicted deflections.
        changed_configurations: lines whose written configuration has new numbers.
        unfit_configurations: lines whose written configuration does not fit the pose.
        notes: further notes, one per line.
    """

    files: tuple[Path, ...]
    language: str
    lines: tuple[int, ...]
    path: CorrectedPath
    left_motions: tuple[LeftTarget, ...]
    targets: Compensation
    changed_configurations: tuple[int, ...]
    unfit_configurations: tuple[int, ...]
    notes: tuple[str, ...]

    def plot(self) -> Prepared:
        """Return the picture of the targets, with removed and expected errors."""
        return self.path.plot()

    def __repr__(self) -> str:
        """Return a text on corrected targets, expected errors and other motions."""
        return printable("\n".join(self._lines()))

    def _lines(self) -> list[str]:
        """Return the lines of the text."""
        lines = repr(self.path).split("\n")
        lines[1] = f"{len(self.path.removed)} of {counted(len(self.lines), 'target')} corrected"
        for text, numbers in (
            ("status, turn or quadrants written again", self.changed_configurations),
            ("configuration does not fit the pose", self.unfit_configurations),
        ):
            if numbers:
                lines.append(f"{text}: {_listed([f'line {number}' for number in numbers])}")
        lines += self.notes
        if self.left_motions:
            lines.append(f"left as they were: {counted(len(self.left_motions), 'motion')}")
            lines += [
                f"  line {target.line}: {_short(target.text)}: {target.reason}"
                for target in self.left_motions[:MOST_LISTED]
            ]
            if len(self.left_motions) > MOST_LISTED:
                lines.append(f"  and {len(self.left_motions) - MOST_LISTED} more")
        return lines


def compensate_program(
    model: Model,
    program: FilePath,
    output: FilePath,
    *,
    load: Load | None = None,
    loads: FilePath | None = None,
    frame: LoadFrame = "base",
    tool: Frame | None = None,
    workpiece: Frame | None = None,
    start: JointPositions | None = None,
    strict: bool = False,
    tolerance: Tolerance = MM_PER_M * TOLERANCE_M,
    iterations: Iterations = MAX_ITERATIONS,
    coverage: Fraction | None = None,
    figure: Picture | None = None,
) -> CorrectedProgram:
    """Correct the motion targets of a robot program, and write it back in place.

    All other characters are unchanged. Targets that cannot be corrected are not changed but listed.

    Args:
        model: fitted model.
        program: robot program, in place of a path: KUKA .src (with its .dat), ABB .mod, FANUC .ls
            or URScript .script. It is written back with corrected targets; every other character
            stays as it was.
        output: new file with the same suffix; a .dat is written next to it.
        load: (3,) or (6,) process load at every target, N and N m.
        loads: loads of a program by line: columns line, fx_N, fy_N, fz_N and torques; in place of
            `load`.
        frame: frame of the loads: "base" (the controller's base frame) or "tool" (the tool frame of
            each target).
        tool: x, y, z [mm], a, b, c [deg] of the tool in the controller's flange frame, for a
            program without tool data.
        workpiece: x, y, z [mm], a, b, c [deg] of the base frame in the controller's world frame,
            for a program without base data.
        start: (n_joints,) joint positions of the model's robot near the first target, deg or mm;
            None: the middle of the training poses.
        strict: stop if a motion of a program cannot be corrected.
        tolerance: remaining predicted error at which the iteration of a target ends, mm.
        iterations: largest number of predictions per target.
        coverage: coverage (0..1) of the printed intervals, per axis; None: 0.9.
        figure: new picture of the targets and of the removed deflection.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or a frame or load is missing.
        DataError: the program cannot be read, belongs to another robot or tool, or has a target
            that cannot be reached.
        ModelError: `strict`, and a target cannot be corrected.
        StoreError: a file cannot be written, or exists.
    """
    file, output = Path(program), Path(output)
    if output.suffix.lower() != file.suffix.lower():
        raise ConfigError(f"{output}: use the extension of {file.name}", "output")
    source = read_program(file)
    written = (output, *(output.with_suffix(path.suffix) for path in source.paths[1:]))
    task = tool_task(
        model,
        load=load,
        frame=frame,
        start=start,
        coverage=coverage,
        files=written,
        figure=figure,
    )
    robot = task.robot
    poses = program_poses(
        source,
        robot,
        tool=None if tool is None else frame_matrix(tool),
        workpiece=None if workpiece is None else frame_matrix(workpiece),
    )
    with display():
        position, rotation, q, problem, fits = _joints(source, task, poses)
        wrench = _wrenches(source, task, poses, rotation, loads)
        targets = correct_targets(
            model.predict_at_tcp,
            robot,
            position,
            rotation,
            q,
            wrench,
            problem,
            tolerance_m=tolerance / MM_PER_M,
            max_iterations=iterations,
        )
        conflicts = shared_target_conflicts(source, targets)
        targets = without_rows(targets, conflicts, SHARED)
        left_targets = _left_targets(source, targets.problem.tolist())
        if left_targets and strict:
            first = left_targets[0]
            raise ModelError(
                f"{file}, line {first.line}: {_short(first.text)}: {first.reason} (strict: "
                f"{counted(len(left_targets), 'motion')} cannot be corrected)"
            )
        if not targets.converged.any():
            raise ModelError(f"{file}: none of {counted(len(source), 'target')} can be corrected")
        texts, changed = corrected_texts(source, robot, poses, targets, q)
        done = targets.converged
        commanded_q, acting = targets.q[done], wrench[done]
        training_range = model.training_range
        words = training_range.extrapolates(commanded_q, acting)
        path = CorrectedPath(
            output.stem,
            corrected_rows(targets),
            expected_error(model, commanded_q, acting, coverage),
            words,
            extrapolation_details(training_range, robot, commanded_q, acting, words),
        )
        write_texts(written, texts)
    notes = []
    if robot.controller is None:
        notes.append(
            f"{robot.name} has no <controller> in its URDF: joint angles and frames of the program "
            "count as the URDF's"
        )
    if not wrench.any():
        notes.append("all loads are zero, so there is nothing to correct")
    corrected = CorrectedProgram(
        files=written,
        language=source.language.name,
        lines=tuple(source.lines.tolist()),
        path=path,
        left_motions=left_targets,
        targets=targets,
        changed_configurations=tuple(source.lines[changed].tolist()),
        unfit_configurations=tuple(source.lines[~fits].tolist()),
        notes=tuple(notes),
    )
    if figure is not None:
        corrected.plot().save(Path(figure))
    return corrected


def _joints(
    source: RobotProgram, task: ToolTask, poses: ProgramPoses
) -> tuple[FloatArray, FloatArray, FloatArray, TextArray, BoolArray]:
    """Return position, rotation, joints, problems and configuration fits of the targets."""
    robot = task.robot
    if robot.n_joints != 6:
        raise DataError(
            f"{source.paths[0]}: only programs of robots with six joints can be corrected; "
            f"{robot.name} has {robot.n_joints}"
        )
    near = task.near if task.start is None else task.start
    chosen = choose_joints(source, robot, poses.position, poses.rotation, poses.q, near)
    wrong = np.flatnonzero(
        (chosen.problem != "")
        & ~source.has_joints
        & ((chosen.problem != SINGULAR) | source.is_linear)
    )
    if len(wrong):
        row = int(wrong[0])
        count = source.language.n_turns + 3
        pose = ",".join(f"{value:g}" for value in source.values[row, :count])
        valid = chosen.possible.get(row, f"a pose that {robot.name} reaches")
        raise DataError(
            f"{source.place(row)}: target {pose}: {chosen.problem[row]} ({valid}); "
            f"{counted(len(wrong), 'target')} like this"
        )
    position, rotation = poses.position.copy(), poses.rotation.copy()
    joints = np.flatnonzero(source.has_joints)
    stands = robot.forward(chosen.q[joints])
    position[joints], rotation[joints] = stands.points[:, -1], stands.rotation
    return position, rotation, chosen.q, chosen.problem, chosen.config_fits


def _wrenches(
    source: RobotProgram,
    task: ToolTask,
    poses: ProgramPoses,
    rotation: FloatArray,
    loads: Path | str | None,
) -> FloatArray:
    """Return (n, 6) loads in the description's base frame, N and N m."""
    if (task.load is None) == (loads is None):
        valid = "valid: fx,fy,fz[,tx,ty,tz] in N and N m, or a file of loads by line"
        raise ConfigError(f"needed once, for {counted(len(source), 'target')} ({valid})", "load")
    if loads is None:
        given = np.tile(np.asarray(task.load), (len(source), 1))
    else:
        given = loads_by_line(Path(loads), source)
    turn = np.broadcast_to(controller_of(task.robot).world[:3, :3], (len(source), 3, 3))
    if task.frame == "tool":
        turn = rotation @ poses.tools[source.frame_index][:, :3, :3]
    turned = np.einsum("nij,nkj->nki", turn, given.reshape(-1, 2, 3))
    return np.asarray(turned.reshape(-1, 6))


def _left_targets(source: RobotProgram, reasons: Sequence[str]) -> tuple[LeftTarget, ...]:
    """Return the motions that were not corrected, in the order of the program."""
    text = source.texts[0]
    left_targets = [
        LeftTarget(source.line(motion.start), motion.text, motion.reason)
        for motion in source.left_motions
    ]
    for row, reason in enumerate(reasons):
        if reason:
            start, end = source.statements[row]
            left_targets.append(LeftTarget(int(source.lines[row]), text[start:end], reason))
    return tuple(sorted(left_targets, key=lambda target: target.line))


def _short(text: str) -> str:
    words = " ".join(text.split())
    return words if len(words) <= 50 else words[:47] + "..."


def _listed(texts: Sequence[str]) -> str:
    n_more = len(texts) - MOST_LISTED
    return ", ".join(texts[:MOST_LISTED]) + (f" and {n_more} more" if n_more > 0 else "")
