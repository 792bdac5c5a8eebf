"""Check the header, cells, rows and poses of a file.

Each check yields one `Problem` per error; every reader of rows uses these checks.
"""

from __future__ import annotations

import re
import shlex
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_datasets.measured.sample_columns import (
    COLUMNS,
    DEFLECTION_COLUMNS,
    LOADED_COLUMNS,
    MAX_NUMBER,
    TORQUE_COLUMNS,
    UNITS,
    UNLOADED_COLUMNS,
    counted,
    file_units,
    joint_columns,
    shortened,
    split_header,
)
from stiff_datasets.measured.table_reader import MAYBE_GROUPED, NUMBER, Sheet
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import (
    AXES,
    BoolArray,
    FloatArray,
    IntArray,
    Robot,
    TextArray,
)

FULL_TURN_RAD = 2.0 * np.pi
FULL_TURN_DEG = 360.0
WIDEST_POSE = 10.0
"""Tolerances that the rows of a pose may span; drifting joints link poses into longer chains."""
LIMIT_SLACK = 1e-6
"""deg or mm; a limit may have been written with rounding."""
LIMIT_TOLERANCE = 1.0
"""deg or mm; a measured position this little beyond a limit is usual: controllers round and
overshoot, and URDFs round limits."""

POSITIONS_TEXT = (
    f"{', '.join(UNLOADED_COLUMNS)} (unloaded) and {', '.join(LOADED_COLUMNS)} (loaded position)"
)
NO_TORQUE_HINT = "add --no-torque if torques were not measured"
NO_TORQUE = dict.fromkeys(TORQUE_COLUMNS, 0.0)
"""Columns of a file without torques -> their values."""

FORMULA_HINT = "the formula was never computed: open and save the file in Excel"


@dataclass(frozen=True)
class Problem:
    """An error in a file.

    Attributes:
        value: the invalid value; for the whole file, the description of the error.
        valid: the valid values; "" if they are obvious.
        row: the row's number (see `table_reader.Sheet`); None: the whole file.
        column: name of the column, or names of the columns separated by commas.
    """

    value: str
    valid: str
    row: int | None = None
    column: str | None = None

    def __str__(self) -> str:
        """Return the problem in one line, without the file's name."""
        if self.row is None:
            return f"{self.value} (valid: {self.valid})" if self.valid else self.value
        return f"row {self.row}, column {self.column}: {self.value!r}, expected {self.valid}"


def problems_error(
    path: Path, problems: Sequence[Problem], hint: str = "fix this one first"
) -> DataError:
    """Return the error that names the first problem and counts the others."""
    first, *other_problems = sorted(problems, key=lambda problem: problem.row or 0)
    count_text = f" (and {len(other_problems)} more; {hint})" if other_problems else ""
    return DataError(f"{path}: {first}{count_text}")


def table_problems(
    sheet: Sheet,
    columns: tuple[str, ...],
    optional: tuple[str, ...] = (),
    robot: Robot | None = None,
) -> list[Problem]:
    """Return the problems of a header; if it has none, report missing rows.

    Args:
        sheet: the cells.
        columns: every column that a file may have, in the usual order.
        optional: columns that may be missing.
        robot: robot whose joints are among the columns; named if the file has fewer joints, or
            columns of its held joints.
    """
    names = list(sheet.cells.columns)
    numbers = [name for name in sheet.unused if NUMBER.fullmatch(name.replace(",", "."))]
    if len(numbers) > len(columns) / 2:
        return [Problem("no header: the first row holds numbers", ", ".join(columns))]
    missing = [name for name in columns if name not in (*names, *optional)]
    repeated = sorted({name for name in names if names.count(name) > 1})
    named = {"missing": missing, "repeated": repeated}
    if missing:
        named["columns not used:"] = [name for name in sheet.unused if name not in sheet.odd_units]
    parts = [
        f"{kind} {', '.join(names_of_kind)}"
        for kind, names_of_kind in named.items()
        if names_of_kind
    ]
    if missing and robot is not None and (few_joints := _few_joints_text(sheet, robot)):
        parts.insert(0, few_joints)
    held = "" if robot is None else _held_columns_text(sheet, robot)
    parts[:0] = [held] * bool(held)
    parts += [f"unit of {name!r} (valid: {units})" for name, units in sheet.odd_units.items()]
    if {*DEFLECTION_COLUMNS} & {*missing} and (twice := _positions_twice(sheet)):
        parts.insert(0, f"{twice} stand twice: name them {POSITIONS_TEXT}")
    if missing or repeated or held:
        valid = ", ".join(columns) + (f"; optional: {', '.join(optional)}" if optional else "")
        if missing and {*missing} <= {*TORQUE_COLUMNS}:
            valid = f"{', '.join(columns)}; {NO_TORQUE_HINT}"
        elif {*DEFLECTION_COLUMNS} <= {*missing}:
            valid += f"; in place of dx_mm..: {POSITIONS_TEXT}"
        return [Problem(shortened(f"header: {'; '.join(parts)}", 500), valid)]
    return [Problem("no data rows below the header", "")] if sheet.cells.empty else []


def _few_joints_text(sheet: Sheet, robot: Robot) -> str:
    """Return the sentence on a file with the joints q1 to qk of a longer chain; "" for others."""
    units = dict(split_header(name) for name in (*sheet.headers.values(), *sheet.unused))
    columns = [f"q{i + 1}" for i in range(robot.n_joints) if f"q{i + 1}" in units]
    n, names = len(columns), robot.joint_names
    if n in (0, len(names)) or columns[-1] != f"q{n}":
        return ""
    turns = [units[name] in UNITS["deg"] for name in columns]
    stated = np.array([bool(units[name]) for name in columns])
    ways = []
    if (robot.turns[:n] == turns)[stated].all():
        ways.append(
            f"--tip with the URDF's link before joint {names[n]!r} ends the chain there, or "
            f"{_hold_words(names[n:])} if they stood still"
        )
    if (robot.turns[-n:] == turns)[stated].all():
        ways.append(
            f"if {', '.join(names[:-n])} stood still, {_hold_words(names[:-n])}, or add columns "
            "with their positions"
        )
    return "; ".join(
        [
            f"{counted(n, 'joint')}, but the chain of {robot.name} has {len(names)} "
            f"({', '.join(names)})",
            *ways,
        ]
    )


def _hold_words(names: Sequence[str]) -> str:
    """Return the options that hold joints, for a message."""
    return " ".join(f"--hold {shlex.quote(name)}=VALUE" for name in names)


def _held_columns_text(sheet: Sheet, robot: Robot) -> str:
    """Return the sentence on columns of the `robot`'s held joints; "" for none."""
    of_held = {split_header(text.rpartition("=")[0])[0] for text in robot.held}
    of_more = {f"q{robot.n_joints + 1}", *of_held}
    names = [name for name in sheet.unused if split_header(name)[0] in of_more]
    if not (of_held and names):
        return ""
    return (
        f"column {names[0]!r} is of one joint more than the {robot.n_joints} that move with "
        f"--hold {', '.join(robot.held)}: leave out the option or the column"
    )


def _positions_twice(sheet: Sheet) -> str:
    """Return "X, Y, Z" if the columns of positions do not say which are loaded; else ""."""
    names = [name for name in sheet.unused if split_header(name)[0] in AXES]
    axes = [split_header(name)[0] for name in names]
    return ", ".join(names[:3]) if sorted(axes) == sorted(AXES * 2) else ""


def cell_problem(sheet: Sheet, row: int | np.integer, column: str, valid: str) -> Problem:
    """Return the problem of one cell: its value and the valid ones."""
    return Problem(
        value=shortened(str(sheet.cells[column].iloc[row])),
        valid=valid,
        row=int(sheet.lines[row]),
        column=sheet.headers.get(column, column),
    )


def checked_numbers(sheet: Sheet, columns: tuple[str, ...]) -> tuple[FloatArray, list[Problem]]:
    """Return the (n, n_columns) numbers of a file and the problems of their cells.

    A number that is not finite, or beyond the limit of its column, is NaN.
    """
    numbers = sheet.numbers(columns)
    limits = np.array([COLUMNS[name].limit if name in COLUMNS else MAX_NUMBER for name in columns])
    problems = [*bound_problems(sheet, columns, numbers, limits)]
    for row, column in np.argwhere(~np.isfinite(numbers)):
        text = sheet.cells[columns[column]].iloc[row]
        valid = "a finite number"
        if isinstance(text, str) and MAYBE_GROUPED.fullmatch(text):
            valid += "; the point or comma may mark decimals or thousands in this file"
        elif sheet.is_formula(text):
            valid += f"; {FORMULA_HINT}"
        problems.append(cell_problem(sheet, row, columns[column], valid))
    return np.where(np.abs(numbers) <= limits, numbers, np.nan), problems


def checked_table(
    sheet: Sheet,
    columns: tuple[str, ...],
    usual: Mapping[str, float],
    further: tuple[str, ...] = (),
    robot: Robot | None = None,
) -> tuple[Sheet, FloatArray, list[Problem]]:
    """Check a table's header and read the numbers below, and the problems of their cells.

    Args:
        sheet: the cells.
        columns: columns of numbers.
        usual: those that may be missing -> their numbers then.
        further: other columns that the file may have.
        robot: see `table_problems`.

    Raises:
        DataError: a column is missing or repeated, or the table has no rows.
    """
    if problems := table_problems(sheet, (*columns, *further), (*usual, *further), robot):
        raise problems_error(sheet.path, problems)
    sheet = with_missing_columns(sheet, usual)
    return sheet, *checked_numbers(sheet, columns)


def range_problems(
    sheet: Sheet,
    columns: Sequence[str],
    values: FloatArray,
    lower: FloatArray | float,
    upper: FloatArray | float,
    valid: Sequence[str],
) -> Iterator[Problem]:
    """Yield the cells whose (n, n_columns) `values` exceed their column's bounds."""
    for row, i in np.argwhere(np.isfinite(values) & ((values < lower) | (values > upper))):
        yield cell_problem(sheet, row, columns[i], valid[i])


def bound_problems(
    sheet: Sheet, columns: Sequence[str], values: FloatArray, limit: FloatArray | float
) -> Iterator[Problem]:
    """Yield the cells whose (n, n_columns) `values`, in their columns' units, exceed +-`limit`."""
    limits = np.broadcast_to(limit, len(columns))
    valid = [
        f"{name.rpartition('_')[2]} within +-{most:g}; is the file in another unit?"
        for name, most in zip(columns, limits, strict=True)
    ]
    return range_problems(sheet, columns, values, -limits, limits, valid)


def radian_problems(q_file: FloatArray, robot: Robot) -> Iterator[Problem]:
    """Report joint angles `q_file` (n, n_joints), in deg, that look like radians."""
    angles = q_file[:, robot.turns]
    small = angles.size > 0 and (np.abs(angles) <= FULL_TURN_RAD).all() and np.ptp(angles) > 0.0
    if len(q_file) >= 5 and small:
        yield Problem(
            f"every joint angle lies within +-{FULL_TURN_RAD:.2f} deg; the columns q1_deg.. are in "
            "degrees, these look like radians",
            "",
        )


def limit_problems(
    sheet: Sheet, q_file: FloatArray, robot: Robot, slack: float = LIMIT_SLACK
) -> Iterator[Problem]:
    """Yield the joint positions (n, n_joints), deg or mm, outside the robot's limits by `slack`."""
    columns, ends = joint_columns(robot), np.stack([robot.lower, robot.upper]) * file_units(robot)
    lower, upper = np.clip(ends, -MAX_NUMBER, MAX_NUMBER)
    valid = [
        f"{low:g}..{high:g} {column.rpartition('_')[2]}, the limits of joint {name} of {robot.name}"
        for low, high, column, name in zip(lower, upper, columns, robot.joint_names, strict=True)
    ]
    return range_problems(sheet, columns, q_file, lower - slack, upper + slack, valid)


def outside_limits_text(sheet: Sheet, q_file: FloatArray, robot: Robot) -> str:
    """Describe the joint positions (n, n_joints), deg or mm, outside the limits; "" for none."""
    problems = [*limit_problems(sheet, q_file, robot)]
    if not problems:
        return ""
    rows = counted(len({problem.row for problem in problems}), "row")
    return f"{rows} with a joint outside its limits, the first: {problems[0]}"


def with_missing_columns(sheet: Sheet, usual: Mapping[str, float]) -> Sheet:
    """Add the columns that the file does not have, with their usual numbers."""
    absent = {name: number for name, number in usual.items() if name not in sheet.cells}
    return replace(sheet, cells=sheet.cells.assign(**absent))


def pose_reach(robot: Robot, tolerance: float) -> str:
    """Return a tolerance with the units of the robot's joints: "0.05 deg and mm"."""
    units = {column.rpartition("_")[2]: "" for column in joint_columns(robot)}
    return f"{tolerance:g} {' and '.join(units)}"


def shortest_moves(moves: FloatArray, turns: BoolArray) -> FloatArray:
    """Return (n, n_joints) moves, deg or mm, without whole turns of revolute joints (`turns`).

    A whole turn changes neither the geometry of the arm nor its loads.
    """
    half = 0.5 * FULL_TURN_DEG
    return np.where(turns, (moves + half) % FULL_TURN_DEG - half, moves)


def linked_rows(q_file: FloatArray, tolerance: float, turns: BoolArray) -> IntArray:
    """Number the poses of rows.

    Two rows are linked if they differ by at most the tolerance in each joint, without whole turns
    of revolute joints. Rows have the same pose if a chain of linked rows connects them, in any
    order.

    Args:
        q_file: (n, n_joints) joint positions, deg, and mm of prismatic joints.
        tolerance: deg and mm.
        turns: (n_joints,) true for revolute joints.

    Returns:
        (n,) number of each row's pose, in the order of the poses' first rows.
    """
    from scipy.cluster.hierarchy import DisjointSet
    from scipy.spatial import cKDTree

    reach = tolerance + LIMIT_SLACK
    q_file = np.clip(np.nan_to_num(q_file), -MAX_NUMBER, MAX_NUMBER)  # other values are refused
    q_file = np.where(turns, q_file % FULL_TURN_DEG % FULL_TURN_DEG, q_file)  # -1e-20 % 360 is 360
    period = np.where(turns, FULL_TURN_DEG, 0.0)  # 0: the joint slides
    cells = pd.DataFrame(np.floor(q_file / reach))  # all rows of a cell are linked
    cell = cells.groupby([*cells], sort=False).ngroup().to_numpy()
    rows = np.split(np.argsort(cell, kind="stable"), np.cumsum(np.bincount(cell))[:-1])
    trees = [
        cKDTree(np.unique(q_file[rows_of_cell], axis=0), boxsize=period) for rows_of_cell in rows
    ]
    # rows within reach have cells less than 2 apart, also where a turn ends within a cell
    grid = cKDTree(cells.drop_duplicates(), boxsize=period / reach)
    neighbours = grid.query_pairs(2.0 - 1e-9, p=np.inf, output_type="ndarray")
    poses = DisjointSet(range(len(trees)))
    for a, b in neighbours.tolist():
        if poses.connected(a, b):
            continue
        nearest, _ = trees[a].query(trees[b].data, p=np.inf, distance_upper_bound=2.0 * reach)
        if nearest.min() <= reach:
            poses.merge(a, b)
    return np.asarray(pd.factorize(np.array([poses[i] for i in cell.tolist()]))[0], dtype=np.int64)


def pose_doubts(
    pose_id: TextArray,
    group: TextArray,
    q_file: FloatArray,
    near: IntArray,
    lines: IntArray,
    robot: Robot,
    tolerance: float,
) -> tuple[str, ...]:
    """Describe poses with two names, names that look alike, and names of several poses.

    Args:
        pose_id: (n,) names of poses.
        group: (n,) names of groups.
        q_file: (n, n_joints) joint positions, deg, and mm of prismatic joints.
        near: (n,) pose numbers from `linked_rows`.
        lines: (n,) row numbers, for the messages.
        robot: the measured robot.
        tolerance: deg and mm.
    """
    reach = pose_reach(robot, tolerance)
    texts = (
        _near_poses_text(pose_id, near, lines, reach),
        _alike_names_text("pose_id", pose_id, near, lines),
        _alike_names_text("group", group, pd.factorize(group)[0], lines),
        _wide_poses_text(pose_id, q_file, near, robot, tolerance),
    )
    return tuple(filter(None, texts))


def _alike_names_text(column: str, name: TextArray, near: IntArray, lines: IntArray) -> str:
    """Describe names of a column that differ only in blanks, case or zeros; "" for none.

    `near` (n,) numbers what is named: two names of one pose do not count.
    """
    names = pd.DataFrame({"name": name, "near": near, "line": lines}).drop_duplicates("name")
    names["key"] = [_name_key(name) for name in names["name"]]
    alike = names[names.groupby("key")["near"].transform("nunique") > 1]
    if alike.empty:
        return ""
    pair = alike[alike["key"] == alike["key"].iloc[0]].iloc[:2]
    example = " and ".join(f"{name!r} (row {line})" for name, _, line, _ in pair.to_numpy())
    what = column.removesuffix("_id")
    return (
        f"{len(alike)} {column}s differ from another only in blanks, case or zeros, such as "
        f"{example}; a split may put one {what} on both sides: write the name of a {what} always "
        "alike"
    )


def _name_key(name: str) -> str:
    """Return a name without blanks, case, leading zeros and ".0": "p1" for "P 01" and "P1.0"."""
    key = "".join(unicodedata.normalize("NFKC", name).casefold().split())
    key = re.sub(r"(?<![\d.])(\d+)\.0+(?![\d.])", r"\1", key)
    return re.sub(r"(?<![\d.])0+(?=\d)", "", key)


def _wide_poses_text(
    pose_id: TextArray, q_file: FloatArray, near: IntArray, robot: Robot, tolerance: float
) -> str:
    """Describe names whose rows are not linked or span `WIDEST_POSE` tolerances; "" for none."""
    _, first, pose = np.unique(pose_id, return_index=True, return_inverse=True)
    moves = shortest_moves(q_file - q_file[first][pose], robot.turns)
    by_pose = pd.DataFrame(moves).groupby(pose)
    spans = (by_pose.max() - by_pose.min()).to_numpy()
    wide = spans.max(axis=1) > WIDEST_POSE * (tolerance + LIMIT_SLACK)
    wide[pose[near != near[first][pose]]] = True
    if not wide.any():
        return ""
    widest = int(np.argmax(np.where(wide, spans.max(axis=1), -1.0)))
    joint = int(np.argmax(spans[widest]))
    column = joint_columns(robot)[joint]
    return (
        f"{counted(int(wide.sum()), 'pose_id')} of rows far apart, such as "
        f"{str(pose_id[first[widest]])!r} with {spans[widest, joint]:.3g} "
        f"{column.rpartition('_')[2]} in {column}: several poses, or joints that drifted; give "
        "each pose its own pose_id"
    )


def _near_poses_text(pose_id: TextArray, near: IntArray, lines: IntArray, reach: str) -> str:
    """Describe poses with different names within the tolerance `reach`; "" for none."""
    named = pd.DataFrame({"name": pose_id, "near": near, "line": lines})
    named = named.drop_duplicates(["name", "near"])
    several = named[named.duplicated("near", keep=False)]
    if several.empty:
        return ""
    pair = several[several["near"] == several["near"].iloc[0]].iloc[:2]
    example = " and ".join(f"{name!r} (row {line})" for name, _, line in pair.to_numpy())
    poses = counted(several["near"].nunique(), "pose")
    return (
        f"{several['name'].nunique()} pose_ids name {poses} within {reach}, such as {example}; a "
        "split may put one pose on both sides: give its rows one pose_id, or leave the column out"
    )
