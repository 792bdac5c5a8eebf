"""Checks of a table of measured samples: every problem of a file."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_datasets.measured.file_options import DEFAULTS, FileOptions
from stiff_datasets.measured.sample_files import (
    DECIMALS,
    DEFLECTION_COLUMNS,
    ID_COLUMNS,
    LOADED_COLUMNS,
    LONGEST_CELL,
    MAYBE_GROUPED,
    MM_PER_M,
    TORQUE_COLUMNS,
    UNLOADED_COLUMNS,
    WRENCH_COLUMNS,
    Sheet,
    all_columns,
    file_units,
    joint_columns,
)
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.types import FloatArray, IntArray, Robot, Samples, TextArray

LARGEST_DEFLECTION_MM = 50.0
"""No industrial robot deflects so far under a load it may carry."""
USUAL_DEFLECTION_MM = 0.1, 10.0
"""Median of a measurement, with a margin of four: 0.6 to 2.6 mm in the shipped data sets."""
SMALL_UNITS = {"1/10 mm": 10.0, "0.001 inch": 1000.0 / 25.4, "1/100 mm": 100.0, "micrometres": 1e3}
"""Units of instruments -> how many of them are 1 mm."""
SMALLEST_DEFLECTION_MM = 0.01
"""What trackers repeat; a file that never exceeds it holds metres, not millimetres."""
LARGEST_NUMBER = 1e6
"""N, N m, deg or mm; no load of a robot is larger, nor a position of a joint without limits."""
FULL_TURN_RAD = 2.0 * np.pi
LIMIT_SLACK = 1e-6
"""deg or mm; a limit may have been written with rounding."""

WIDE = 4.0
"""Tolerances that a pose spans whose rows form a chain."""
SAME_POSITION = 0.2
"""Share by which positions of a tool may differ from the robot description's."""
FEWEST_FOR_PLACE = 5
FAR_FROM_ORIGIN = 5.0
"""Mean of positions over their spread; deflections differ more in direction and size."""

POSITIONS_TEXT = (
    f"{','.join(UNLOADED_COLUMNS)} (unloaded) and {','.join(LOADED_COLUMNS)} (loaded position)"
)
NO_TORQUE = dict.fromkeys(TORQUE_COLUMNS, 0.0)

RUNS_SHOWN = 10
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
        unfilled: the problem of a plan that is not filled in to the end; the other attributes are
            of the rows that are filled in.
        near_poses: which poses of different `pose_id` lie within the tolerance; "" for none.
    """

    sheet: Sheet
    problems: Sequence[Problem]
    samples: Samples | None = None
    unfilled: Problem | None = None
    near_poses: str = ""


def check_sheet(sheet: Sheet, robot: Robot, options: FileOptions = DEFAULTS) -> CheckedSamples:
    """Check the cells of a file and turn them into samples.

    Args:
        sheet: the cells.
        robot: the robot that was measured; gives the number of joints and their limits.
        options: without torques, these are zero; rows within the tolerance are one pose, where
            the file does not name them.
    """
    columns = all_columns(robot)
    sheet, columns = _with_positions(sheet, columns)
    optional = (*ID_COLUMNS, *(TORQUE_COLUMNS if options.no_torque else ()))
    problems = table_problems(sheet, columns, optional) or [*_long_names(sheet)]
    if problems:
        return CheckedSamples(sheet, problems)
    columns, n = columns[len(ID_COLUMNS) :], robot.n_joints
    sheet, junk = _without_junk(filled(sheet, NO_TORQUE), columns)
    sheet, unfilled = _without_unfilled(sheet, columns[n + len(WRENCH_COLUMNS) :])
    if sheet.cells.empty:
        return CheckedSamples(sheet, junk, unfilled=unfilled)
    numbers = sheet.numbers(columns)  # positions: deg, and mm of prismatic joints
    q_file, wrench, measured_mm = np.split(numbers, [n, n + len(WRENCH_COLUMNS)], axis=1)
    near = linked_rows(q_file, options.pose_tolerance)
    reach = pose_reach(robot, options.pose_tolerance)
    sheet = _with_names(sheet, near, f"{reach}{_chain_text(q_file, near, options)}")
    unreadable = [*junk, *_id_problems(sheet), *number_problems(sheet, columns, numbers)]
    sheet, deflection_mm = _deflections(sheet, measured_mm)
    problems = [
        *unreadable,
        *wrench_problems(sheet, wrench),
        *radian_problems(q_file, robot),
        *limit_problems(sheet, q_file, robot),
        *_deflection_problems(sheet, deflection_mm, q_file, robot),
        *_pose_problems(sheet, q_file, robot, near),
    ]
    problems.sort(key=lambda problem: problem.row or 0)
    if unreadable:
        return CheckedSamples(sheet, problems, unfilled=unfilled)
    pose_id, load_id, group = (sheet.cells[name].to_numpy(dtype=str) for name in ID_COLUMNS)
    samples = Samples(
        q=q_file / file_units(robot),
        wrench=wrench,
        deflection=deflection_mm / MM_PER_M,
        pose_id=pose_id,
        load_id=load_id,
        group=group,
    )
    near_poses = near_poses_text(pose_id, near, sheet.lines, reach)
    return CheckedSamples(sheet, problems, samples, unfilled, near_poses)


def filled(sheet: Sheet, usual: Mapping[str, float]) -> Sheet:
    """Return the sheet with numbers of ours in the columns that the file does not have."""
    absent = {name: number for name, number in usual.items() if name not in sheet.cells}
    return replace(sheet, cells=sheet.cells.assign(**absent))


def _with_positions(sheet: Sheet, columns: tuple[str, ...]) -> tuple[Sheet, tuple[str, ...]]:
    """Return the recognised sheet and its columns.

    The columns are both positions of the TCP in place of `DEFLECTION_COLUMNS`, where the file has
    loaded positions and no deflections.
    """
    positions = (*UNLOADED_COLUMNS, *LOADED_COLUMNS)
    file_columns = {*sheet.recognised((*columns, *positions)).cells}
    if file_columns & {*LOADED_COLUMNS} and not file_columns & {*DEFLECTION_COLUMNS}:
        columns = (*(name for name in columns if name not in DEFLECTION_COLUMNS), *positions)
    return sheet.recognised(columns), columns


def _deflections(sheet: Sheet, measured_mm: FloatArray) -> tuple[Sheet, FloatArray]:
    """Return the sheet with deflections, and (n, 3) these in mm.

    Args:
        sheet: the cells.
        measured_mm: (n, 3) deflections, or (n, 6) unloaded and loaded positions of the TCP.
    """
    if measured_mm.shape[1] == len(DEFLECTION_COLUMNS):
        return sheet, measured_mm
    unloaded, loaded = np.split(measured_mm, 2, axis=1)
    deflection_mm = np.round(loaded - unloaded, DECIMALS)  # positions are known to 1e-13 of them
    parts = (DEFLECTION_COLUMNS, LOADED_COLUMNS, UNLOADED_COLUMNS)
    names = {
        column: " - ".join(sheet.headers.get(position, position) for position in positions)
        for column, *positions in zip(*parts, strict=True)
    }
    note = f"deflections are {', '.join(names.values())}"
    cells = sheet.cells.assign(**dict(zip(DEFLECTION_COLUMNS, deflection_mm.T, strict=True)))
    headers = {**sheet.headers, **names}
    return replace(sheet, cells=cells, headers=headers, notes=(*sheet.notes, note)), deflection_mm


def pose_reach(robot: Robot, tolerance: float) -> str:
    """Return a tolerance with the units of the robot's joints: "0.05 deg and mm"."""
    units = {column.rpartition("_")[2]: "" for column in joint_columns(robot)}
    return f"{tolerance:g} {' and '.join(units)}"


def linked_rows(q_file: FloatArray, tolerance: float) -> IntArray:
    """Number the poses of rows: linked are two that differ by the tolerance at most in each joint.

    Rows are of one pose where a chain of linked rows connects them. This does not depend on the
    order of the rows, and no grid has an edge between them.

    Args:
        q_file: (n, n_joints) joint positions, deg, and mm of prismatic joints.
        tolerance: deg and mm.

    Returns:
        (n,) number of each row's pose, in the order in which poses come first.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree
    from scipy.spatial.distance import cdist

    reach = tolerance + LIMIT_SLACK
    q_file = np.clip(np.nan_to_num(q_file), -LARGEST_NUMBER, LARGEST_NUMBER)  # others are refused
    cells = pd.DataFrame(np.floor(q_file / reach))  # all rows of a cell are linked
    cell = cells.groupby([*cells], sort=False).ngroup().to_numpy()
    ends = np.cumsum(np.bincount(cell))
    rows = np.split(np.argsort(cell, kind="stable"), ends[:-1])
    beside = cKDTree(cells.drop_duplicates()).query_pairs(1.5, p=np.inf, output_type="ndarray")
    linked = [
        (a, b)
        for a, b in beside.tolist()
        if cdist(q_file[rows[a]], q_file[rows[b]], "chebyshev").min() <= reach
    ]
    a, b = np.array(linked, dtype=np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(a), dtype=bool), (a, b)), shape=(len(rows), len(rows)))
    return np.asarray(connected_components(graph, directed=False)[1][cell], dtype=np.int64)


def _chain_text(q_file: FloatArray, near: IntArray, options: FileOptions) -> str:
    """Say how wide the widest pose is where chains of rows make it wide; else ""."""
    of_pose = pd.DataFrame(q_file).groupby(near)
    widest = float(np.nan_to_num((of_pose.max() - of_pose.min()).to_numpy()).max())
    if widest <= WIDE * options.pose_tolerance:
        return ""
    return f"; the widest spans {widest:.2g}, as near rows form a chain"


def near_poses_text(pose_id: TextArray, near: IntArray, lines: IntArray, reach: str) -> str:
    """Describe poses that lie within the tolerance of each other under different names.

    Args:
        pose_id: (n,) names.
        near: (n,) numbers of `linked_rows`.
        lines: (n,) row numbers, for the message.
        reach: the tolerance with its units.

    Returns:
        One line with an example and what to do; "" where there are none.
    """
    named = pd.DataFrame({"name": pose_id, "near": near, "line": lines})
    named = named.drop_duplicates(["name", "near"])
    several = named[named.duplicated("near", keep=False)]
    if several.empty:
        return ""
    pair = several[several["near"] == several["near"].iloc[0]].iloc[:2]
    example = " and ".join(f"{name!r} (row {line})" for name, _, line in pair.to_numpy())
    return (
        f"{several['name'].nunique()} pose_ids name {_poses(several['near'])} within {reach}, such "
        f"as {example}; a split may put one pose on both sides: give its rows one pose_id, or "
        "leave the column out"
    )


def _poses(near: Iterable[int]) -> str:
    number = len({*near})
    return "1 pose" if number == 1 else f"{number} poses"


def _with_names(sheet: Sheet, near: IntArray, reach: str) -> Sheet:
    """Return the sheet with names of poses, loads and groups, where a file has none.

    Args:
        sheet: the cells.
        near: (n,) the pose of each row.
        reach: the tolerance of poses with its units.
    """
    cells, notes = sheet.cells, sheet.notes
    if "pose_id" not in cells:
        cells = cells.assign(pose_id=[f"P{pose + 1}" for pose in near])
        notes += (f"no pose_id: {len(near)} rows grouped into {_poses(near)} within {reach}",)
        if "load_id" in cells:  # which may name the load alone
            again = cells.groupby(["pose_id", "load_id"]).cumcount() + 1
            load = cells["load_id"]
            cells = cells.assign(
                load_id=load.where(again == 1, load + " (" + again.astype(str) + ")")
            )
    if "load_id" not in cells:
        cells = cells.assign(load_id=(cells.groupby("pose_id").cumcount() + 1).astype(str))
    cells = cells if "group" in cells else cells.assign(group="all")
    return replace(sheet, cells=cells, notes=notes)


def problems_error(path: Path, problems: Sequence[Problem], hint: str) -> DataError:
    """Return the error that names the first problem, and how many more there are."""
    first, *further = sorted(problems, key=lambda problem: problem.row or 0)
    more = f" (and {len(further)} more; {hint})" if further else ""
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
    file_columns = list(sheet.cells.columns)
    if sum(map(_is_number, sheet.unused)) > len(columns) / 2:
        return [Problem("no header: the first row holds numbers", ",".join(columns))]
    missing = [name for name in columns if name not in (*file_columns, *optional)]
    repeated = sorted({name for name in file_columns if file_columns.count(name) > 1})
    parts = [f"missing {', '.join(missing)}"] if missing else []
    parts += [f"repeated {', '.join(repeated)}"] if repeated else []
    if parts:
        parts += [
            f"unit of {name!r} (valid: {', '.join(units)})"
            for name, units in sheet.odd_units.items()
        ]
        unused = [name for name in sheet.unused if name not in sheet.odd_units]
        parts += [f"columns not used: {', '.join(unused)}"] if missing and unused else []
        may_miss = f"; optional: {', '.join(optional)}" if optional else ""
        if missing and set(missing) <= set(TORQUE_COLUMNS):
            may_miss = "; say no-torque if none were measured"
        elif {*DEFLECTION_COLUMNS} <= {*missing}:
            may_miss += f"; in place of dx_mm..: {POSITIONS_TEXT}"
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
    """Set rows apart that hold no data: one problem per row, not per cell.

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


def _without_unfilled(sheet: Sheet, columns: tuple[str, ...]) -> tuple[Sheet, Problem | None]:
    """Set the rows of a plan apart whose deflections are still to be measured.

    All cells of such a row in `columns`, deflections or positions, are empty. Where no row has any,
    zeros are empty, too.
    """
    cells = sheet.cells[[*columns]]
    blank = ((cells == "") | cells.isna()).all(axis=1).to_numpy()
    zero = (sheet.numbers(columns) == 0.0).all(axis=1)
    unfilled = blank | (zero & (blank | zero).all())
    if not unfilled.any():
        return sheet, None
    names = ", ".join(sheet.headers.get(name, name) for name in columns)
    step = f"fill in {names} there, or delete these rows"
    if unfilled.all():
        step = f"measure, fill in {names}, and replace the suggested wrench by the actual one"
    missing = sheet.lines[unfilled]
    where = f"row{'s' * (len(missing) > 1)} {row_ranges(missing)}"
    count = f"{len(missing)} of {len(unfilled)} rows have no deflections ({where})"
    problem = Problem(f"this plan is not filled in yet: {count}; {step}", "")
    rows = sheet.cells[~unfilled].reset_index(drop=True)
    return replace(sheet, cells=rows, lines=sheet.lines[~unfilled]), problem


def row_ranges(rows: Iterable[int]) -> str:
    """Return row numbers as text: those that follow each other as "2-152", the first ten runs."""
    runs: list[list[int]] = []
    for row in rows:
        if runs and row == runs[-1][-1] + 1:
            runs[-1][1:] = [row]
        else:
            runs.append([row])
    listed = ", ".join("-".join(map(str, run)) for run in runs[:RUNS_SHOWN])
    hidden = sum(run[-1] - run[0] + 1 for run in runs[RUNS_SHOWN:])
    return listed + (f" and {hidden} more" if hidden else "")


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


def _deflection_problems(
    sheet: Sheet, deflection_mm: FloatArray, q_file: FloatArray, robot: Robot
) -> Iterator[Problem]:
    size = np.abs(deflection_mm)
    readable = np.isfinite(deflection_mm).all(axis=1) & np.isfinite(q_file).all(axis=1)
    far = readable & (size.max(axis=1) > LARGEST_DEFLECTION_MM)
    if far.sum() > 0.5 * len(size):
        tcp = robot.forward(q_file[readable] / file_units(robot)).points[:, -1]
        if _are_positions(deflection_mm[readable], tcp * MM_PER_M):
            yield Problem(
                "dx_mm.. look like absolute positions of the TCP; subtract the unloaded position "
                f"from the loaded one, or give both: {POSITIONS_TEXT}",
                "",
            )
            return
    if len(size) >= 5 and (size.max(axis=1) > LARGEST_DEFLECTION_MM).mean() > 0.5:
        yield Problem(
            f"half of the deflections exceed {LARGEST_DEFLECTION_MM:g} mm; the columns dx_mm.. are "
            f"in mm, these look like {_likely_units(size)}",
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


def _likely_units(size: FloatArray) -> str:
    """Return the units, except mm, in which deflections of (n, 3) `size` are of a usual size."""
    middle = float(np.nanmedian(np.linalg.norm(size, axis=1)))
    low, high = USUAL_DEFLECTION_MM
    likely = [name for name, factor in SMALL_UNITS.items() if low < middle / factor < high]
    *first, last = likely or SMALL_UNITS
    return f"{', '.join(first)} or {last}" if first else last


def _are_positions(values: FloatArray, tcp: FloatArray) -> bool:
    """Say if (n, 3) values, mm, are positions of the TCP, not deflections.

    They are near (n, 3) `tcp`, mm in the base frame; or they are in another frame, as `tcp` turned
    and shifted; or they are spread as `tcp` is, far from the origin.
    """
    from scipy.spatial.transform import Rotation

    if np.linalg.norm(values - tcp) < SAME_POSITION * np.linalg.norm(tcp):
        return True
    if len(np.unique(tcp.round(), axis=0)) < FEWEST_FOR_PLACE:
        return False
    middle = values.mean(axis=0)
    about_middle, tcp_about_middle = values - middle, tcp - tcp.mean(axis=0)
    with warnings.catch_warnings():  # of poses on one line
        warnings.simplefilter("ignore", UserWarning)
        _, distance = Rotation.align_vectors(about_middle, tcp_about_middle)
    spread, tcp_spread = (
        np.linalg.norm(offsets) / np.sqrt(len(offsets))
        for offsets in (about_middle, tcp_about_middle)
    )
    is_far = np.linalg.norm(middle) > FAR_FROM_ORIGIN * spread
    is_as_wide = 0.5 < spread / tcp_spread < 2.0
    return bool(distance < SAME_POSITION * np.linalg.norm(tcp_about_middle) or is_far & is_as_wide)


def _pose_problems(
    sheet: Sheet, q_file: FloatArray, robot: Robot, near: IntArray
) -> Iterator[Problem]:
    """Yield the rows whose joint angles differ from their pose's by more than the tolerance.

    A split by pose would mean nothing. `near` has the (n,) numbers of `linked_rows`.
    """
    poses, _ = pd.factorize(sheet.cells["pose_id"])
    _, first_rows = np.unique(poses, return_index=True)
    first = first_rows[poses]  # (n,) the first row of each row's pose
    away = np.abs(q_file - q_file[first])
    readable = np.isfinite(away).all(axis=1)
    for row in np.flatnonzero((near != near[first]) & readable):
        column = joint_columns(robot)[int(np.argmax(away[row]))]
        yield cell_problem(
            sheet,
            row,
            column,
            f"{sheet.cells[column].iloc[first[row]]}, as in row {sheet.lines[first[row]]} of the "
            f"same pose {sheet.cells['pose_id'].iloc[row]!r}",
        )
