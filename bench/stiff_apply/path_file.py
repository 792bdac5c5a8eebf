"""Read and write tool paths as CSV, Excel or Parquet files: one row per point, in path order.

Columns: ``x_mm, y_mm, z_mm`` of the TCP and the orientation of the tool, ``a_deg, b_deg, c_deg``
(KUKA: about Z, then the new Y, then the new X) or the quaternion ``qw, qx, qy, qz``; or, in place
of both, the joint positions ``q1_deg .. qn_deg`` as in a measurement. The process load ``fx_N,
fy_N, fz_N`` acts on the tool at the TCP; ``tx_Nm, ty_Nm, tz_Nm`` are zero if they are missing.
A column ``frame`` may name the frame of the poses, the same in every row.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_apply.rotations import (
    euler_angles,
    euler_rotations,
    quaternion_rotations,
)
from stiff_apply.tool_task import LoadFrame, frame_matrix, six_numbers
from stiff_bench.console import say
from stiff_datasets.measured.query_file import interval_columns
from stiff_datasets.measured.row_checks import (
    FULL_TURN_RAD,
    NO_TORQUE,
    Problem,
    cell_problem,
    checked_table,
    limit_problems,
    problems_error,
    radian_problems,
)
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    MM_PER_M,
    WRENCH_COLUMNS,
    file_units,
    joint_columns,
)
from stiff_datasets.measured.table_reader import Sheet, read_sheet, write_table
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import FloatArray, IntArray, Interval, Robot
from stiff_protocols.paths.compensation import Compensation
from stiff_protocols.paths.inverse import SINGULAR, Followed
from stiff_protocols.paths.path import ToolPath

POSITION_COLUMNS = ("x_mm", "y_mm", "z_mm")
ANGLE_COLUMNS = ("a_deg", "b_deg", "c_deg")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
FRAME_COLUMN, BASE = "frame", "base"

MIN_POSITION_MM = 10.0
"""No path has all of its points this near to the base; such a file holds metres."""
QUATERNION_TOLERANCE = 1e-3
"""Tolerance of the length of a quaternion, which is 1."""


@dataclass(frozen=True, eq=False)
class PathTable:
    """The points of a file, checked.

    Attributes:
        path: poses and loads, base frame, SI.
        q: (n, n_joints) joint positions if the file has them in place of poses, rad or m; else
            None.
        tool: (4, 4) tool frame in the last joint's frame, m.
        frame: (4, 4) frame of the file's poses in the base frame, m.
        frame_name: name of that frame.
        columns: orientation and load as in the file, in its units.
        lines: (n,) numbers of the rows, for messages.
    """

    path: ToolPath
    q: FloatArray | None
    tool: FloatArray
    frame: FloatArray
    frame_name: str
    columns: pd.DataFrame
    lines: IntArray

    @property
    def pose_columns(self) -> str:
        """Names of the columns of the pose or the joint positions, for messages."""
        return ",".join(POSITION_COLUMNS) if self.q is None else "q1 and following"


def read_path(
    file: Path,
    robot: Robot,
    tool: FloatArray,
    *,
    sheet_name: str | None = None,
    load: Sequence[float] | None = None,
    frame: LoadFrame = "base",
    workpiece: Sequence[float] | None = None,
) -> PathTable:
    """Read the points of a path; what looks odd in the file is a warning on standard error.

    Args:
        file: Parquet or Excel if it ends in .parquet or .xlsx, else CSV.
        robot: gives the joints and their limits, and the place of the TCP.
        tool: (4, 4) in the last joint's frame, m (`tool_of`).
        sheet_name: sheet of an Excel file; None: the only sheet with a table.
        load: (3,) or (6,) N and N m at every point, for a file without loads.
        frame: frame of the loads.
        workpiece: x, y, z [mm], a, b, c [deg] of the poses' frame in the base frame; None: poses
            are in the base frame.

    Raises:
        DataError: the file is unreadable, or its header or a value is invalid; the message names
            file, row, column, value and valid values.
        ConfigError: the file does not have the sheet; `load` is invalid or the file has loads, too;
            or `workpiece` is missing or not needed.
    """
    frame_pose = np.eye(4) if workpiece is None else frame_matrix(workpiece)
    joints = joint_columns(robot)
    poses = (*POSITION_COLUMNS, *ANGLE_COLUMNS, *QUATERNION_COLUMNS)
    sheet = read_sheet(file, sheet_name)
    sheet = sheet.with_standard_columns((*poses, *joints, *WRENCH_COLUMNS, FRAME_COLUMN))
    file_columns = set(sheet.cells)
    orientation_columns = [
        columns_of_kind
        for columns_of_kind in (ANGLE_COLUMNS, QUATERNION_COLUMNS, joints)
        if file_columns & {*columns_of_kind}
    ]
    by_joints = orientation_columns == [joints]
    if len(orientation_columns) > 1 or (by_joints and file_columns & {*POSITION_COLUMNS}):
        conflicting_names = ", ".join(name for name in sheet.cells if name in {*poses, *joints})
        valid = f"{','.join(POSITION_COLUMNS)} with {','.join(ANGLE_COLUMNS)} or "
        valid += f"{','.join(QUATERNION_COLUMNS)}; or {','.join(joints)}"
        raise problems_error(
            file, [Problem(f"header: more than one of these: {conflicting_names}", valid)]
        )
    given_load = None if load is None else six_numbers(load)
    if load is not None and file_columns & {*WRENCH_COLUMNS}:
        raise ConfigError(f"{file} has load columns, too; give the load only once", "load")
    angle_columns = orientation_columns[0] if orientation_columns else ANGLE_COLUMNS
    place_columns = joints if by_joints else (*POSITION_COLUMNS, *angle_columns)
    columns, usual = (*place_columns, *WRENCH_COLUMNS), NO_TORQUE
    if load is not None:
        columns, usual = place_columns, {}
    sheet, numbers, problems = checked_table(sheet, columns, usual, (FRAME_COLUMN,))
    numbers, wrench = np.split(numbers, [len(place_columns)], axis=1)
    if load is not None:
        wrench = np.tile(np.array(given_load), (len(numbers), 1))
    extra_joints = [name for name in sheet.unused if re.match(r"[aq]\d", name.lower())]
    if by_joints and extra_joints:
        valid_joints = f"the {robot.n_joints} joints of {robot.name}"
        problems.append(Problem(f"header: further joints {', '.join(extra_joints)}", valid_joints))
    if not problems and by_joints:
        problems = [*radian_problems(numbers, robot), *limit_problems(sheet, numbers, robot)]
    elif not problems:
        problems = [*_pose_problems(sheet, numbers, angle_columns)]
    frame_name, frame_problems = _frame_name(sheet, workpiece)
    if problems := [*problems, *frame_problems]:
        raise problems_error(file, problems)
    q, output_columns = None, pd.DataFrame(dict(zip(place_columns[3:], numbers.T[3:], strict=True)))
    if by_joints:
        q = numbers / file_units(robot)
        flange_poses = robot.forward(q)
        position, rotation = flange_poses.points[:, -1], flange_poses.rotation
        output_columns = _rounded(_euler_columns(frame_pose[:3, :3].T @ rotation @ tool[:3, :3]))
    else:
        position = numbers[:, :3] / MM_PER_M @ frame_pose[:3, :3].T + frame_pose[:3, 3]
        rotation = frame_pose[:3, :3] @ _rotations(numbers[:, 3:]) @ tool[:3, :3].T
    output_columns = output_columns.assign(**dict(zip(WRENCH_COLUMNS, wrench.T, strict=True)))
    if frame == "tool":
        tools = rotation @ tool[:3, :3]
        wrench = np.einsum("nij,nkj->nki", tools, wrench.reshape(-1, 2, 3)).reshape(-1, 6)
    for oddity in _oddities(sheet, numbers[:, 3:], angle_columns):
        say(f"warning: {oddity}")
    return PathTable(
        path=ToolPath(file.stem, position, rotation, wrench),
        q=q,
        tool=tool,
        frame=frame_pose,
        frame_name=frame_name,
        columns=output_columns,
        lines=sheet.lines,
    )


def path_problems(table: PathTable, robot: Robot, inverse: Followed) -> list[Problem]:
    """Return the rows that the robot cannot reach, each with one reason.

    Args:
        table: the path.
        robot: the robot that executes the path.
        inverse: joint positions of its rows.
    """
    problems, units = [], file_units(robot)
    in_frame = (table.path.position - table.frame[:3, 3]) @ table.frame[:3, :3] * MM_PER_M
    for row in np.flatnonzero(~inverse.ok):
        joint = int(np.argmax(inverse.beyond[row]))
        if not inverse.reached[row]:
            value = ",".join(f"{length:.6g}" for length in in_frame[row])
            valid = f"a pose that {robot.name} reaches in this configuration"
        elif inverse.beyond[row, joint]:
            ends = robot.lower[joint], robot.upper[joint], inverse.q[row, joint]
            low, high, at = (length * units[joint] for length in ends)
            value = f"joint {robot.joint_names[joint]} at {at:.6g}"
            unit = joint_columns(robot)[joint].rpartition("_")[2]
            valid = f"{low:g}..{high:g} {unit}, its limits"
        elif inverse.flips[row]:
            value = "another configuration of shoulder, elbow or wrist than in the row before"
            valid = "one configuration along the path"
        else:
            value = f"singular, condition of the Jacobian {inverse.condition[row]:.3g}"
            valid = f"at most {SINGULAR:g}; e.g. a wrist that is not straight"
        problems.append(Problem(value, valid, int(table.lines[row]), table.pose_columns))
    return problems


def write_path(path: Path, tool_path: ToolPath, tool: FloatArray) -> None:
    """Write a path to a new file, in the base frame, with KUKA's angles.

    Args:
        path: Parquet if it ends in .parquet, else CSV.
        tool_path: the path.
        tool: (4, 4) in the last joint's frame, m.
    """
    numbers = dict(zip(POSITION_COLUMNS, tool_path.position.T * MM_PER_M, strict=True))
    numbers |= _euler_columns(tool_path.rotation @ tool[:3, :3])
    numbers |= dict(zip(WRENCH_COLUMNS, tool_path.wrench.T, strict=True))
    write_table(path, [_rounded(numbers).assign(frame=BASE)])


def corrected_table(
    table: PathTable,
    robot: Robot,
    compensation: Compensation,
    extrapolates: Sequence[str],
    expected_error: FloatArray | None,
    half_width: FloatArray | None,
    interval: Interval | None = None,
) -> pd.DataFrame:
    """Return the commands of a corrected path as a table of a file.

    Args:
        table: the target points.
        robot: robot of the joint positions.
        compensation: the commands, of the same rows.
        extrapolates: (n,) quantities of a row beyond the training range.
        expected_error: (n,) expected mean distance from the target point, m; None: not known, and
            the column is empty.
        half_width: (n,) half width of the interval of that distance, m; None: not known.
        interval: interval of the deflections at the commands.
    """
    local_position = (compensation.position - table.frame[:3, 3]) @ table.frame[
        :3, :3
    ]  # file's frame
    lengths = dict(zip(DEFLECTION_COLUMNS, compensation.deflection.T, strict=True))
    if interval is not None:
        lengths |= interval_columns(interval)
    unknown_error = np.full(len(compensation.target), np.nan)
    lengths["removed_mm"] = np.linalg.norm(compensation.removed, axis=1)
    lengths["expected_error_mm"] = unknown_error if expected_error is None else expected_error
    lengths["half_width_mm"] = unknown_error if half_width is None else half_width
    loads = table.columns[[*WRENCH_COLUMNS]]
    joints = dict(zip(joint_columns(robot), (compensation.q * file_units(robot)).T, strict=True))
    parts = [
        _rounded(dict(zip(POSITION_COLUMNS, local_position.T * MM_PER_M, strict=True))),
        table.columns.drop(columns=[*WRENCH_COLUMNS]),
        _rounded(joints),
        loads,
        _rounded({name: values * MM_PER_M for name, values in lengths.items()}),
    ]
    words = {"extrapolates": list(extrapolates), "uncorrected": compensation.problem.tolist()}
    return pd.concat(parts, axis=1).assign(**words, frame=table.frame_name)


def _rounded(columns: Mapping[str, FloatArray]) -> pd.DataFrame:
    """Round lengths [mm], angles [deg] or loads to 1e-8, without -0."""
    return pd.DataFrame(columns).round(8) + 0.0


def _rotations(numbers: FloatArray) -> FloatArray:
    """Return (n, 3, 3) rotations of (n, 3) KUKA's angles [deg] or (n, 4) quaternions, w first."""
    if numbers.shape[1] == 4:
        return quaternion_rotations(numbers)
    return euler_rotations("ZYX", numbers)


def _euler_columns(rotation: FloatArray) -> dict[str, FloatArray]:
    """Return KUKA's angles of (n, 3, 3) rotations."""
    return dict(zip(ANGLE_COLUMNS, euler_angles("ZYX", rotation).T, strict=True))


def _pose_problems(sheet: Sheet, numbers: FloatArray, angles: tuple[str, ...]) -> Iterator[Problem]:
    position, turn = numbers[:, :3], numbers[:, 3:]
    if np.abs(position).max() <= MIN_POSITION_MM:
        yield Problem(
            f"every position lies within +-{MIN_POSITION_MM:g} mm of the frame's origin; "
            "the columns x_mm.. are in mm, these look like metres",
            "",
        )
    if angles == QUATERNION_COLUMNS:
        lengths = np.linalg.norm(turn, axis=1)
        for row in np.flatnonzero(np.abs(lengths - 1.0) > QUATERNION_TOLERANCE):
            valid = f"a quaternion of length 1, here {lengths[row]:.4g}"
            yield cell_problem(sheet, row, QUATERNION_COLUMNS[0], valid)


def _oddities(sheet: Sheet, turn: FloatArray, angles: tuple[str, ...]) -> Iterator[str]:
    yield from sheet.oddities
    if angles == ANGLE_COLUMNS and (np.abs(turn) <= FULL_TURN_RAD).all() and np.ptp(turn) > 1.0:
        yield (
            f"{sheet.path}: every angle of the orientation lies within +-{FULL_TURN_RAD:.2f} deg; "
            "the columns a_deg.. are in degrees, these look like radians"
        )


def _frame_name(sheet: Sheet, workpiece: Sequence[float] | None) -> tuple[str, list[Problem]]:
    """Return the name of a file's frame, and the problems of rows with another."""
    usual = BASE if workpiece is None else "workpiece"
    if FRAME_COLUMN not in sheet.cells:
        return usual, []
    names = sheet.cells[FRAME_COLUMN].astype(str)
    names = names.where(names != "", usual)
    first = names.iloc[0]
    if (first == BASE) != (workpiece is None):
        frame_hint = "give its pose in the base frame (valid: x,y,z,a,b,c in mm and deg)"
        hint = "leave this option out" if first == BASE else frame_hint
        raise ConfigError(f"{sheet.path} is in the frame {first!r}; {hint}", "workpiece")
    other_rows = np.flatnonzero((names != first).to_numpy())
    valid = f"{first!r}, the frame of the first row"
    return first, [cell_problem(sheet, row, FRAME_COLUMN, valid) for row in other_rows]
