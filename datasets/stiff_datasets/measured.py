"""Measured data as CSV: the schema, its reader and its checks.

Columns, one row a load at a pose: ``pose_id, load_id, group, q1_deg .. qn_deg, fx_N, fy_N, fz_N,
tx_Nm, ty_Nm, tz_Nm, dx_mm, dy_mm, dz_mm`` (``q2_mm`` where joint 2 is prismatic). The wrench
acts at the TCP; wrench and deflection are expressed in the robot base frame; a deflection is the
loaded minus the unloaded position.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stiff_datasets.robots.robot import load_robot
from stiff_protocols.errors import DataError
from stiff_protocols.types import BenchmarkData, FloatArray, Robot, Samples

ID_COLUMNS = ("pose_id", "load_id", "group")
WRENCH_COLUMNS = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")
DEFLECTION_COLUMNS = ("dx_mm", "dy_mm", "dz_mm")

LARGEST_DEFLECTION_MM = 50.0
"""No industrial robot gives way so far under a load it may carry."""
SMALLEST_DEFLECTION_MM = 0.01
"""What trackers repeat; a file that never exceeds it holds metres, not millimetres."""
FULL_TURN_RAD = 2.0 * np.pi


def joint_columns(robot: Robot) -> tuple[str, ...]:
    """Return the names of the joint columns, base to tip, with their units."""
    units = {"revolute": "deg", "prismatic": "mm"}
    return tuple(f"q{i + 1}_{units[kind]}" for i, kind in enumerate(robot.joint_types))


def read_samples(path: Path, robot: Robot) -> Samples:
    """Read and check a CSV file of measured samples.

    Args:
        path: the file.
        robot: the robot that was measured; gives the number of joints and their limits.

    Raises:
        DataError: the file is unreadable, empty or wrongly headed, or a value cannot be; the
            message names file, row (1 is the header), column, value and what is valid.
    """
    table, sheet = _read_table(path)
    columns = (*ID_COLUMNS, *joint_columns(robot), *WRENCH_COLUMNS, *DEFLECTION_COLUMNS)
    _check_header(path, list(table.columns), columns)
    if table.empty:
        raise DataError(f"{path}: no data rows below the header")
    _check_ids(sheet, table)
    q_file = _numbers(sheet, table, joint_columns(robot))  # deg, and mm of prismatic joints
    wrench = _numbers(sheet, table, WRENCH_COLUMNS)
    deflection_mm = _numbers(sheet, table, DEFLECTION_COLUMNS)
    _check_angles(sheet, q_file, robot)
    _check_deflections(sheet, deflection_mm)
    _check_poses(sheet, table["pose_id"], q_file, robot)
    return Samples(
        q=q_file / _file_units(robot),
        wrench=wrench,
        deflection=deflection_mm / 1000.0,
        pose_id=table["pose_id"].to_numpy(dtype=str),
        load_id=table["load_id"].to_numpy(dtype=str),
        group=table["group"].to_numpy(dtype=str),
    )


class MeasuredData:
    """A user's own measurement: a CSV file in the schema and the robot's URDF.

    Attributes:
        csv: the samples.
        urdf: the robot.
        tcp: (3,) tool centre point in the frame of the URDF's last link, m.
    """

    def __init__(self, *, csv: Path, urdf: Path, tcp: tuple[float, float, float]) -> None:
        """Store the paths."""
        self.csv = csv
        self.urdf = urdf
        self.tcp = tcp

    def load(self) -> BenchmarkData:
        """Read both files.

        Raises:
            DataError: see `read_samples` and `stiff_datasets.robots.robot.read_chain`.
        """
        robot = load_robot(self.urdf, tcp=self.tcp)
        return BenchmarkData(read_samples(self.csv, robot), robot)


@dataclass(frozen=True)
class _Sheet:
    """A file's name and the line of each data row, for messages."""

    path: Path
    lines: NDArray[np.int64]

    def bad(self, row: int, column: str, value: object, valid: str) -> DataError:
        line = int(self.lines[row])
        return DataError(f"{self.path}: row {line}, column {column}: {value!r}, expected {valid}")


def _read_table(path: Path) -> tuple[pd.DataFrame, _Sheet]:
    """Return the table as text, so that a message can show a wrong value as it was written."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                io.StringIO(text),
                dtype=str,
                skipinitialspace=True,
                index_col=False,
                keep_default_na=False,  # a pose may be called NA
                skip_blank_lines=False,  # or the numbers of rows would not be those of lines
            )
    except pd.errors.EmptyDataError:
        raise DataError(f"{path}: the file is empty") from None
    except (pd.errors.ParserError, pd.errors.ParserWarning, UnicodeDecodeError) as error:
        raise DataError(f"{path}: not a CSV table: {' '.join(str(error).split())}") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    table = table.rename(columns=str.strip).fillna("").apply(lambda column: column.str.strip())
    table = table[(table != "").any(axis=1)]
    return table, _Sheet(path, table.index.to_numpy(dtype=np.int64) + 2)


def _check_header(path: Path, found: list[str], wanted: tuple[str, ...]) -> None:
    problems = []
    missing = [name for name in wanted if name not in found]
    unknown = [name for name in found if name not in wanted]
    repeated = sorted({name for name in found if found.count(name) > 1})
    for label, names in (("missing", missing), ("unknown", unknown), ("repeated", repeated)):
        if names:
            problems.append(f"{label} {', '.join(names)}")
    if problems:
        raise DataError(f"{path}: header: {'; '.join(problems)} (valid: {','.join(wanted)})")


def _check_ids(sheet: _Sheet, table: pd.DataFrame) -> None:
    for column in ID_COLUMNS:
        empty = np.flatnonzero(table[column] == "")
        if len(empty):
            raise sheet.bad(empty[0], column, "", "a name")
    again = np.flatnonzero(table.duplicated(["pose_id", "load_id"]))
    if len(again):
        row = again[0]
        name = f"{table['pose_id'].iloc[row]},{table['load_id'].iloc[row]}"
        raise sheet.bad(row, "pose_id,load_id", name, "a pair that no earlier row has")


def _numbers(sheet: _Sheet, table: pd.DataFrame, columns: tuple[str, ...]) -> FloatArray:
    """Return the columns as (n, len(columns)) finite numbers, in the file's units."""
    values = np.empty((len(table), len(columns)))
    for i, column in enumerate(columns):
        values[:, i] = pd.to_numeric(table[column], errors="coerce")
        wrong = np.flatnonzero(~np.isfinite(values[:, i]))
        if len(wrong):
            text = table[column].iloc[wrong[0]]
            raise sheet.bad(wrong[0], column, text, "a finite number")
    return values


def _file_units(robot: Robot) -> FloatArray:
    """Return (n_joints,) how many of the file's units make one rad or one m."""
    return np.array([180.0 / np.pi if k == "revolute" else 1000.0 for k in robot.joint_types])


def _check_angles(sheet: _Sheet, q_file: FloatArray, robot: Robot) -> None:
    angles = q_file[:, [kind == "revolute" for kind in robot.joint_types]]
    small = angles.size > 0 and (np.abs(angles) <= FULL_TURN_RAD).all() and np.ptp(angles) > 0.0
    if len(q_file) >= 5 and small:
        raise DataError(
            f"{sheet.path}: every joint angle lies within +-{FULL_TURN_RAD:.2f} deg; the columns "
            "q1_deg.. are in degrees, these look like radians"
        )
    lower, upper = robot.lower * _file_units(robot), robot.upper * _file_units(robot)
    slack = 1e-6  # deg or mm; a limit written with rounding
    outside = np.argwhere((q_file < lower - slack) | (q_file > upper + slack))
    if len(outside):
        row, joint = outside[0]
        raise sheet.bad(
            row,
            joint_columns(robot)[joint],
            f"{q_file[row, joint]:g}",
            f"{lower[joint]:g}..{upper[joint]:g}, the limits of joint "
            f"{robot.joint_names[joint]} of {robot.name}",
        )


def _check_deflections(sheet: _Sheet, deflection_mm: FloatArray) -> None:
    size = np.abs(deflection_mm)
    too_large = np.argwhere(size > LARGEST_DEFLECTION_MM)
    if len(too_large):
        row, axis = too_large[0]
        raise sheet.bad(
            row,
            DEFLECTION_COLUMNS[axis],
            f"{deflection_mm[row, axis]:g}",
            f"mm within +-{LARGEST_DEFLECTION_MM:g}; is the file in another unit?",
        )
    if size.max() < SMALLEST_DEFLECTION_MM:
        raise DataError(
            f"{sheet.path}: no deflection exceeds {SMALLEST_DEFLECTION_MM:g} mm (largest "
            f"{size.max():g}); the columns dx_mm.. are in mm, these look like metres"
        )


def _check_poses(sheet: _Sheet, pose_id: pd.Series[str], q_file: FloatArray, robot: Robot) -> None:
    """A pose's rows must have the same joint angles, or a split by pose would mean nothing."""
    first_row: dict[str, int] = {}
    for row, name in enumerate(pose_id):
        first = first_row.setdefault(name, row)
        if not np.allclose(q_file[row], q_file[first], rtol=0.0, atol=1e-3):
            joint = int(np.argmax(np.abs(q_file[row] - q_file[first])))
            raise sheet.bad(
                row,
                joint_columns(robot)[joint],
                f"{q_file[row, joint]:g}",
                f"{q_file[first, joint]:g}, as in row {sheet.lines[first]} of the same pose "
                f"{name!r}",
            )
