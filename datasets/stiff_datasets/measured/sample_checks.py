"""What a table of measured samples must be before it is believed: every problem of a file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_datasets.measured.sample_files import (
    DEFLECTION_COLUMNS,
    ID_COLUMNS,
    LONGEST_CELL,
    MAYBE_GROUPED,
    MM_PER_M,
    TORQUE_COLUMNS,
    WRENCH_COLUMNS,
    Sheet,
    all_columns,
    file_units,
    joint_columns,
)
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, Robot, Samples

LARGEST_DEFLECTION_MM = 50.0
"""No industrial robot deflects so far under a load it may carry."""
SMALLEST_DEFLECTION_MM = 0.01
"""What trackers repeat; a file that never exceeds it holds metres, not millimetres."""
LARGEST_NUMBER = 1e6
"""N, N m, deg or mm; no load of a robot is larger, nor a position of a joint without limits."""
FULL_TURN_RAD = 2.0 * np.pi
SAME_POSE = 1e-3
"""deg or mm; joint positions of one pose may differ by the rounding of a log."""
LIMIT_SLACK = 1e-6
"""deg or mm; a limit may have been written with rounding."""

NO_TORQUE = dict.fromkeys(TORQUE_COLUMNS, 0.0)

_SHOWN = 60
"""Characters of a wrong cell that a message shows."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a file.

    Attributes:
        value: what is there; of the file as a whole, what is wrong.
        valid: what would be right; "" where that says itself.
        row: the row's number (see `sample_files.Sheet`); None: the whole file.
        column: name of the column, or of the columns with commas between.
    """

    value: str
    valid: str
    row: int | None = None
    column: str | None = None

    def __str__(self) -> str:
        """Return one line without the file's name."""
        if self.row is None:
            return f"{self.value} (valid: {self.valid})" if self.valid else self.value
        return f"row {self.row}, column {self.column}: {self.value!r}, expected {self.valid}"


@dataclass(frozen=True, eq=False)
class CheckedSamples:
    """A file's samples and its problems.

    Attributes:
        sheet: the file's rows that are data.
        problems: those of the whole file first, then by row.
        samples: a row each; None where a cell is no number or no name; to be used only without
            problems.
    """

    sheet: Sheet
    problems: Sequence[Problem]
    samples: Samples | None = None


def check_sheet(sheet: Sheet, robot: Robot, *, no_torque: bool = False) -> CheckedSamples:
    """Check the cells of a file and turn them into samples.

    Args:
        sheet: the cells.
        robot: the robot that was measured; gives the number of joints and their limits.
        no_torque: torques were not measured; their columns may be missing, and are zero then.
    """
    columns = all_columns(robot)
    sheet = sheet.recognised(columns)
    optional = (*ID_COLUMNS, *(TORQUE_COLUMNS if no_torque else ()))
    problems = table_problems(sheet, columns, optional) or [*_long_names(sheet)]
    if problems:
        return CheckedSamples(sheet, problems)
    columns, n = columns[len(ID_COLUMNS) :], robot.n_joints
    sheet, junk = _without_junk(filled(sheet, NO_TORQUE), columns)
    if sheet.cells.empty:
        return CheckedSamples(sheet, junk)
    numbers = sheet.numbers(columns)  # positions: deg, and mm of prismatic joints
    q_file, wrench, deflection_mm = np.split(numbers, [n, n + len(WRENCH_COLUMNS)], axis=1)
    sheet = replace(sheet, cells=_with_names(sheet.cells, q_file))
    unreadable = [*junk, *_id_problems(sheet), *number_problems(sheet, columns, numbers)]
    problems = [
        *unreadable,
        *wrench_problems(sheet, wrench),
        *radian_problems(q_file, robot),
        *limit_problems(sheet, q_file, robot),
        *_deflection_problems(sheet, deflection_mm),
        *_pose_problems(sheet, q_file, robot),
    ]
    problems.sort(key=lambda problem: problem.row or 0)
    if unreadable:
        return CheckedSamples(sheet, problems)
    pose_id, load_id, group = (sheet.cells[name].to_numpy(dtype=str) for name in ID_COLUMNS)
    samples = Samples(
        q=q_file / file_units(robot),
        wrench=wrench,
        deflection=deflection_mm / MM_PER_M,
        pose_id=pose_id,
        load_id=load_id,
        group=group,
    )
    return CheckedSamples(sheet, problems, samples)


def filled(sheet: Sheet, usual: Mapping[str, float]) -> Sheet:
    """Return the sheet with numbers of ours in the columns that the file does not have."""
    absent = {name: number for name, number in usual.items() if name not in sheet.cells}
    return replace(sheet, cells=sheet.cells.assign(**absent))


def _with_names(cells: pd.DataFrame, q_file: FloatArray) -> pd.DataFrame:
    """Return the cells with names of poses, loads and groups, where a file has none.

    Rows with the same joint positions (n, n_joints), deg or mm, are one pose.
    """
    if "pose_id" not in cells:
        poses = pd.factorize(pd.Series(map(tuple, np.round(q_file / SAME_POSE))))[0]
        cells = cells.assign(pose_id=[f"P{pose + 1}" for pose in poses])
    if "load_id" not in cells:
        cells = cells.assign(load_id=(cells.groupby("pose_id").cumcount() + 1).astype(str))
    return cells if "group" in cells else cells.assign(group="all")


def problems_error(path: Path, problems: Sequence[Problem], hint: str) -> DataError:
    """Return the error that names the first problem, and how many there are beside it."""
    first, *others = sorted(problems, key=lambda problem: problem.row or 0)
    more = f" (and {len(others)} more; {hint})" if others else ""
    return DataError(f"{path}: {first}{more}")


def table_problems(
    sheet: Sheet, columns: tuple[str, ...], optional: tuple[str, ...] = ()
) -> list[Problem]:
    """Return what is wrong with a header, else that there are no rows.

    Args:
        sheet: the cells.
        columns: every column that a file may have, in the usual order.
        optional: those that may be missing.
    """
    found = list(sheet.cells.columns)
    if sum(map(_is_number, sheet.unused)) > len(columns) / 2:
        return [Problem("no header: the first row holds numbers", ",".join(columns))]
    missing = [name for name in columns if name not in (*found, *optional)]
    repeated = sorted({name for name in found if found.count(name) > 1})
    parts = [f"missing {', '.join(missing)}"] if missing else []
    parts += [f"repeated {', '.join(repeated)}"] if repeated else []
    if parts:
        parts += [
            f"unit of {name!r} (valid: {', '.join(units)})"
            for name, units in sheet.odd_units.items()
        ]
        others = [name for name in sheet.unused if name not in sheet.odd_units]
        parts += [f"columns not used: {', '.join(others)}"] if missing and others else []
        may_miss = f"; optional: {', '.join(optional)}" if optional else ""
        if missing and set(missing) <= set(TORQUE_COLUMNS):
            may_miss = "; say no-torque if none were measured"
        return [
            Problem(_shortened(f"header: {'; '.join(parts)}", 500), ",".join(columns) + may_miss)
        ]
    return [Problem("no data rows below the header", "")] if sheet.cells.empty else []


def _is_number(name: str) -> bool:
    try:
        float(name.replace(",", "."))
    except ValueError:
        return False
    return True


def _without_junk(sheet: Sheet, columns: tuple[str, ...]) -> tuple[Sheet, list[Problem]]:
    """Set rows apart that are no data: one problem a row, not one a cell.

    Such a row is half empty, or has no number in any of `columns`; not where no row has one.
    """
    filled = (sheet.cells != "") & sheet.cells.notna()
    empty = (filled.sum(axis=1) < filled.shape[1] / 2).to_numpy()
    wordy = np.isnan(sheet.numbers(columns[:1])[:, 0])
    if wordy.any():  # else every cell is read once
        wordy = np.asarray(np.isnan(sheet.numbers(columns)).all(axis=1))
    junk = empty | (wordy & ~wordy.all())
    problems = []
    for row in np.flatnonzero(junk):
        column = str(filled.columns[int(np.argmax(filled.iloc[row]))])
        valid = f"a row of {filled.shape[1]} cells" if empty[row] else "a row with numbers"
        problems.append(cell_problem(sheet, row, column, valid))
    rows = sheet.cells[~junk].reset_index(drop=True)
    return replace(sheet, cells=rows, lines=sheet.lines[~junk]), problems


def cell_problem(sheet: Sheet, row: int | np.integer, column: str, valid: str) -> Problem:
    """Return the problem of one cell: its value, and what would be valid."""
    return Problem(
        value=_shortened(str(sheet.cells[column].iloc[row])),
        valid=valid,
        row=int(sheet.lines[row]),
        column=sheet.headers.get(column, column),
    )


def _shortened(text: str, most: int = _SHOWN) -> str:
    return text if len(text) <= most else f"{text[:most]}..."


def _long_names(sheet: Sheet) -> Iterator[Problem]:
    for column in {*ID_COLUMNS}.intersection(sheet.cells):
        for row in np.flatnonzero(sheet.cells[column].str.len() > LONGEST_CELL):
            yield cell_problem(sheet, row, column, f"a name of at most {LONGEST_CELL} characters")


def _id_problems(sheet: Sheet) -> Iterator[Problem]:
    for column in ID_COLUMNS:
        for row, name in enumerate(sheet.cells[column]):
            if not name or (column == "pose_id" and name.startswith("#")):
                yield cell_problem(sheet, row, column, "a name")
            elif name != name.strip() or not name.isprintable():
                yield cell_problem(
                    sheet, row, column, "a name that prints on one line, without invisible signs"
                )
    pair = sheet.cells[["pose_id", "load_id"]]
    for again in np.flatnonzero(pair.duplicated() & (pair != "").all(axis=1)):
        yield Problem(
            value=",".join(map(_shortened, pair.iloc[again])),
            valid="a pair that no earlier row has",
            row=int(sheet.lines[again]),
            column="pose_id,load_id",
        )


def number_problems(
    sheet: Sheet, columns: tuple[str, ...], values: FloatArray
) -> Iterator[Problem]:
    """Yield the cells of `columns` whose `values` (n, len(columns)) are no finite numbers."""
    for row, column in np.argwhere(~np.isfinite(values)):
        text = sheet.cells[columns[column]].iloc[row]
        valid = "a finite number"
        if isinstance(text, str) and MAYBE_GROUPED.fullmatch(text):
            valid += "; the point or comma may mark decimals or thousands in this file"
        yield cell_problem(sheet, row, columns[column], valid)


def numbers_and_loads(
    sheet: Sheet, columns: tuple[str, ...]
) -> tuple[FloatArray, FloatArray, list[Problem]]:
    """Return the (n, len(columns)) numbers and (n, 6) wrenches of a file, and what is wrong."""
    numbers, wrench = sheet.numbers(columns), sheet.numbers(WRENCH_COLUMNS)
    problems = [
        *number_problems(sheet, columns, numbers),
        *number_problems(sheet, WRENCH_COLUMNS, wrench),
        *wrench_problems(sheet, wrench),
    ]
    return numbers, wrench, problems


def range_problems(
    sheet: Sheet,
    columns: Sequence[str],
    values: FloatArray,
    lower: FloatArray | float,
    upper: FloatArray | float,
    valid: Sequence[str],
) -> Iterator[Problem]:
    """Yield the cells whose (n, n_columns) `values` are numbers beyond their column's bounds."""
    for row, i in np.argwhere(np.isfinite(values) & ((values < lower) | (values > upper))):
        yield cell_problem(sheet, row, columns[i], valid[i])


def wrench_problems(sheet: Sheet, wrench: FloatArray) -> Iterator[Problem]:
    """Yield the components of (n, 6) `wrench` that no robot bears, N and N m."""
    valid = f"a load within +-{LARGEST_NUMBER:g}; is the file in another unit?"
    ends = -LARGEST_NUMBER, LARGEST_NUMBER
    return range_problems(sheet, WRENCH_COLUMNS, wrench, *ends, [valid] * 6)


def radian_problems(q_file: FloatArray, robot: Robot) -> Iterator[Problem]:
    """Say whether (n, n_joints) `q_file`, in deg, look like radians."""
    angles = q_file[:, robot.turns]
    small = angles.size > 0 and (np.abs(angles) <= FULL_TURN_RAD).all() and np.ptp(angles) > 0.0
    if len(q_file) >= 5 and small:
        yield Problem(
            f"every joint angle lies within +-{FULL_TURN_RAD:.2f} deg; the columns q1_deg.. are in "
            "degrees, these look like radians",
            "",
        )


def limit_problems(sheet: Sheet, q_file: FloatArray, robot: Robot) -> Iterator[Problem]:
    """Yield the joint positions (n, n_joints), deg or mm, outside of the robot's limits."""
    columns = joint_columns(robot)
    lower = np.maximum(robot.lower * file_units(robot), -LARGEST_NUMBER)
    upper = np.minimum(robot.upper * file_units(robot), LARGEST_NUMBER)
    valid = [
        f"{low:g}..{high:g} {column.rpartition('_')[2]}, the limits of joint {name} of {robot.name}"
        for low, high, column, name in zip(lower, upper, columns, robot.joint_names, strict=True)
    ]
    return range_problems(sheet, columns, q_file, lower - LIMIT_SLACK, upper + LIMIT_SLACK, valid)


def _deflection_problems(sheet: Sheet, deflection_mm: FloatArray) -> Iterator[Problem]:
    size = np.abs(deflection_mm)
    if len(size) >= 5 and (size.max(axis=1) > LARGEST_DEFLECTION_MM).mean() > 0.5:
        yield Problem(
            f"half of the deflections exceed {LARGEST_DEFLECTION_MM:g} mm; the columns dx_mm.. are "
            "in mm, these look like micrometres",
            "",
        )
        return
    valid = f"mm within +-{LARGEST_DEFLECTION_MM:g}; is the file in another unit?"
    ends = 0.0, LARGEST_DEFLECTION_MM
    yield from range_problems(sheet, DEFLECTION_COLUMNS, size, *ends, [valid] * 3)
    if size.max() < SMALLEST_DEFLECTION_MM:  # not so where a cell is no number
        yield Problem(
            f"no deflection exceeds {SMALLEST_DEFLECTION_MM:g} mm (largest {size.max():g}); the "
            "columns dx_mm.. are in mm, these look like metres",
            "",
        )


def _pose_problems(sheet: Sheet, q_file: FloatArray, robot: Robot) -> Iterator[Problem]:
    """A pose's rows must have the same joint angles, or a split by pose would mean nothing."""
    poses, _ = pd.factorize(sheet.cells["pose_id"])
    _, first_rows = np.unique(poses, return_index=True)
    first = first_rows[poses]  # (n,) the first row of each row's pose
    away = np.abs(q_file - q_file[first])
    for row in np.flatnonzero((away > SAME_POSE).any(axis=1)):
        column = joint_columns(robot)[int(np.nanargmax(away[row]))]
        yield cell_problem(
            sheet,
            row,
            column,
            f"{sheet.cells[column].iloc[first[row]]}, as in row {sheet.lines[first[row]]} of the "
            f"same pose {sheet.cells['pose_id'].iloc[row]!r}",
        )
