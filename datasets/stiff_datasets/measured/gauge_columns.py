"""Read a workshop's columns: states, hanging masses, pulls, and readings along a direction.

They become the columns of `sample_columns.py`: wrenches at the TCP, and deflections along the
gauge's direction. Three steps, each only where a file has its columns:

1. a row a state (``state``: unloaded, loaded, and unloaded again) -> a row a load;
2. ``mass_kg`` and ``pull_N`` along ``pull_x, pull_y, pull_z`` at the hook -> force and torque;
3. ``reading_mm``, or ``reading0_mm, reading1_mm, reading2_mm`` (unloaded, loaded, unloaded again),
   along ``reading_x, reading_y, reading_z`` -> deflection, of the TCP or of the point
   ``point_x_mm, point_y_mm, point_z_mm`` of the last link.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from stiff_datasets.measured.file_options import FileOptions
from stiff_datasets.measured.row_checks import Problem, cell_problem
from stiff_datasets.measured.sample_columns import (
    AFTER_COLUMNS,
    DEFLECTION_COLUMNS,
    DIRECTION_COLUMNS,
    EMPTY_SIGNS,
    GAUGE_COLUMNS,
    ID_COLUMNS,
    LOADED_COLUMNS,
    MM_PER_M,
    POINT_COLUMNS,
    READING,
    WRENCH_COLUMNS,
    file_units,
    joint_columns,
    split_header,
)
from stiff_datasets.measured.table_reader import Sheet, plain_minus
from stiff_protocols.contract.robot import LONGEST_M
from stiff_protocols.contract.types import BoolArray, FloatArray, Robot, Samples

MASS, PULL, STATE, LOADING = "mass_kg", "pull_N", "state", "loading"
PULL_COLUMNS = ("pull_x", "pull_y", "pull_z")
STATE_READINGS = ("reading0_mm", "reading1_mm", "reading2_mm")
"""Gauge unloaded, loaded, and unloaded again."""
STATES = {
    **dict.fromkeys(("unloaded", "unloaded again", "unbelastet", "0"), False),
    **dict.fromkeys(("loaded", "belastet", "1"), True),
}
"""Word of a state -> whether the load is on."""
LOADINGS = ("first", "second", "mean")
"""Reading loaded, less the one before it, less the one after it, or less their mean."""
LEVER_DECIMALS = 9
"""Of m: a lever's rounding errors vanish, so that an exported file reads back."""
FEWEST_ZEROS = 5
"""Rows from which a column of exact zeros is refused."""


@dataclass(frozen=True, eq=False)
class GaugeSheet:
    """A sheet whose workshop columns are replaced.

    Attributes:
        sheet: the sheet.
        problems: problems of the cells.
        headers: derived column -> names of the file's columns that it comes from.
    """

    sheet: Sheet
    problems: tuple[Problem, ...] = ()
    headers: tuple[tuple[str, str], ...] = ()

    def named(self, sheet: Sheet) -> Sheet:
        """Return a sheet whose derived columns have the names of the file's in messages."""
        known_names = {name: text for name, text in self.headers if name in sheet.cells}
        return replace(sheet, headers={**sheet.headers, **known_names})


def without_gauge_columns(sheet: Sheet, robot: Robot, options: FileOptions) -> GaugeSheet:
    """Return a file's sheet with the columns of `sample_columns.py` for its workshop columns.

    Args:
        sheet: the cells as read.
        robot: the measured robot.
        options: options of the file; the hook of its weights.
    """
    sheet, problems = _rows_of_loads(sheet, robot)
    read_sheet = _recognised(sheet, robot)
    headers: dict[str, str] = {}
    if {MASS, PULL} & {*read_sheet.cells}:
        sheet, load_problems, of_loads = _with_wrenches(sheet, read_sheet, robot, options)
        problems, headers = problems + load_problems, headers | of_loads
    if {READING, *STATE_READINGS} & {*read_sheet.cells}:
        sheet, reading_problems, of_readings = _with_deflections(sheet, read_sheet, robot)
        problems, headers = problems + reading_problems, headers | of_readings
    elif points := [name for name in POINT_COLUMNS if name in read_sheet.cells]:
        text = f"header: {', '.join(points)} without a reading"
        problems.append(Problem(text, "reading_mm; give the point of a tracker as --tcp"))
    return GaugeSheet(sheet, tuple(problems), tuple(headers.items()))


def directions_of(sheet: Sheet, is_read: BoolArray | None) -> FloatArray:
    """Return the (n, m, 3) directions of a checked sheet; empty: x, y and z.

    `is_read` (n, 3) are the axes whose cells are filled; None: all.
    """
    if DIRECTION_COLUMNS[0] in sheet.cells:
        direction = sheet.numbers(DIRECTION_COLUMNS)
        return np.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True))[:, None]
    if is_read is None or is_read.all():
        return np.empty(0)
    axes = np.where(is_read[..., None], np.eye(3), 0.0)
    first = np.argsort(~is_read, axis=1, kind="stable")  # axes that are read come first
    axes = np.take_along_axis(axes, first[..., None], axis=1)
    return np.asarray(axes[:, : int(is_read.sum(axis=1).max())])


def levers_of(sheet: Sheet, q: FloatArray, robot: Robot) -> FloatArray:
    """Return `Samples.levers` of a checked sheet: (n, 3) to its points, 0 where it states none.

    Empty: it states no point. `q` (n, n_joints) are the positions, rad or m.
    """
    if POINT_COLUMNS[0] not in sheet.cells:
        return np.empty(0)
    points = sheet.numbers(POINT_COLUMNS)
    if np.isnan(points).all():
        return np.empty(0)
    return np.nan_to_num(robot.lever(q, points / MM_PER_M)).round(LEVER_DECIMALS)


def zero_problems(deflection_mm: FloatArray, directions: FloatArray) -> Iterator[Problem]:
    """Yield columns of exact zeros among others: an axis that was not measured has empty cells."""
    if directions.size or len(deflection_mm) < FEWEST_ZEROS:
        return
    is_zero = (deflection_mm == 0.0).all(axis=0)
    for column, is_unread in zip(DEFLECTION_COLUMNS, is_zero, strict=True):
        if is_unread and not is_zero.all():
            yield Problem(
                f"column {column}: every cell is 0", "if it was not read, leave the cells empty"
            )


def gauge_texts(samples: Samples) -> list[str]:
    """Return a note on how many numbers were read, and along which axes; none for x, y and z."""
    if not samples.directions.size:
        return []
    directions, is_read = samples.directions, samples.is_read
    along = [
        f"{name} {int(((np.abs(directions[..., axis]) > 1.0 - 1e-9) & is_read).sum())}"
        for axis, name in enumerate("xyz")
    ]
    oblique = int(is_read.sum() - (np.abs(directions).max(axis=2) > 1.0 - 1e-9).sum())
    along += [f"other directions {oblique}"] * bool(oblique)
    texts = [f"{int(is_read.sum())} numbers in {len(samples)} rows: along {', '.join(along)}"]
    if samples.levers.size:
        far = MM_PER_M * np.linalg.norm(samples.levers, axis=1)
        texts.append(f"the gauge touches points {far.min():.3g} to {far.max():.3g} mm from the TCP")
    return texts


def _recognised(sheet: Sheet, robot: Robot) -> Sheet:
    """Return the sheet's columns that this module reads."""
    joints = joint_columns(robot)
    return sheet.with_standard_columns((*GAUGE_COLUMNS, *joints, *WRENCH_COLUMNS, *ID_COLUMNS))


def _rows_of_loads(sheet: Sheet, robot: Robot) -> tuple[Sheet, list[Problem]]:
    """Join the rows of states: each loaded row gets the unloaded ones before and after it.

    Rows belong together if their pose (or joint positions), direction and point are equal.
    """
    measured = (READING, "x_mm", "y_mm", "z_mm")
    of_gauge = (*DIRECTION_COLUMNS, *POINT_COLUMNS)
    columns = (STATE, *measured, "pose_id", *of_gauge, *joint_columns(robot))
    read_sheet = sheet.with_standard_columns(columns)
    if STATE not in read_sheet.cells:
        return sheet, []
    if not {*measured} & {*read_sheet.cells}:
        valid = "reading_mm, or x_mm, y_mm and z_mm"
        return sheet, [Problem("header: state without a reading", valid)]
    words = read_sheet.cells[STATE].astype(str).str.strip().str.lower()
    problems = [
        cell_problem(read_sheet, row, STATE, "unloaded or loaded")
        for row in np.flatnonzero(~words.isin([*STATES]))
    ]
    if problems:
        return sheet, problems
    is_loaded = words.map(STATES).to_numpy(dtype=bool)
    same = ["pose_id"] if "pose_id" in read_sheet.cells else [*joint_columns(robot)]
    same += [name for name in of_gauge if name in read_sheet.cells]
    group = read_sheet.cells.groupby(same, sort=False, dropna=False).ngroup().to_numpy()
    before = np.full(len(group), -1)
    again = np.full(len(group), -1)
    for number in np.unique(group):
        rows = np.flatnonzero(group == number)
        for place, row in enumerate(rows):
            if is_loaded[row]:
                earlier = rows[:place][~is_loaded[rows[:place]]]
                before[row] = earlier[-1] if len(earlier) else -1
                if place + 1 < len(rows) and not is_loaded[rows[place + 1]]:
                    again[row] = rows[place + 1]
    loaded = np.flatnonzero(is_loaded)
    problems = [
        cell_problem(read_sheet, row, STATE, "a row 'unloaded' of this pose above it")
        for row in loaded[before[loaded] < 0]
    ]
    if problems:
        return sheet, problems
    cells = sheet.cells.drop(columns=[read_sheet.headers.get(STATE, STATE)])
    places = {"0": before[loaded], "1": loaded}
    if (again[loaded] >= 0).all():
        places["2"] = again[loaded]
    joined = cells.iloc[loaded].reset_index(drop=True)
    for name in (name for name in measured if name in read_sheet.cells):
        header = read_sheet.headers.get(name, name)
        unit = split_header(header)[1] or "mm"
        stem = split_header(name)[0]
        for number, rows in places.items():
            if name == READING or number != "2":
                joined[f"{stem}{number}_{unit}"] = cells[header].to_numpy()[rows]
        joined = joined.drop(columns=[header])
    note = f"{len(group)} rows of states joined to {len(loaded)} loads"
    notes = (*sheet.notes, note)
    return replace(sheet, cells=joined, lines=sheet.lines[loaded], notes=notes), []


def _with_wrenches(
    sheet: Sheet, read_sheet: Sheet, robot: Robot, options: FileOptions
) -> tuple[Sheet, list[Problem], dict[str, str]]:
    """Replace masses and pulls by wrenches at the TCP."""
    file_columns = {*read_sheet.cells}
    if twice := file_columns & {*WRENCH_COLUMNS}:
        text = f"header: both {', '.join(sorted(twice))} and masses or pulls"
        return sheet, [Problem(text, "one of them")], {}
    missing = [name for name in PULL_COLUMNS if name not in file_columns]
    if PULL in file_columns and missing:
        valid = f"{', '.join(PULL_COLUMNS)}: the direction of the pull, robot base frame"
        return sheet, [Problem(f"header: missing {', '.join(missing)}", valid)], {}
    if missing_joints := [name for name in joint_columns(robot) if name not in file_columns]:
        return sheet, [Problem(f"header: missing {', '.join(missing_joints)}", "")], {}
    stated = [name for name in (MASS, PULL) if name in file_columns]
    loads, problems = _numbers(read_sheet, tuple(stated), lowest=0.0)
    no_load = np.isnan(loads).all(axis=1)
    problems += [
        cell_problem(read_sheet, row, stated[0], "a mass in kg or a pull in N")
        for row in np.flatnonzero(no_load)
    ]
    loads = np.nan_to_num(loads)
    force = np.zeros((len(loads), 3))
    if MASS in stated:
        force += loads[:, :1] * robot.gravity
    if PULL in stated:
        directions, direction_problems = _numbers(read_sheet, PULL_COLUMNS)
        directions, pull = np.nan_to_num(directions), loads[:, -1:]
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        problems += direction_problems
        problems += [
            cell_problem(read_sheet, row, PULL_COLUMNS[0], "a direction, not 0, 0, 0")
            for row in np.flatnonzero((pull > 0.0) & (length == 0.0))
        ]
        force += pull * directions / np.where(length > 0.0, length, 1.0)
    q = np.nan_to_num(read_sheet.numbers(joint_columns(robot))) / file_units(robot)
    torque = np.zeros_like(force)
    if options.hook is not None:
        torque = np.cross(robot.lever(q, np.array(options.hook)), force)
    used = [*stated, *(name for name in PULL_COLUMNS if name in file_columns)]
    names = ", ".join(read_sheet.headers.get(name, name) for name in stated)
    at = "the TCP" if options.hook is None else "the hook"
    sheet = _replaced(
        sheet,
        read_sheet,
        used,
        dict(zip(WRENCH_COLUMNS, np.hstack([force, torque]).T, strict=True)),
        f"forces of {names} act at {at}",
    )
    return sheet, problems, dict.fromkeys(WRENCH_COLUMNS, names)


def _with_deflections(
    sheet: Sheet, read_sheet: Sheet, robot: Robot
) -> tuple[Sheet, list[Problem], dict[str, str]]:
    """Replace readings by deflections along their directions; cells of no reading stay empty."""
    file_columns = {*read_sheet.cells}
    both_forms = {*sheet.with_standard_columns((*DEFLECTION_COLUMNS, *LOADED_COLUMNS)).cells}
    if both_forms:
        text = f"header: both {', '.join(sorted(both_forms))} and readings"
        return sheet, [Problem(text, "one of them")], {}
    stated = [READING] if READING in file_columns else [*STATE_READINGS[:2]]
    needed = (*stated, *DIRECTION_COLUMNS)
    if missing := [name for name in needed if name not in file_columns]:
        valid = f"{', '.join(needed)}: readings, and their direction in the robot base frame"
        return sheet, [Problem(f"header: missing {', '.join(missing)}", valid)], {}
    has_again = READING not in stated and STATE_READINGS[2] in file_columns
    stated += [STATE_READINGS[2]] * has_again
    numbers, problems = _numbers(read_sheet, tuple(stated))
    directions, direction_problems = _numbers(read_sheet, DIRECTION_COLUMNS)
    length = np.linalg.norm(np.nan_to_num(directions), axis=1, keepdims=True)
    problems += direction_problems
    problems += [
        cell_problem(read_sheet, row, DIRECTION_COLUMNS[0], "a direction, not 0, 0, 0")
        for row in np.flatnonzero(length[:, 0] == 0.0)
    ]
    problems += _point_problems(read_sheet)
    loading, loading_problems = _loadings(read_sheet, has_again=has_again or READING in stated)
    problems += loading_problems
    if READING in stated:
        value = numbers[:, 0]
    else:
        unloaded = numbers[:, 0].copy()
        if has_again:
            unloaded = np.where(loading == "second", numbers[:, 2], unloaded)
            mean = (numbers[:, 0] + numbers[:, 2]) / 2.0
            unloaded = np.where(loading == "mean", mean, unloaded)
        value = numbers[:, 1] - unloaded
    if len(value) >= FEWEST_ZEROS and (value == 0.0).all():
        text = f"column {read_sheet.headers.get(stated[-1], stated[-1])}: every reading is 0"
        problems.append(Problem(text, "readings; if there are none, leave the cells empty"))
    unit = directions / np.where(length > 0.0, length, 1.0)
    moved = (value[:, None] * unit).astype(object)
    moved[np.isnan(value)] = ""
    columns = dict(zip(DEFLECTION_COLUMNS, moved.T, strict=True))
    if has_again and np.isfinite(numbers).all():
        stays = (numbers[:, 2] - numbers[:, 0])[:, None] * unit
        columns |= dict(zip(AFTER_COLUMNS, stays.T, strict=True))
    shown_names = [read_sheet.headers.get(name, name) for name in stated]
    words = ", ".join(dict.fromkeys(loading.tolist()))
    note = f"deflections are {' and '.join(shown_names)} along {', '.join(DIRECTION_COLUMNS)}"
    note += f", of the {words} loading" * (READING not in stated or LOADING in file_columns)
    used = [*stated, *[LOADING] * (LOADING in file_columns)]
    sheet = _replaced(sheet, read_sheet, used, columns, note)
    return sheet, problems, dict.fromkeys(DEFLECTION_COLUMNS, ", ".join(shown_names))


def _loadings(read_sheet: Sheet, *, has_again: bool) -> tuple[FloatArray, list[Problem]]:
    """Return the (n,) words of `LOADINGS`, first where the file says nothing, and problems."""
    n = len(read_sheet.cells)
    if LOADING not in read_sheet.cells:
        return np.full(n, LOADINGS[0]), []
    words = read_sheet.cells[LOADING].astype(str).str.strip().str.lower().to_numpy(dtype=str)
    words = np.where(np.isin(words, [*EMPTY_SIGNS]), LOADINGS[0], words)
    problems = [
        cell_problem(read_sheet, row, LOADING, ", ".join(LOADINGS))
        for row in np.flatnonzero(~np.isin(words, LOADINGS))
    ]
    if not has_again and not problems:
        problems = [
            cell_problem(read_sheet, row, LOADING, "first; the others need a column reading2_mm")
            for row in np.flatnonzero(words != LOADINGS[0])
        ]
    return words, problems


def _point_problems(read_sheet: Sheet) -> list[Problem]:
    """Return missing columns of the gauge's point, and rows with a part of one or a far one."""
    missing = [name for name in POINT_COLUMNS if name not in read_sheet.cells]
    if missing:
        text, valid = f"header: missing {', '.join(missing)}", ", ".join(POINT_COLUMNS)
        return [Problem(text, valid)] * (len(missing) < len(POINT_COLUMNS))
    points, problems = _numbers(read_sheet, POINT_COLUMNS)
    if problems:
        return problems
    most, is_empty = MM_PER_M * LONGEST_M, np.isnan(points)
    is_wrong = (is_empty & ~is_empty.all(axis=1, keepdims=True)) | (np.abs(points) > most)
    valid = f"at most {most:g} mm; three empty cells where the gauge touches the TCP"
    return [
        cell_problem(read_sheet, row, POINT_COLUMNS[int(is_wrong[row].argmax())], valid)
        for row in np.flatnonzero(is_wrong.any(axis=1))
    ]


def _numbers(
    read_sheet: Sheet, columns: tuple[str, ...], lowest: float = -np.inf
) -> tuple[FloatArray, list[Problem]]:
    """Return the (n, n_columns) numbers, NaN where a cell is empty, and problems of the others."""
    numbers = read_sheet.numbers(columns)
    problems = []
    for row, place in np.argwhere(~np.isfinite(numbers) | (numbers < lowest)):
        cell = str(read_sheet.cells[columns[place]].iloc[row])
        if plain_minus(cell).strip().lower() not in EMPTY_SIGNS:
            valid = "a number of at least 0" if np.isfinite(lowest) else "a finite number"
            problems.append(cell_problem(read_sheet, row, columns[place], valid))
    return numbers, problems


def _replaced(
    sheet: Sheet, read_sheet: Sheet, used: list[str], columns: dict[str, FloatArray], note: str
) -> Sheet:
    """Return the sheet with other columns in place of the used ones."""
    cells = sheet.cells.drop(columns=[read_sheet.headers.get(name, name) for name in used])
    columns = {name: np.asarray(values, dtype=object) for name, values in columns.items()}
    return replace(sheet, cells=cells.assign(**columns), notes=(*sheet.notes, note))
