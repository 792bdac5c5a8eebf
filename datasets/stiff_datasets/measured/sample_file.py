"""Read a file of measured samples, check it row by row, and convert it to samples.

`sample_columns.py` lists the columns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stiff_datasets.measured.data_card import read_card
from stiff_datasets.measured.file_options import DEFAULTS, FileOptions
from stiff_datasets.measured.gauge_columns import (
    directions_of,
    gauge_texts,
    levers_of,
    without_gauge_columns,
    zero_problems,
)
from stiff_datasets.measured.row_checks import (
    FORMULA_HINT,
    LIMIT_TOLERANCE,
    NO_TORQUE,
    POSITIONS_TEXT,
    Problem,
    bound_problems,
    cell_problem,
    checked_numbers,
    limit_problems,
    linked_rows,
    outside_limits_text,
    pose_doubts,
    pose_reach,
    problems_error,
    radian_problems,
    shortest_moves,
    table_problems,
    with_missing_columns,
)
from stiff_datasets.measured.sample_columns import (
    AFTER_COLUMNS,
    DECIMALS,
    DEFLECTION_COLUMNS,
    DIRECTION_COLUMNS,
    EMPTY_SIGNS,
    ID_COLUMNS,
    LOADED_COLUMNS,
    MAX_CELL_LENGTH,
    MAX_NUMBER,
    MM_PER_M,
    ORDER,
    POINT_COLUMNS,
    TORQUE_COLUMNS,
    UNLOADED_COLUMNS,
    WRENCH_COLUMNS,
    all_columns,
    counted,
    file_units,
    joint_columns,
    optional_columns,
    shortened,
)
from stiff_datasets.measured.table_reader import EXCEL, Sheet, plain_minus, read_sheet, sheet_of
from stiff_datasets.measured.unloaded_positions import (
    MAX_MEDIAN,
    Frame,
    fit_frame,
    frame_doubt,
)
from stiff_protocols.contract.display import row_ranges
from stiff_protocols.contract.errors import warn
from stiff_protocols.contract.types import (
    BenchmarkData,
    BoolArray,
    FloatArray,
    IntArray,
    Robot,
    Samples,
)

MAX_DEFLECTION_MM = 50.0
"""No industrial robot deflects this far under an allowed load."""
USUAL_DEFLECTION_MM = 0.1, 10.0
"""Usual medians of a measurement: four times the range of the shipped data, 0.6 to 2.6 mm."""
SMALL_UNITS = {"1/10 mm": 10.0, "0.001 inch": 1000.0 / 25.4, "1/100 mm": 100.0, "micrometres": 1e3}
"""Unit of an instrument -> its number per mm."""
MIN_DEFLECTION_MM = 0.01
"""Repeatability of trackers; a file that never exceeds it holds metres, not millimetres."""
FEWEST_PARTLY_READ, PARTLY_READ_SHARE = 2, 0.2
"""Rows, and share of the rows, from which empty deflections are axes that were not read."""
POSITION_TOLERANCE = 0.2
"""Share by which positions of a tool may differ from the robot description."""
MIN_POSITIONS = 5


def read_samples(path: Path, robot: Robot, options: FileOptions = DEFAULTS) -> Samples:
    """Read and check a file of measured samples.

    Separate `StiffBenchWarning`s name unused columns, the number of poses if the file has no
    `pose_id`, poses with two names, and names of several poses.

    Args:
        path: the file; Parquet or Excel if it ends in .parquet or .xlsx, else CSV.
        robot: the measured robot; gives the number of joints and their limits.
        options: options of the file.

    Raises:
        ConfigError: the file does not have the sheet, or has several with tables and none is named.
        DataError: the file is unreadable or empty, or its header, a value or its data card is
            invalid. The message names file, row (1 is the header of a CSV file), column, value and
            valid values, and counts the other problems.
    """
    checked = check_sheet(read_sheet(path, options.sheet), robot, options)
    samples = _samples(checked, "bench data validate lists them")
    return replace(samples, instrument_noise=read_card(path).instrument_noise)


@dataclass(kw_only=True, eq=False)
class MeasuredData:
    """A user's own measurement: a file of samples and the robot they were measured on.

    Attributes:
        csv: the samples; Parquet or Excel if the name ends in .parquet or .xlsx.
        robot: the robot.
        options: options of the file.
    """

    csv: Path
    robot: Robot
    options: FileOptions = DEFAULTS

    def load(self) -> BenchmarkData:
        """Read the file.

        Raises:
            DataError: see `read_samples`.
        """
        return BenchmarkData(read_samples(self.csv, self.robot, self.options), self.robot)


def samples_of(
    path: Path, table: pd.DataFrame, robot: Robot, hint: str, options: FileOptions = DEFAULTS
) -> Samples:
    """Check a table with the columns of a file and return its samples.

    Warnings and errors are as in `read_samples`. Errors name `path`, and `hint` follows the first
    of several problems. Rows count from 0, as in `table.iloc`.
    """
    return _samples(check_sheet(sheet_of(path, table, first_row=0), robot, options), hint)


def doubts_of_samples(
    samples: Samples, robot: Robot, tolerance: float = DEFAULTS.pose_tolerance
) -> tuple[str, ...]:
    """Describe poses with two names, and names of several poses, within a tolerance, deg and mm.

    Rows are counted from 0.
    """
    q_file = samples.q * file_units(robot)
    near = linked_rows(q_file, tolerance, robot.turns)
    rows = np.arange(len(samples))
    return pose_doubts(samples.pose_id, samples.group, q_file, near, rows, robot, tolerance)


def _samples(checked: CheckedSamples, hint: str) -> Samples:
    """Return the samples and warn of each oddity, or raise the first problem."""
    path = checked.sheet.path
    if checked.samples is None or checked.problems or checked.unfilled:
        problems = [checked.unfilled] if checked.unfilled else checked.problems
        raise problems_error(path, problems, hint)
    doubts = (f"{path}: {doubt}" for doubt in checked.pose_doubts)
    limits = [f"{path}: {checked.outside_limits}"] * bool(checked.outside_limits)
    for oddity in (*checked.sheet.oddities, *doubts, *limits):
        warn(oddity, stacklevel=3)
    return checked.samples


@dataclass(frozen=True, eq=False)
class CheckedSamples:
    """A file's samples and its problems.

    Attributes:
        sheet: the file's data rows.
        problems: problems of the whole file first, then by row.
        samples: one per row; None if a cell is not a number or a name. Use them only if there are
            no problems.
        unfilled: the problem of a plan that is not filled in completely; the other attributes
            describe the rows that are filled in.
        pose_doubts: texts on poses with two names, and on names of several poses.
        outside_limits: text on joints a little outside their limits; "" for none.
        positions: (n, 3) of the unloaded TCP, m, NaN where a cell has none; None: the file has
            none.
    """

    sheet: Sheet
    problems: Sequence[Problem]
    samples: Samples | None = None
    unfilled: Problem | None = None
    pose_doubts: tuple[str, ...] = ()
    outside_limits: str = ""
    positions: FloatArray | None = None


def check_sheet(sheet: Sheet, robot: Robot, options: FileOptions = DEFAULTS) -> CheckedSamples:
    """Check the cells of a file and convert them to samples.

    Args:
        sheet: the cells.
        robot: the measured robot; gives the number of joints and their limits.
        options: options of the file. Torques that were not measured are zero. If the file does not
            name its poses, rows within the tolerance have the same pose.
    """
    columns = all_columns(robot)
    gauge = without_gauge_columns(sheet, robot, options)
    if gauge.problems:
        return CheckedSamples(gauge.sheet, gauge.problems)
    further_columns = (*optional_columns(robot), *DIRECTION_COLUMNS, *POINT_COLUMNS)
    sheet, columns = _with_positions(gauge.sheet, columns, further_columns, options.register)
    sheet = gauge.named(sheet)
    optional = (*ID_COLUMNS, *(TORQUE_COLUMNS if options.no_torque else ()))
    problems = table_problems(sheet, columns, optional, robot)
    if problems:
        return CheckedSamples(sheet, problems)
    columns, n = columns[len(ID_COLUMNS) :], robot.n_joints
    sheet, junk = _without_junk(with_missing_columns(sheet, NO_TORQUE), columns)
    sheet, unfilled = _without_unfilled(sheet, columns[n + len(WRENCH_COLUMNS) :])
    if sheet.cells.empty:
        return CheckedSamples(sheet, junk, unfilled=unfilled)
    sheet, is_read = _with_unread(sheet, columns[n + len(WRENCH_COLUMNS) :])
    numbers, number_problems = checked_numbers(sheet, columns)
    # positions: deg, and mm of prismatic joints
    q_file, wrench, measured_mm = np.split(numbers, [n, n + len(WRENCH_COLUMNS)], axis=1)
    near = linked_rows(q_file, options.pose_tolerance, robot.turns)
    sheet = _with_names(sheet, near, pose_reach(robot, options.pose_tolerance))
    further, further_problems = _further_fields(sheet, robot)
    unreadable = [*junk, *_id_problems(sheet), *number_problems, *further_problems]
    sheet, deflection_mm = _deflections(sheet, measured_mm)
    directions = directions_of(sheet, is_read)
    problems = [
        *unreadable,
        *radian_problems(q_file, robot),
        *limit_problems(sheet, q_file, robot, LIMIT_TOLERANCE),
        *_deflection_problems(sheet, deflection_mm, q_file, robot),
        *zero_problems(deflection_mm, directions),
        *_pose_problems(sheet, q_file, robot, near),
    ]
    problems.sort(key=lambda problem: problem.row or 0)
    if unreadable or (np.abs(deflection_mm) > MAX_NUMBER).any():
        return CheckedSamples(sheet, problems, unfilled=unfilled)
    pose_id, load_id, group = (sheet.cells[name].to_numpy(dtype=str) for name in ID_COLUMNS)
    q = q_file / file_units(robot)
    samples = Samples(
        q=q,
        wrench=wrench,
        deflection=deflection_mm / MM_PER_M,
        pose_id=pose_id,
        load_id=load_id,
        group=group,
        directions=directions,
        levers=levers_of(sheet, q, robot),
        **further,
    )
    for note in gauge_texts(samples):
        sheet = replace(sheet, notes=(*sheet.notes, note))
    positions = None
    if {*UNLOADED_COLUMNS} <= {*sheet.cells}:
        positions = sheet.numbers(UNLOADED_COLUMNS) / MM_PER_M
    if options.register and directions.size:
        problem = Problem("--register: readings along directions have no frame of positions", "")
        return CheckedSamples(sheet, [problem, *problems], samples, unfilled, positions=positions)
    if options.register and (positions is None or not problems):
        frame = _frame(positions, samples.q, robot)
        if isinstance(frame, Problem):
            return CheckedSamples(sheet, [frame, *problems], samples, unfilled, positions=positions)
        assert positions is not None
        positions = frame.to_base(positions - frame.shift)
        after = frame.to_base(samples.after) if samples.after.size else samples.after
        samples = replace(samples, deflection=frame.to_base(samples.deflection), after=after)
        note = f"positions registered to the base: their frame is {frame.text}; deflections turned"
        sheet = replace(sheet, notes=(*sheet.notes, note))
    doubts = pose_doubts(pose_id, group, q_file, near, sheet.lines, robot, options.pose_tolerance)
    outside_limits = outside_limits_text(sheet, q_file, robot)
    return CheckedSamples(sheet, problems, samples, unfilled, doubts, outside_limits, positions)


def _frame(positions: FloatArray | None, q: FloatArray, robot: Robot) -> Frame | Problem:
    """Return the frame of (n, 3) positions of the unloaded TCP, m, or why there is none."""
    if positions is None:
        return Problem("--register: the file has no positions", POSITIONS_TEXT)
    measured = np.isfinite(positions).all(axis=1)
    tcp = robot.forward(q[measured]).points[:, -1]
    if doubt := frame_doubt(positions[measured], tcp):
        return Problem(f"--register: {doubt}, so that no frame can be told from them", "")
    frame = fit_frame(positions[measured], tcp)
    median = float(np.median(frame.distance))
    if median > MAX_MEDIAN:
        return Problem(
            f"--register: in the best frame ({frame.text}) the unloaded positions are "
            f"{median * MM_PER_M:.3g} mm (median) from the forward kinematics of the joint angles",
            f"at most {MAX_MEDIAN * MM_PER_M:g} mm; check the joint angles, the TCP and the robot",
        )
    return frame


def _further_fields(sheet: Sheet, robot: Robot) -> tuple[dict[str, Any], list[Problem]]:
    """Return the fields of `Samples` that optional columns state, and the columns' problems."""
    fields: dict[str, Any] = {}
    problems: list[Problem] = []
    if ORDER in sheet.cells:
        fields["order"], problems = _order(sheet)
    approach = optional_columns(robot)[1 : 1 + robot.n_joints]
    for field, columns, unit in (("approach", approach, 1.0), ("after", AFTER_COLUMNS, MM_PER_M)):
        missing = [name for name in columns if name not in sheet.cells]
        if 0 < len(missing) < len(columns):
            problems.append(Problem(f"header: missing {', '.join(missing)}", ", ".join(columns)))
        if missing:
            continue
        numbers, number_problems = checked_numbers(sheet, columns)
        is_direction = (field != "approach") | np.isnan(numbers) | np.isin(numbers, (-1, 0, 1))
        problems += number_problems
        problems += [
            cell_problem(sheet, row, columns[i], "1, -1 or 0")
            for row, i in np.argwhere(~is_direction)
        ]
        fields[field] = numbers / unit
    return fields, problems


def _order(sheet: Sheet) -> tuple[FloatArray, list[Problem]]:
    """Return (n,) numbers of reading, or its times in s after the first, and their problems."""
    order = sheet.numbers((ORDER,))[:, 0]
    if np.isnan(order).all():
        cells = sheet.cells[ORDER].astype(str)
        times = pd.to_datetime(cells, format="ISO8601", errors="coerce", utc=True)
        since = times - times.min()
        if since.isna().all():  # times of a day
            since = pd.to_timedelta(cells, errors="coerce")
        order = np.asarray(since.dt.total_seconds(), dtype=np.float64)
    valid = "a number, or a time such as 2026-11-28T10:15:00"
    rows = np.flatnonzero(~np.isfinite(order))
    return order, [cell_problem(sheet, row, ORDER, valid) for row in rows]


def _with_positions(
    sheet: Sheet, columns: tuple[str, ...], optional: tuple[str, ...], register: bool
) -> tuple[Sheet, tuple[str, ...]]:
    """Return the sheet with its recognised and `optional` columns, and the recognised ones.

    Loaded and unloaded positions of the TCP may replace `DEFLECTION_COLUMNS`, and do so if they
    are to be registered (`register`). With deflections, unloaded positions are optional.
    """
    positions = (*UNLOADED_COLUMNS, *LOADED_COLUMNS)
    file_columns = {*sheet.with_standard_columns((*columns, *positions)).cells}
    has_both = {*positions} <= file_columns
    if {*UNLOADED_COLUMNS} <= file_columns:
        optional = (*optional, *UNLOADED_COLUMNS)
    if (register and has_both) or (
        file_columns & {*LOADED_COLUMNS} and not file_columns & {*DEFLECTION_COLUMNS}
    ):
        columns = (*(name for name in columns if name not in DEFLECTION_COLUMNS), *positions)
    return sheet.with_standard_columns((*columns, *optional)), columns


def _deflections(sheet: Sheet, measured_mm: FloatArray) -> tuple[Sheet, FloatArray]:
    """Add deflections to the sheet, and return them (n, 3), mm.

    `measured_mm` are (n, 3) deflections, or (n, 6) unloaded and loaded positions of the TCP.
    """
    if measured_mm.shape[1] == len(DEFLECTION_COLUMNS):
        return sheet, measured_mm
    unloaded, loaded = np.split(measured_mm, 2, axis=1)
    with np.errstate(over="ignore"):  # such positions are refused
        # positions are exact to a share of 1e-13
        deflection_mm = np.round(loaded - unloaded, DECIMALS)
    parts = (DEFLECTION_COLUMNS, LOADED_COLUMNS, UNLOADED_COLUMNS)
    names = {
        column: " - ".join(sheet.headers.get(position, position) for position in positions)
        for column, *positions in zip(*parts, strict=True)
    }
    note = f"deflections are {', '.join(names.values())}"
    cells = sheet.cells.assign(**dict(zip(DEFLECTION_COLUMNS, deflection_mm.T, strict=True)))
    headers = {**sheet.headers, **names}
    return replace(sheet, cells=cells, headers=headers, notes=(*sheet.notes, note)), deflection_mm


def _with_names(sheet: Sheet, near: IntArray, reach: str) -> Sheet:
    """Add the names of poses, loads and groups that the file does not have.

    `near` (n,) numbers the pose of each row, within the tolerance `reach` (with its units).
    """
    cells, notes = sheet.cells, sheet.notes
    if "pose_id" not in cells:
        cells = cells.assign(pose_id=[f"P{pose + 1}" for pose in near])
        poses = counted(near.max() + 1, "pose")
        notes += (f"no pose_id: {len(near)} rows grouped into {poses} within {reach}",)
        if "load_id" in cells:  # it may name only the load
            repeat_number = cells.groupby(["pose_id", "load_id"]).cumcount() + 1
            load = cells["load_id"]
            cells = cells.assign(
                load_id=load.where(
                    repeat_number == 1, load + " (" + repeat_number.astype(str) + ")"
                )
            )
    if "load_id" not in cells:
        cells = cells.assign(load_id=(cells.groupby("pose_id").cumcount() + 1).astype(str))
    cells = cells if "group" in cells else cells.assign(group="all")
    return replace(sheet, cells=cells, notes=notes)


def _without_junk(sheet: Sheet, columns: tuple[str, ...]) -> tuple[Sheet, list[Problem]]:
    """Separate rows without data: one problem per row, not per cell.

    Such a row is half empty, or has no number in any of `columns` while other rows have one. A row
    that is empty in all columns of the sheet is left out, with a note.
    """
    blank = ((sheet.cells == "") | sheet.cells.isna()).all(axis=1).to_numpy()
    if blank.any() and not blank.all():
        rows = row_ranges(sheet.lines[blank])
        note = f"rows not used, with cells only in columns that are not used: {rows}"
        sheet = replace(sheet.take(~blank), notes=(*sheet.notes, note))
    is_filled = (sheet.cells != "") & sheet.cells.notna()
    empty = (is_filled.sum(axis=1) < is_filled.shape[1] / 2).to_numpy()
    empty = empty & ~empty.all()  # otherwise a plan without names and wrenches
    has_no_number = np.isnan(sheet.numbers(columns[:1])[:, 0])
    if has_no_number.any():  # otherwise every cell is read only once
        has_no_number = np.asarray(np.isnan(sheet.numbers(columns)).all(axis=1))
    junk = empty | (has_no_number & ~has_no_number.all())
    problems = []
    for row in np.flatnonzero(junk):
        column = str(is_filled.columns[int(np.argmax(is_filled.iloc[row]))])
        valid = f"a row of {is_filled.shape[1]} cells" if empty[row] else "a row with numbers"
        problems.append(cell_problem(sheet, row, column, valid))
    return sheet.take(~junk), problems


def _without_unfilled(sheet: Sheet, columns: tuple[str, ...]) -> tuple[Sheet, Problem | None]:
    """Separate the rows of a plan that are not measured yet.

    In such a row all cells of `columns`, deflections or positions, are empty. If no row is
    complete, all rows are unmeasured; if no row has a deflection, zeros count as empty, too.
    """
    numbers = sheet.numbers(columns)  # (n, n_columns)
    empty = _empty_cells(sheet, columns, numbers)
    zero = (numbers == 0.0).all(axis=1)
    unfilled = empty.all(axis=1)
    if columns != DEFLECTION_COLUMNS:  # a deflection may be read along some of the axes
        unfilled |= empty.any(axis=1).all()
    unfilled |= zero & (unfilled | zero).all()
    if not unfilled.any():
        return sheet, None
    missing = empty[unfilled].any(axis=0) | zero[unfilled].any()
    headers = [sheet.headers.get(name, name) for name in compress(columns, missing)]
    names = ", ".join(dict.fromkeys(headers))
    next_step = "fill them in, or delete these rows"
    if unfilled.all():
        next_step = "measure them, and replace the suggested wrenches by the actual ones"
    lines = sheet.lines[unfilled]
    rows_text = f"row{'s' * (len(lines) > 1)} {row_ranges(lines)}"
    count_of_rows = f"{len(lines)} of {counted(len(unfilled), 'row')}"
    gap_text = f"{count_of_rows} {'has' if len(lines) == 1 else 'have'} no {names} ({rows_text})"
    problem = Problem(f"plan not filled in yet: {gap_text}; {next_step}", "")
    return sheet.take(~unfilled), problem


def _with_unread(sheet: Sheet, columns: tuple[str, ...]) -> tuple[Sheet, BoolArray | None]:
    """Fill empty deflections with 0 in rows that have others, and say which cells were filled.

    Return (n, 3) true for deflections that were read; None if all were. Few rows with an empty cell
    among complete rows are mistakes, and stay empty.
    """
    if columns != DEFLECTION_COLUMNS:
        return sheet, None
    empty = _empty_cells(sheet, columns, sheet.numbers(columns))
    if empty.any(axis=1).sum() < max(FEWEST_PARTLY_READ, PARTLY_READ_SHARE * len(empty)):
        return sheet, None
    cells = sheet.cells.copy()
    for place, column in enumerate(columns):
        cells[column] = cells[column].where(~empty[:, place], 0.0)
    return replace(sheet, cells=cells), ~empty


def _empty_cells(sheet: Sheet, columns: tuple[str, ...], numbers: FloatArray) -> BoolArray:
    """Return (n, n_columns) true for empty cells and signs of `EMPTY_SIGNS`.

    `numbers` (n, n_columns) are the numbers of `columns`; NaN if a cell is not a number.
    """
    empty = np.isnan(numbers)
    cells = sheet.cells[[*columns]].to_numpy(dtype=object)
    empty[empty] = [plain_minus(str(cell)).strip().lower() in EMPTY_SIGNS for cell in cells[empty]]
    return empty


def _id_problems(sheet: Sheet) -> Iterator[Problem]:
    for column in ID_COLUMNS:
        for row, name in enumerate(sheet.cells[column]):
            valid = ""
            if not name and sheet.path.suffix.lower() == EXCEL:
                valid = "a name (of merged cells, Excel stores only the first)"
            elif not name or (column == "pose_id" and name.startswith("#")):
                valid = "a name"
            elif sheet.is_formula(name):
                valid = f"a name; {FORMULA_HINT}"
            elif len(name) > MAX_CELL_LENGTH:
                valid = f"a name of at most {MAX_CELL_LENGTH} characters"
            elif name != name.strip() or not name.isprintable():
                valid = "a name that prints on one line, without invisible signs"
            if valid:
                yield cell_problem(sheet, row, column, valid)
    pair = sheet.cells[["pose_id", "load_id"]]
    for repeated_row in np.flatnonzero(pair.duplicated() & (pair != "").all(axis=1)):
        yield Problem(
            value=",".join(map(shortened, pair.iloc[repeated_row])),
            valid="a pair that no earlier row has",
            row=int(sheet.lines[repeated_row]),
            column="pose_id,load_id",
        )


def _deflection_problems(
    sheet: Sheet, deflection_mm: FloatArray, q_file: FloatArray, robot: Robot
) -> Iterator[Problem]:
    size = np.abs(deflection_mm)
    readable = np.isfinite(deflection_mm).all(axis=1) & np.isfinite(q_file).all(axis=1)
    far = readable & (size.max(axis=1) > MAX_DEFLECTION_MM)
    if far.sum() > 0.5 * len(size):
        tcp = robot.forward(q_file[readable] / file_units(robot)).points[:, -1]
        if _are_positions(deflection_mm[readable] / MM_PER_M, tcp):
            yield Problem(
                "dx_mm.. look like absolute positions of the TCP; subtract the unloaded position "
                f"from the loaded one, or give both: {POSITIONS_TEXT}",
                "",
            )
            return
    if len(size) >= 5 and (size.max(axis=1) > MAX_DEFLECTION_MM).mean() > 0.5:
        yield Problem(
            f"half of the deflections exceed {MAX_DEFLECTION_MM:g} mm; the columns dx_mm.. are "
            f"in mm, these look like {_likely_units(size)}",
            "",
        )
        return
    yield from bound_problems(sheet, DEFLECTION_COLUMNS, deflection_mm, MAX_DEFLECTION_MM)
    if size.max() < MIN_DEFLECTION_MM:  # false if a cell is not a number
        yield Problem(
            f"no deflection exceeds {MIN_DEFLECTION_MM:g} mm (largest {size.max():g}); the "
            "columns dx_mm.. are in mm, these look like metres",
            "",
        )


def _likely_units(size: FloatArray) -> str:
    """Return the units, except mm, in which deflections of (n, 3) `size` are usual."""
    median_mm = float(np.nanmedian(np.linalg.norm(size, axis=1)))
    low, high = USUAL_DEFLECTION_MM
    likely_units = [name for name, factor in SMALL_UNITS.items() if low < median_mm / factor < high]
    *first, last = likely_units or SMALL_UNITS
    return f"{', '.join(first)} or {last}" if first else last


def _are_positions(values: FloatArray, tcp: FloatArray) -> bool:
    """Test if (n, 3) values, m, are positions of the TCP, not deflections.

    Such values are near (n, 3) `tcp`, m in the base frame, or near `tcp` turned and shifted.
    """
    if np.linalg.norm(values - tcp) < POSITION_TOLERANCE * np.linalg.norm(tcp):
        return True
    if len(np.unique(tcp.round(3), axis=0)) < MIN_POSITIONS:
        return False
    size = np.linalg.norm(tcp - tcp.mean(axis=0))
    return bool(np.linalg.norm(fit_frame(values, tcp).distance) < POSITION_TOLERANCE * size)


def _pose_problems(
    sheet: Sheet, q_file: FloatArray, robot: Robot, near: IntArray
) -> Iterator[Problem]:
    """Yield the rows whose joint angles differ from the first row of their pose.

    They differ by more than the tolerance, so that a split by pose would be meaningless. `near`
    (n,) are pose numbers from `linked_rows`.
    """
    poses, _ = pd.factorize(sheet.cells["pose_id"])
    _, first_rows = np.unique(poses, return_index=True)
    first = first_rows[poses]  # (n,) the first row of each row's pose
    distance = np.abs(shortest_moves(q_file - q_file[first], robot.turns))
    readable = np.isfinite(distance).all(axis=1)
    for row in np.flatnonzero((near != near[first]) & readable):
        column = joint_columns(robot)[int(np.argmax(distance[row]))]
        yield cell_problem(
            sheet,
            row,
            column,
            f"{sheet.cells[column].iloc[first[row]]}, as in row {sheet.lines[first[row]]} of the "
            f"same pose {sheet.cells['pose_id'].iloc[row]!r}",
        )
