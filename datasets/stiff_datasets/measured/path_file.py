"""Tool paths as files, CSV, Excel or Parquet: one row a point, in the order of the path.

Columns: ``x_mm, y_mm, z_mm`` of the TCP and the orientation of the tool, ``a_deg, b_deg, c_deg``
(KUKA: about Z, then the new Y, then the new X) or the quaternion ``qw, qx, qy, qz``; or, in place
of both, the joint positions ``q1_deg .. qn_deg`` as in a measurement. The process load ``fx_N,
fy_N, fz_N`` acts on the tool at the TCP; ``tx_Nm, ty_Nm, tz_Nm`` are zero where they are missing.
A column ``frame`` may name the frame of the poses, the same in every row.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from stiff_datasets.measured.load_file import interval_columns
from stiff_datasets.measured.rotations import (
    euler_angles,
    euler_rotations,
    quaternion_rotations,
)
from stiff_datasets.measured.row_checks import (
    FULL_TURN_RAD,
    LARGEST_NUMBER,
    NO_TORQUE,
    Problem,
    bound_problems,
    cell_problem,
    filled,
    limit_problems,
    numbers_and_loads,
    problems_error,
    radian_problems,
    table_problems,
)
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    MM_PER_M,
    TORQUE_COLUMNS,
    WRENCH_COLUMNS,
    file_units,
    joint_columns,
)
from stiff_datasets.measured.sheet_files import Sheet, read_sheet, write_table
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.types import FloatArray, IntArray, Interval, Robot, frozen_array
from stiff_protocols.paths.compensation import Compensation
from stiff_protocols.paths.inverse import SINGULAR, Followed
from stiff_protocols.paths.path import ToolPath

POSITION_COLUMNS = ("x_mm", "y_mm", "z_mm")
ANGLE_COLUMNS = ("a_deg", "b_deg", "c_deg")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
FRAME_COLUMN, BASE = "frame", "base"
LoadFrame = Literal["base", "tool"]

SMALLEST_POSITION_MM = 10.0
"""No path has all of its points so near to the base; such a file holds metres."""
LARGEST_POSITION_MM, LARGEST_ANGLE_DEG = 1e5, 1e4
SAME_TCP_M = 1e-5
QUATERNION_SLACK = 1e-3
"""How far the length of a quaternion may be from 1."""


@dataclass(frozen=True, eq=False)
class PathTable:
    """The points of a file, checked.

    Attributes:
        path: poses and loads, base frame, SI.
        q: (n, n_joints) joint positions where the file has them in place of poses, rad or m; else
            None.
        tool: (4, 4) tool frame in the last joint's frame, m.
        frame: (4, 4) frame of the file's poses in the base frame, m.
        frame_name: of that frame.
        columns: orientation and load as they are in the file, in its units.
        lines: (n,) numbers of the rows, for messages.
        oddities: what is odd but no error, a line each.
    """

    path: ToolPath
    q: FloatArray | None
    tool: FloatArray
    frame: FloatArray
    frame_name: str
    columns: pd.DataFrame
    lines: IntArray
    oddities: tuple[str, ...]

    @property
    def pose_columns(self) -> str:
        """Names of the columns that say where the tool or the robot is, for messages."""
        return ",".join(POSITION_COLUMNS) if self.q is None else "q1 and following"


def frame_matrix(numbers: Sequence[float]) -> FloatArray:
    """Return the (4, 4) pose, m, of x, y, z [mm], a, b, c [deg]."""
    given, pose = frozen_array(numbers, "x,y,z,a,b,c of a frame", (6,)), np.eye(4)
    pose[:3, 3] = given[:3] / MM_PER_M
    (pose[:3, :3],) = euler_rotations("ZYX", given[None, 3:])
    return pose


def six_numbers(load: Sequence[float]) -> tuple[float, ...]:
    """Return a load of three forces, or of forces and torques, as six numbers, N and N m.

    Raises:
        ConfigError: it has another length, or a number is none of a robot's.
    """
    valid = "fx,fy,fz in N, or fx,fy,fz,tx,ty,tz in N and N m"
    if len(load) not in (3, 6):
        raise ConfigError(f"has {len(load)} numbers (valid: {valid})", "load")
    for number in load:
        if not abs(number) <= LARGEST_NUMBER:  # neither is nan
            valid = f"numbers within +-{LARGEST_NUMBER:g} N and N m"
            raise ConfigError(f"{number:g}: no load of a robot (valid: {valid})", "load")
    return (*load, 0.0, 0.0, 0.0)[:6]


def tool_of(robot: Robot, tool: Sequence[float] | None) -> FloatArray:
    """Return the (4, 4) tool frame in the last joint's frame, m.

    Args:
        robot: the model's, with its TCP.
        tool: x, y, z [mm], a, b, c [deg] in the frame of the robot description's last link; None:
            the robot's TCP with the orientation of the last link.

    Raises:
        ConfigError: the tool's point is not the robot's TCP, whose deflection a model predicts.
    """
    pose = np.eye(4)
    pose[:3, 3] = robot.tcp_on_flange
    if tool is not None:
        pose = frame_matrix(tool)
        if np.abs(pose[:3, 3] - robot.tcp_on_flange).max() > SAME_TCP_M:
            tcp = ",".join(f"{each:g}" for each in robot.tcp_on_flange * MM_PER_M)
            raise ConfigError(
                f"x,y,z of {','.join(f'{each:g}' for each in tool)} is not the TCP at which the "
                f"model predicts deflections of {robot.name} (valid: {tcp} mm; for another tool, "
                "fit a model with its --tcp)",
                "tool",
            )
    return np.asarray(robot.flange @ pose)


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
    """Read the points of a path.

    Args:
        file: Parquet or Excel if it ends in .parquet or .xlsx, else CSV.
        robot: gives the joints and their limits, and the place of the TCP.
        tool: (4, 4) in the last joint's frame, m (`tool_of`).
        sheet_name: of an Excel file; None: the only one that holds a table.
        load: (3,) or (6,) N and N m at every point, for a file without loads.
        frame: in which loads are expressed.
        workpiece: x, y, z [mm], a, b, c [deg] of the frame of the poses in the base frame; None:
            they are in the base frame.

    Raises:
        DataError: the file is unreadable or wrongly headed, or a value is none; the message names
            file, row, column, value and what is valid.
        ConfigError: the file has no such sheet, or `load` is no load, or is given and the file has
            loads, or `workpiece` is missing or without use.
    """
    base = np.eye(4) if workpiece is None else frame_matrix(workpiece)
    joints = joint_columns(robot)
    poses = (*POSITION_COLUMNS, *ANGLE_COLUMNS, *QUATERNION_COLUMNS)
    sheet = read_sheet(file, sheet_name)
    sheet = sheet.recognised((*poses, *joints, *WRENCH_COLUMNS, FRAME_COLUMN))
    found = set(sheet.cells)
    turns = [some for some in (ANGLE_COLUMNS, QUATERNION_COLUMNS, joints) if found & {*some}]
    by_joints = turns == [joints]
    if len(turns) > 1 or (by_joints and found & {*POSITION_COLUMNS}):
        both = ", ".join(name for name in sheet.cells if name in {*poses, *joints})
        valid = f"{','.join(POSITION_COLUMNS)} with {','.join(ANGLE_COLUMNS)} or "
        valid += f"{','.join(QUATERNION_COLUMNS)}; or {','.join(joints)}"
        raise problems_error(file, [Problem(f"header: more than one of these: {both}", valid)])
    given_load = None if load is None else six_numbers(load)
    if load is not None and found & {*WRENCH_COLUMNS}:
        raise ConfigError(f"{file} has loads of its own (valid: one of both)", "load")
    angles = turns[0] if turns else ANGLE_COLUMNS
    places = joints if by_joints else (*POSITION_COLUMNS, *angles)
    loads = () if load is not None else WRENCH_COLUMNS
    columns = (*places, *loads, FRAME_COLUMN)
    problems = table_problems(sheet, columns, (*TORQUE_COLUMNS * bool(loads), FRAME_COLUMN))
    further = [name for name in sheet.unused if re.match(r"[aq]\d", name.lower())]
    if by_joints and further:
        joints_of = f"the {robot.n_joints} joints of {robot.name}"
        problems.append(Problem(f"header: further joints {', '.join(further)}", joints_of))
    if problems:
        raise problems_error(file, problems)
    given = NO_TORQUE
    if given_load is not None:
        given = dict(zip(WRENCH_COLUMNS, given_load, strict=True))
    sheet = filled(sheet, given)
    numbers, wrench, problems = numbers_and_loads(sheet, places)
    if not problems and by_joints:
        problems = [*radian_problems(numbers, robot), *limit_problems(sheet, numbers, robot)]
    elif not problems:
        problems = [*_pose_problems(sheet, numbers, angles)]
    frame_name, mixed = _frame_name(sheet, workpiece)
    if problems := [*problems, *mixed]:
        raise problems_error(file, problems)
    q, written = None, pd.DataFrame(dict(zip(places[3:], numbers.T[3:], strict=True)))
    if by_joints:
        q = numbers / file_units(robot)
        stands = robot.forward(q)
        position, rotation = stands.points[:, -1], stands.rotation
        written = _rounded(_angles(base[:3, :3].T @ rotation @ tool[:3, :3]))
    else:
        position = numbers[:, :3] / MM_PER_M @ base[:3, :3].T + base[:3, 3]
        rotation = base[:3, :3] @ _turned(numbers[:, 3:]) @ tool[:3, :3].T
    written = written.assign(**dict(zip(WRENCH_COLUMNS, wrench.T, strict=True)))
    if frame == "tool":
        tools = rotation @ tool[:3, :3]
        wrench = np.einsum("nij,nkj->nki", tools, wrench.reshape(-1, 2, 3)).reshape(-1, 6)
    return PathTable(
        path=ToolPath(file.stem, position, rotation, wrench),
        q=q,
        tool=tool,
        frame=base,
        frame_name=frame_name,
        columns=written,
        lines=sheet.lines,
        oddities=(*_oddities(sheet, numbers[:, 3:], angles),),
    )


def path_problems(table: PathTable, robot: Robot, found: Followed) -> list[Problem]:
    """Return the rows that cannot be driven, each with one reason.

    Args:
        table: the path.
        robot: that shall drive it.
        found: joint positions of its rows.
    """
    problems, units = [], file_units(robot)
    in_frame = (table.path.position - table.frame[:3, 3]) @ table.frame[:3, :3] * MM_PER_M
    for row in np.flatnonzero(~found.ok):
        joint = int(np.argmax(found.beyond[row]))
        if not found.reached[row]:
            value = ",".join(f"{each:.6g}" for each in in_frame[row])
            valid = f"a pose that {robot.name} reaches in this configuration"
        elif found.beyond[row, joint]:
            ends = robot.lower[joint], robot.upper[joint], found.q[row, joint]
            low, high, at = (each * units[joint] for each in ends)
            value = f"joint {robot.joint_names[joint]} at {at:.6g}"
            unit = joint_columns(robot)[joint].rpartition("_")[2]
            valid = f"{low:g}..{high:g} {unit}, its limits"
        elif found.flips[row]:
            value = "another configuration of shoulder, elbow or wrist than in the row before"
            valid = "one configuration along the path"
        else:
            value = f"singular, condition of the Jacobian {found.condition[row]:.3g}"
            valid = f"at most {SINGULAR:g}; e.g. a wrist that is not straight"
        problems.append(Problem(value, valid, int(table.lines[row]), table.pose_columns))
    return problems


def write_path(path: Path, sketch: ToolPath, tool: FloatArray) -> None:
    """Write a path to a new file, in the base frame, with KUKA's angles.

    Args:
        path: Parquet if it ends in .parquet, else CSV.
        sketch: what is written.
        tool: (4, 4) in the last joint's frame, m.
    """
    numbers = dict(zip(POSITION_COLUMNS, sketch.position.T * MM_PER_M, strict=True))
    numbers |= _angles(sketch.rotation @ tool[:3, :3])
    numbers |= dict(zip(WRENCH_COLUMNS, sketch.wrench.T, strict=True))
    write_table(path, [_rounded(numbers).assign(frame=BASE)])


def corrected_table(
    table: PathTable,
    robot: Robot,
    found: Compensation,
    extrapolates: Sequence[str],
    expected_error: FloatArray | None,
    interval: Interval | None = None,
) -> pd.DataFrame:
    """Return the commands of a corrected path as a file has them.

    Args:
        table: the points that are wanted.
        robot: of the joint positions.
        found: the commands, of the same rows.
        extrapolates: (n,) what of a row lies beyond the training range.
        expected_error: (n,) expected remaining distance from the wanted point, m; None: not known,
            and the column is empty.
        interval: of the deflections at the commands.
    """
    local = (found.position - table.frame[:3, 3]) @ table.frame[:3, :3]  # file's frame
    lengths = dict(zip(DEFLECTION_COLUMNS, found.deflection.T, strict=True))
    if interval is not None:
        lengths |= interval_columns(interval)
    not_known = np.full(len(found.wanted), np.nan)
    lengths["removed_mm"] = np.linalg.norm(found.removed, axis=1)
    lengths["expected_error_mm"] = not_known if expected_error is None else expected_error
    loads = table.columns[[*WRENCH_COLUMNS]]
    joints = dict(zip(joint_columns(robot), (found.q * file_units(robot)).T, strict=True))
    parts = [
        _rounded(dict(zip(POSITION_COLUMNS, local.T * MM_PER_M, strict=True))),
        table.columns.drop(columns=[*WRENCH_COLUMNS]),
        _rounded(joints),
        loads,
        _rounded({name: values * MM_PER_M for name, values in lengths.items()}),
    ]
    words = {"extrapolates": list(extrapolates), "uncorrected": found.problem.tolist()}
    return pd.concat(parts, axis=1).assign(**words, frame=table.frame_name)


def _rounded(columns: Mapping[str, FloatArray]) -> pd.DataFrame:
    """Return computed lengths [mm], angles [deg] or loads to 1e-8, without -0."""
    return pd.DataFrame(columns).round(8) + 0.0


def _turned(numbers: FloatArray) -> FloatArray:
    """Return (n, 3, 3) rotations of (n, 3) KUKA's angles [deg] or (n, 4) quaternions, w first."""
    if numbers.shape[1] == 4:
        return quaternion_rotations(numbers)
    return euler_rotations("ZYX", numbers)


def _angles(rotation: FloatArray) -> dict[str, FloatArray]:
    """Return KUKA's angles of (n, 3, 3) rotations."""
    return dict(zip(ANGLE_COLUMNS, euler_angles("ZYX", rotation).T, strict=True))


def _pose_problems(sheet: Sheet, numbers: FloatArray, angles: tuple[str, ...]) -> Iterator[Problem]:
    position, turn = numbers[:, :3], numbers[:, 3:]
    if np.abs(position).max() <= SMALLEST_POSITION_MM:
        yield Problem(
            f"every position lies within +-{SMALLEST_POSITION_MM:g} mm of the frame's origin; "
            "the columns x_mm.. are in mm, these look like metres",
            "",
        )
    yield from bound_problems(sheet, POSITION_COLUMNS, position, LARGEST_POSITION_MM)
    if angles == ANGLE_COLUMNS:
        yield from bound_problems(sheet, ANGLE_COLUMNS, turn, LARGEST_ANGLE_DEG)
    if angles == QUATERNION_COLUMNS:
        lengths = np.linalg.norm(turn, axis=1)
        for row in np.flatnonzero(np.abs(lengths - 1.0) > QUATERNION_SLACK):
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
    """Return the name of the one frame of a file, and rows with another."""
    usual = BASE if workpiece is None else "workpiece"
    if FRAME_COLUMN not in sheet.cells:
        return usual, []
    names = sheet.cells[FRAME_COLUMN].astype(str)
    names = names.where(names != "", usual)
    first = names.iloc[0]
    if (first == BASE) != (workpiece is None):
        where = "say where that is in the base frame (valid: x,y,z,a,b,c in mm and deg)"
        hint = "which is known" if first == BASE else where
        raise ConfigError(f"{sheet.path} is in the frame {first!r}; {hint}", "workpiece")
    others = np.flatnonzero((names != first).to_numpy())
    valid = f"{first!r}, the frame of the first row"
    return first, [cell_problem(sheet, row, FRAME_COLUMN, valid) for row in others]
