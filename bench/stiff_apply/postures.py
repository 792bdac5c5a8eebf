"""Rank postures for a task: turns of the tool and branches of the arm, by deflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from stiff_apply.path_file import (
    LoadFrame,
    frame_matrix,
    read_path,
    six_numbers,
    tool_of,
)
from stiff_apply.posture_math import Direction
from stiff_apply.posture_search import PostureSearch, PostureTask
from stiff_apply.ranked_postures import RankedPostures
from stiff_apply.tool_paths import given_positions, held_positions
from stiff_bench.api.model import Model, wrap_model_errors
from stiff_bench.console import say
from stiff_bench.parameter_types import (
    Axis,
    Bounds,
    FilePath,
    Fraction,
    Frame,
    HeldJoints,
    JointPositions,
    Load,
    Picture,
)
from stiff_bench.run.progress import display
from stiff_bench.tables.picture_file import check_suffix
from stiff_datasets.measured.sample_columns import MM_PER_M, file_units
from stiff_datasets.measured.sheet_files import write_table
from stiff_protocols.contract.errors import ConfigError, StiffBenchError, unknown_name
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.types import FloatArray, frozen_array
from stiff_protocols.paths.inverse import LIMIT_SLACK
from stiff_protocols.paths.path import ToolPath

TURNS = 72


def axial_compliance(
    model: Model, q: FloatArray, axis: Sequence[float], force: float
) -> FloatArray:
    """Return the (n,) predicted deflections along an axis per force along it, m/N.

    Args:
        model: fitted model.
        q: (n, n_joints) rad or m.
        axis: (3,) unit vector in the frame of the robot description's last link.
        force: size of the force, N; it matters for models without linear springs.
    """
    arm: Robot = model.fitted.robot_
    along = arm.forward(q).rotation @ (arm.flange[:3, :3] @ np.asarray(axis))
    wrench = np.hstack([force * along, np.zeros((len(q), 3))])
    deflection = model.predict_at_tcp(q, wrench)
    return np.asarray(np.einsum("ni,ni->n", deflection, along) / force)


def rank_postures(
    model: Model,
    *,
    point: Frame | None = None,
    path: FilePath | None = None,
    load: Load | None = None,
    frame: LoadFrame = "base",
    tool: Frame | None = None,
    tool_axis: Axis = (0.0, 0.0, 1.0),
    direction: Direction = "along",
    given: JointPositions | None = None,
    turns: Annotated[int, Bounds(at_least=1, at_most=3600)] = TURNS,
    workpiece: Frame | None = None,
    hold: HeldJoints | None = None,
    coverage: Fraction | None = None,
    sheet: str | None = None,
    output: FilePath | None = None,
    figure: Picture | None = None,
) -> RankedPostures:
    """Rank the postures of an arm at a point, or along a path, by the predicted deflection.

    The turn of the tool about its axis and the branch of the arm (shoulder, elbow, wrist) are free.
    Postures beyond joint limits or near singularities are left out. Collisions are not checked.

    Args:
        model: fitted model of an arm with six revolute joints, apart from held joints.
        point: pose of the tool at the task point: x, y, z in mm and a, b, c in deg; by default the
            pose of `given`.
        path: task of several points: a tool path.
        load: (3,) or (6,) process load on the tool, in N and N m; a path may have its own loads.
        frame: frame that loads are expressed in; a load in the tool frame turns with the tool.
        tool: tool frame in the frame of the last link: x, y, z in mm and a, b, c in deg; by default
            the model's TCP with the axes of the last link.
        tool_axis: (3,) axis that the tool may turn about, in the tool frame.
        direction: part of the deflection to rank by: along or across the axis.
        given: (n_joints,) joint positions to compare with, at the (first) point, in deg or mm; by
            default the orientation of the point, in the configuration nearest to the training
            poses.
        turns: number of turns over 360 deg, counted from the given posture; along a path all points
            have the same.
        workpiece: frame of the point or path in the base frame: x, y, z in mm and a, b, c in deg;
            by default the base frame.
        hold: joint of a robot with more than six joints that is held at a value in deg or mm, by
            name or number (rail, J3, 3); without a value at the position in `given` or in the path.
            May be repeated.
        coverage: add the model's uncertainty: prediction intervals of this coverage (0..1).
        sheet: sheet of an Excel file; by default the only one with a table.
        output: new .csv file: all postures at a point, or the best one along the path.
        figure: new picture: the deflection over the turn.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or the load is missing.
        DataError: the path cannot be read, or no posture reaches the points.
        StoreError: a file cannot be written, or exists.
    """
    for kind, word, valid in (
        ("frame", frame, ("base", "tool")),
        ("direction", direction, ("along", "across")),
    ):
        if word not in valid:
            raise unknown_name(kind, word, valid)
    model.check_fitted()
    for file in (output, figure):
        if file is not None:
            check_new_file(Path(file))
    if figure is not None:
        check_suffix(Path(figure))
    model.check_coverage(coverage)
    arm: Robot = model.fitted.robot_
    start = _given_posture(arm, given)
    if path is None:
        task = _point_task(arm, point, start, load, frame, tool, workpiece, hold or {})
    elif point is not None:
        raise ConfigError("and path: give only one of them", "point")
    else:
        table = read_path(
            Path(path),
            arm,
            tool_of(arm, tool),
            sheet_name=sheet,
            load=load,
            frame=frame,
            workpiece=workpiece,
        )
        for oddity in table.oddities:
            say(f"warning: {oddity}")
        if table.q is not None and start is None:
            start = table.q[0]
        held = held_positions(arm, hold or {}, start)
        task = PostureTask(str(path), table.path, held, table.tool, frame, table.lines.tolist())
    if not task.path.wrench.any():
        raise ConfigError("is zero, so there is nothing to rank; give a load above 0", "load")
    search = PostureSearch(
        model, arm, task, _unit(tool_axis), direction, coverage, start, _checked_turns(turns)
    )
    with display(), wrap_model_errors(model.file, but=StiffBenchError):
        ranked = search.ranked()
    if output is not None:
        one_point = len(task.path) == 1
        write_table(Path(output), [ranked.table if one_point else search.course_table(ranked)])
    if figure is not None:
        ranked.plot().save(Path(figure))
    return ranked


def _point_task(
    robot: Robot,
    point: Sequence[float] | None,
    start: FloatArray | None,
    load: Sequence[float] | None,
    frame: LoadFrame,
    tool: Sequence[float] | None,
    workpiece: Sequence[float] | None,
    hold: Mapping[str, float | None],
) -> PostureTask:
    """Return the task at one point; by default at the given posture."""
    tool_frame = tool_of(robot, tool)
    if load is None:
        raise ConfigError("is missing (valid: fx,fy,fz[,tx,ty,tz] in N and N m)", "load")
    wrench = np.array(six_numbers(load))
    if point is not None:
        pose = (np.eye(4) if workpiece is None else frame_matrix(workpiece)) @ frame_matrix(point)
        position, rotation = pose[:3, 3], pose[:3, :3] @ tool_frame[:3, :3].T
    elif start is not None:
        poses = robot.forward(start[None])
        position, rotation = poses.points[0, -1], poses.rotation[0]
    else:
        raise ConfigError(
            "is missing (valid: x,y,z,a,b,c in mm and deg, or --given, or --path)", "point"
        )
    if frame == "tool":
        wrench = (wrench.reshape(2, 3) @ (rotation @ tool_frame[:3, :3]).T).ravel()
    place = ",".join(f"{length:.6g}" for length in MM_PER_M * position)
    path = ToolPath("point", position[None], rotation[None], wrench[None])
    held = held_positions(robot, hold, start)
    return PostureTask(f"point {place} mm", path, held, tool_frame, frame, None)


def _given_posture(robot: Robot, given: Sequence[float] | None) -> FloatArray | None:
    """Return the given (n_joints,) posture, rad or m, after a check of joint limits."""
    if given is None:
        return None
    q, units = given_positions(robot, given, "given"), file_units(robot)
    beyond = (q < robot.lower - LIMIT_SLACK) | (q > robot.upper + LIMIT_SLACK)
    if beyond.any() or not np.isfinite(q).all():
        joint = int(np.argmax(beyond | ~np.isfinite(q)))
        low, high = robot.lower[joint] * units[joint], robot.upper[joint] * units[joint]
        raise ConfigError(
            f"joint {robot.joint_names[joint]} at {given[joint]:g} (valid: {low:g}..{high:g}, its "
            "limits)",
            "given",
        )
    return q


def _unit(axis: Sequence[float]) -> FloatArray:
    vector = frozen_array(axis, "tool_axis", (3,))
    length = np.linalg.norm(vector)
    if length < 1e-9:
        raise ConfigError("0,0,0 has no direction (valid: x,y,z of an axis)", "tool-axis")
    return np.asarray(vector / length)


def _checked_turns(turns: int) -> int:
    if turns < 1:
        raise ConfigError(f"{turns} (valid: at least 1)", "turns")
    return turns
