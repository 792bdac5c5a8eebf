"""Correct the motion targets of robot programs for the predicted deflection, in place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from stiff_apply.expected_error import expected_error
from stiff_apply.programs.configurations import choose_joints
from stiff_apply.programs.corrected_program import (
    Steps,
    correct_targets,
    corrected_rows,
    corrected_texts,
    left_rows,
    shared_targets,
)
from stiff_apply.programs.frames import ProgramPoses, controller_of, program_poses
from stiff_apply.programs.languages import read_program
from stiff_apply.programs.program import LeftMotion, RobotProgram, write_texts
from stiff_apply.tool_paths import CorrectedPath
from stiff_apply.tool_task import ToolTask, check_word, frame_matrix, tool_task
from stiff_bench.analysis.extrapolation import extrapolation_details
from stiff_bench.api.model import Model, wrap_model_errors
from stiff_bench.console import printable
from stiff_bench.parameter_types import (
    FilePath,
    Fraction,
    Frames,
    HeldJoints,
    Iterations,
    JointPositions,
    Load,
    Picture,
    Tolerance,
)
from stiff_bench.run.progress import display
from stiff_bench.tables.units import counted
from stiff_datasets.measured.sample_columns import MM_PER_M
from stiff_protocols.contract.display import MAX_RUNS_SHOWN, row_ranges
from stiff_protocols.contract.errors import ConfigError, DataError, ModelError
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.contract.types import BoolArray, Deflection, FloatArray, TextArray
from stiff_protocols.paths.compensation import MAX_ITERATIONS, TOLERANCE_M, Compensation

if TYPE_CHECKING:
    from stiff_bench.figures.prepared_figure import Prepared

ProgramLoadFrame = Literal["world", "base", "tool"]
FRAME_TEXTS = {
    "world": "world (the controller's world frame)",
    "base": "base (the program's base frame of each target)",
    "tool": "tool (the tool frame of each target)",
}
HELD_TOLERANCE = 0.01
"""deg or mm: external axes that differ less are at one place; controllers round them to 0.001."""


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
    left_motions: tuple[LeftMotion, ...]
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
                lines.append(f"{text}: {_line_numbers(numbers, MAX_RUNS_SHOWN)}")
        lines += self.notes
        if self.left_motions:
            lines.append(f"left as they were: {counted(len(self.left_motions), 'motion')}")
            lines += [f"  {text}" for text in _causes(self.left_motions)]
        return lines


def compensate_program(
    model: Model,
    program: FilePath,
    output: FilePath,
    *,
    load: Load | None = None,
    loads: FilePath | None = None,
    loads_template: FilePath | None = None,
    frame: ProgramLoadFrame = "world",
    tool: Frames | None = None,
    workpiece: Frames | None = None,
    start: JointPositions | None = None,
    hold: HeldJoints | None = None,
    harmless_calls: Sequence[str] = (),
    strict: bool = False,
    allow_steps: bool = False,
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
            `load`. A load of zero, of an approach, ends a path.
        loads_template: new table for `loads` with a row for each line with a motion.
        frame: frame of the loads: "world" (the controller's world frame), "base" (the program's
            base frame of each target) or "tool" (the tool frame of each target).
        tool: x, y, z [mm], a, b, c [deg] of a tool in the controller's flange frame, for tools
            that the program does not hold; several by number or name.
        workpiece: the same of a base frame in the controller's world frame.
        start: (n_joints,) joint positions of the model's robot near the first target, deg or mm;
            None: the middle of the training poses.
        hold: position of an external axis that does not move, deg or mm, by its name; base frames
            count from the robot there.
        harmless_calls: routine of another file that changes no frame and no displacement; may be
            repeated.
        strict: stop if a motion of a program cannot be corrected.
        allow_steps: write a program although a path steps between corrected and uncorrected
            targets.
        tolerance: remaining predicted error at which the iteration of a target ends, mm.
        iterations: largest number of predictions per target.
        coverage: coverage (0..1) of the printed intervals, per axis; None: 0.9.
        figure: new picture of the targets and of the removed deflection.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or a load is missing.
        DataError: the program cannot be read, or belongs to another robot or tool.
        ModelError: no target can be corrected, a path has steps, or `strict` and a motion is left.
        StoreError: a file cannot be written, or exists.
    """
    file, output = Path(program), Path(output)
    check_word("frame", frame, get_args(ProgramLoadFrame))
    if output.suffix.lower() != file.suffix.lower():
        raise ConfigError(f"{output}: use the extension of {file.name}", "output")
    source = read_program(file, harmless_calls)
    written = (output, *(output.with_suffix(path.suffix) for path in source.paths[1:]))
    task = tool_task(model, load=load, start=start, coverage=coverage, files=written, figure=figure)
    robot = task.robot
    if robot.n_joints != 6:
        raise DataError(
            f"{file}: only programs of robots with six joints can be corrected; {robot.name} has "
            f"{robot.n_joints}"
        )
    poses = program_poses(source, robot, tools=_frames(tool), workpieces=_frames(workpiece))
    given = _given_loads(source, task, loads)
    if loads_template is not None:
        from stiff_apply.programs.load_lines import write_loads_template

        check_new_file(Path(loads_template))
        write_loads_template(Path(loads_template), source, given)
    points = poses.points(robot)
    notes = _tool_notes(source, model, points)
    with display():
        problem = _moved_axes(source, poses.problem, hold or {})
        position, rotation, q, problem, fits = _joints(source, task, poses, points, problem)
        wrench, problem = _wrenches(source, task, poses, rotation, given, frame, problem)
        targets = correct_targets(
            partial(_prediction, model),
            robot,
            points[source.frame_index],
            position,
            rotation,
            q,
            wrench,
            problem,
            tolerance_m=tolerance / MM_PER_M,
            max_iterations=iterations,
        )
        is_loaded = (np.nan_to_num(given, nan=1.0) != 0.0).any(axis=1)
        targets, reasons = left_rows(source, targets, is_loaded)
        left_motions = _check_left_motions(source, reasons, is_loaded, strict, allow_steps)
        texts, changed = corrected_texts(source, robot, poses, targets, q)
        done = targets.converged
        levers = points[source.frame_index[done]] - robot.tcp
        acting = wrench[done].copy()
        acting[:, 3:] += np.cross(np.einsum("nij,nj->ni", rotation[done], levers), acting[:, :3])
        commanded_q, training_range = targets.q[done], model.training_range
        words = training_range.extrapolates(commanded_q, acting)
        path = CorrectedPath(
            output.stem,
            corrected_rows(targets),
            expected_error(model, commanded_q, acting, coverage),
            words,
            extrapolation_details(training_range, robot, commanded_q, acting, words),
        )
        write_texts(written, texts[: len(written)])
    if robot.controller is None:
        notes.append(
            f"{robot.name} has no <controller> in its URDF: joint angles and frames of the program "
            "count as the URDF's"
        )
    if not wrench.any():
        notes.append("all loads are zero, so there is nothing to correct")
    notes.append(f"frame of the loads: {FRAME_TEXTS[frame]}")
    corrected = CorrectedProgram(
        files=written,
        language=source.language.name,
        lines=tuple(source.lines.tolist()),
        path=path,
        left_motions=left_motions,
        targets=targets,
        changed_configurations=tuple(source.lines[changed].tolist()),
        unfit_configurations=tuple(source.lines[~fits].tolist()),
        notes=tuple(notes),
    )
    if figure is not None:
        corrected.plot().save(Path(figure))
    return corrected


def _frames(given: Any) -> dict[str, FloatArray]:
    """Return (4, 4) poses by number or name; "" for a frame without one."""
    frames = given if isinstance(given, Mapping) else {} if given is None else {"": given}
    return {str(name): frame_matrix(frame) for name, frame in frames.items()}


def _prediction(model: Model, point: FloatArray) -> Deflection:
    """Return the function that predicts deflections at a (3,) point of the last joint's frame."""
    if np.array_equal(point, model.fitted.robot_.tcp):
        return model.predict_at_tcp

    def predict(q: FloatArray, wrench: FloatArray) -> FloatArray:
        with wrap_model_errors(model.file):
            return np.asarray(model.fitted.predict_at_point(q, wrench, point))

    return predict


def _tool_notes(source: RobotProgram, model: Model, points: FloatArray) -> list[str]:
    """Return notes on the program's own tools; DataError if the model cannot predict there."""
    robot, notes = model.fitted.robot_, dict[str, None]()
    to_flange = np.linalg.inv(robot.flange @ controller_of(robot).flange)
    for index in dict.fromkeys(source.frame_index.tolist()):
        if np.isnan(points[index]).any() or np.array_equal(points[index], robot.tcp):
            continue
        own_point, measured = (
            ",".join(f"{number:g}" for number in (place[:3] * MM_PER_M).round(3) + 0.0)
            for place in (to_flange @ np.r_[point, 1.0] for point in (points[index], robot.tcp))
        )
        name = source.frames[index][1].name
        if not offers(model.fitted, "predict_at_point"):
            row = int(np.argmax(source.frame_index == index))
            raise DataError(
                f"{source.place(row)}: tool {name} has its TCP at {own_point} mm in the "
                f"flange frame (valid: {measured} mm: {model.name} learned deflections of this TCP "
                "only; spring models such as vjm predict at every TCP)"
            )
        notes[
            f"tool {name}: its TCP is at {own_point} mm in the flange frame, measured was the one "
            f"at {measured} mm: the springs predict there, with an error that grows with the lever"
        ] = None
    return [*notes]


def _moved_axes(
    source: RobotProgram, problem: TextArray, hold: Mapping[str, float | None]
) -> TextArray:
    """Return the problems, also of external axes that move or are not at a known place."""
    names, problem = source.language.external_names, problem.astype(object)
    places = {name.lower(): column for column, name in enumerate(names)}
    held = {}
    for name, value in hold.items():
        if name.lower() not in places or value is None:
            valid = ", ".join(f"{axis}=VALUE" for axis in names) or "no external axes"
            raise ConfigError(f"{name} (valid: {valid})", "hold")
        held[places[name.lower()]] = value
    for column, name in enumerate(names):
        axis = np.nan_to_num(source.external[:, column])
        if not axis.any() and column not in held:
            continue
        wrong = ~(np.abs(axis - held.get(column, np.nan)) <= HELD_TOLERANCE)
        place = held.get(column, axis[np.argmax(np.abs(axis))])
        span = f"from {axis.min():g} to {axis.max():g}" if np.ptp(axis) else f"at {axis[0]:g}"
        problem[wrong & (problem == "")] = (
            f"external axis {name} is {span} (--hold {name}={place:g} corrects the targets there)"
        )
    return problem.astype(str)


def _joints(
    source: RobotProgram,
    task: ToolTask,
    poses: ProgramPoses,
    points: FloatArray,
    problem: TextArray,
) -> tuple[FloatArray, FloatArray, FloatArray, TextArray, BoolArray]:
    """Return position, rotation, joints, problems and configuration fits of the targets."""
    robot = task.robot
    near = task.near if task.start is None else task.start
    lever = points[source.frame_index] - robot.tcp
    of_robot = poses.position - np.einsum("nij,nj->ni", poses.rotation, lever)
    q, problem, fits = choose_joints(
        source, robot, of_robot, poses.rotation, poses.q, near, problem
    )
    position, rotation = poses.position.copy(), poses.rotation.copy()
    joints = np.flatnonzero(source.has_joints)
    stands = robot.forward(q[joints])
    rotation[joints] = stands.rotation
    position[joints] = stands.points[:, -1] + np.einsum(
        "nij,nj->ni", stands.rotation, lever[joints]
    )
    return position, rotation, q, problem, fits


def _given_loads(source: RobotProgram, task: ToolTask, loads: Path | str | None) -> FloatArray:
    """Return (n_motions, 6) loads as they are given, N and N m; NaN for lines without one."""
    if (task.load is None) == (loads is None):
        valid = "valid: fx,fy,fz[,tx,ty,tz] in N and N m, or a file of loads by line"
        raise ConfigError(f"needed once, for {counted(len(source), 'target')} ({valid})", "load")
    if loads is not None:
        from stiff_apply.programs.load_lines import loads_by_line  # with pandas, half a second

        return loads_by_line(Path(loads), source)
    return np.tile(np.asarray(task.load), (len(source.motions), 1))


def _wrenches(
    source: RobotProgram,
    task: ToolTask,
    poses: ProgramPoses,
    rotation: FloatArray,
    given: FloatArray,
    frame: str,
    problem: TextArray,
) -> tuple[FloatArray, TextArray]:
    """Return (n, 6) loads in the description's base frame, N and N m, and the problems."""
    turn = np.broadcast_to(controller_of(task.robot).world[:3, :3], (len(source), 3, 3))
    if frame == "tool":
        turn = rotation @ poses.tools[source.frame_index][:, :3, :3]
    elif frame == "base":
        turn = poses.bases[source.frame_index][:, :3, :3]
    load = given[source.motion].reshape(-1, 2, 3)
    wrench = np.einsum("nij,nkj->nki", turn, load).reshape(-1, 6)
    wrench[~load.any(axis=(1, 2))] = 0.0
    is_unknown = np.isnan(wrench).any(axis=1)
    unknown = f"the {frame} frame of the load is not known"
    problem = np.where(is_unknown & (problem == ""), unknown, problem)
    return np.nan_to_num(wrench), problem


def _check_left_motions(
    source: RobotProgram,
    reasons: Mapping[int, str],
    is_loaded: BoolArray,
    strict: bool,
    allow_steps: bool,
) -> tuple[LeftMotion, ...]:
    """Return the motions that are left.

    Raises:
        ModelError: all are left, or `strict`; or not `allow_steps`, and a path has a step.
    """
    file, numbers = source.paths[0], np.arange(len(source.motions))
    is_corrected = np.isin(numbers, source.motion) & ~np.isin(numbers, [*reasons])
    shared = shared_targets(source, is_corrected)
    texts = dict(reasons)
    for uncorrected, corrected in shared.items():
        texts[uncorrected] = (
            f"{reasons[uncorrected]}; moves with line {source.motion_lines[corrected]}"
        )
    left_motions = tuple(source.left_motion(index, texts[index]) for index in sorted(texts))
    if left_motions and strict:
        first = left_motions[0]
        raise ModelError(
            f"{file}, line {first.line}: {_short(first.text)}: {first.reason} (strict: "
            f"{counted(len(left_motions), 'motion')} cannot be corrected)"
        )
    if not is_corrected.any():
        raise ModelError(f"{file}: no motion can be corrected: {'; '.join(_causes(left_motions))}")
    steps = Steps(source, is_corrected, is_loaded).steps
    steps |= {
        (corrected, uncorrected)
        for uncorrected, corrected in shared.items()
        if is_loaded[uncorrected] and source.motions[uncorrected].kind != "joint"
    }
    if steps and not allow_steps:
        corrected, uncorrected = min(steps, key=max)
        motion = source.left_motion(uncorrected, texts[uncorrected])
        more = f", and {counted(len(steps) - 1, 'step')} more" if len(steps) > 1 else ""
        raise ModelError(
            f"{file}: step in the path: line {source.motion_lines[corrected]} is corrected, line "
            f"{motion.line} is not: {_short(motion.text)}: {motion.reason}{more}. Left: "
            f"{'; '.join(_causes(left_motions))} (valid: a load of zero there, or --allow-steps)"
        )
    return left_motions


def _causes(left_motions: Sequence[LeftMotion]) -> list[str]:
    """Return a text per reason, with all lines."""
    by_reason: dict[str, list[LeftMotion]] = {}
    for motion in left_motions:
        by_reason.setdefault(motion.reason, []).append(motion)
    return [
        f"{_line_numbers([motion.line for motion in motions], None)}: {_short(motions[0].text)}: "
        f"{reason}"
        for reason, motions in by_reason.items()
    ]


def _short(text: str) -> str:
    return text if len(text) <= 50 else text[:47] + "..."


def _line_numbers(numbers: Sequence[int], most: int | None) -> str:
    return f"line{'s' * (len(numbers) > 1)} {row_ranges(numbers, most)}"
