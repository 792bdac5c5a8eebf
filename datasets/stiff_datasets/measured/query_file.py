"""Read tables of loads at poses for `bench predict`, and write them with the predictions.

The columns are listed in `sample_columns.py`, without the deflections: ``q1_deg .. qn_deg, fx_N ..
tz_Nm``. Optional columns are ``pose_id, load_id, group``. The file may also have ``dx_mm, dy_mm,
dz_mm``, as in a measurement or a plan. They are not read; in the written file these columns are the
predictions. All other columns are written as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from pandas.api.types import infer_dtype

from stiff_datasets.measured.row_checks import (
    checked_table,
    outside_limits_text,
    problems_error,
    radian_problems,
)
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    ID_COLUMNS,
    MM_PER_M,
    WRENCH_COLUMNS,
    all_columns,
    file_units,
    in_file_units,
    joint_columns,
)
from stiff_datasets.measured.table_reader import Sheet, read_sheet, sheet_of, write_table
from stiff_protocols.contract.types import AXES, FloatArray, Interval, Robot

EXTRAPOLATES_COLUMN = "extrapolates"
PREDICTED_COLUMNS = (
    EXTRAPOLATES_COLUMN,
    *(f"d{axis}_{end}_mm" for axis in AXES for end in ("lower", "upper")),
)
"""Columns of predictions besides the deflections."""


@dataclass(frozen=True, eq=False)
class Loads:
    """Loads at poses.

    Attributes:
        q: (n, n_joints) rad or m.
        wrench: (n, 6) N and N m at the TCP, base frame.
    """

    q: FloatArray
    wrench: FloatArray


@dataclass(frozen=True, eq=False)
class LoadTable(Loads):
    """The rows of a file, checked.

    Attributes:
        columns: names, joint positions and wrenches in the units of files, then the other columns
            as in the file, without earlier predictions.
        oddities: warnings, one line each.
    """

    columns: pd.DataFrame
    oddities: tuple[str, ...]


def read_loads(path: Path, robot: Robot, sheet_name: str | None = None) -> LoadTable:
    """Read a file of loads at poses.

    Args:
        path: the file; Parquet or Excel if it ends in .parquet or .xlsx, else CSV.
        robot: gives the number and the kinds of joints, and their limits.
        sheet_name: sheet of an Excel file; None: the only sheet with a table.

    Raises:
        ConfigError: the file does not have the sheet, or has several with tables and none is named.
        DataError: the file is unreadable or empty, or its header or a value is invalid. The message
            names file, row (1 is the header of a CSV file), column, value and valid values.
    """
    return _loads(read_sheet(path, sheet_name), robot)


def loads_of(name: str, table: pd.DataFrame, robot: Robot) -> LoadTable:
    """Check a table with the columns of a file and return its loads.

    It raises the errors of `read_loads`, with `name` in place of the file. Rows count from 0, as in
    `table.iloc`.
    """
    return _loads(sheet_of(Path(name), table, first_row=0), robot)


def _loads(cells: Sheet, robot: Robot) -> LoadTable:
    path, sheet = cells.path, cells.with_standard_columns(all_columns(robot))
    joints, further = joint_columns(robot), (*ID_COLUMNS, *DEFLECTION_COLUMNS)
    sheet, numbers, problems = checked_table(sheet, (*joints, *WRENCH_COLUMNS), {}, further, robot)
    if problems:
        raise problems_error(path, problems)
    q_file, wrench = np.split(numbers, [len(joints)], axis=1)
    warning_texts = [*map(str, radian_problems(q_file, robot))]
    if outside_limits := outside_limits_text(sheet, q_file, robot):
        warning_texts.append(outside_limits)
    names = [name for name in ID_COLUMNS if name in sheet.cells]
    columns: dict[str, object] = {name: sheet.cells[name].to_numpy(dtype=object) for name in names}
    columns |= dict(zip((*joints, *WRENCH_COLUMNS), numbers.T, strict=True))
    return LoadTable(
        q=q_file / file_units(robot),
        wrench=wrench,
        columns=pd.DataFrame(columns | _further_columns(cells, sheet)),
        oddities=(*sheet.oddities, *(f"{path}: {oddity}" for oddity in warning_texts)),
    )


def _further_columns(cells: Sheet, sheet: Sheet) -> dict[str, pd.Series]:
    """Return the columns of a file besides its loads and earlier predictions.

    `sheet` has the recognised columns of `cells`. Repeated names get a number. A column with values
    of several types becomes text, because Parquet has one type per column.
    """
    further: dict[str, pd.Series] = {}
    for i, header in enumerate(cells.cells.columns):
        if header not in sheet.unused or header in PREDICTED_COLUMNS:
            continue
        name, number = header, 0
        while name in further:
            number += 1
            name = f"{header}.{number}"
        values = cells.cells.iloc[:, i].reset_index(drop=True).infer_objects()
        is_mixed = infer_dtype(values).startswith("mixed")
        further[name] = values.astype(str) if is_mixed else values
    return further


def write_predictions(
    path: Path,
    table: LoadTable,
    deflection: FloatArray,
    extrapolates: Sequence[str],
    interval: Interval | None = None,
) -> None:
    """Write the rows with their predicted deflections, completely or not at all.

    Args:
        path: the file; Parquet if it ends in .parquet, else CSV.
        table: the rows.
        deflection: (n, 3) m, base frame; ``dx_mm, dy_mm, dz_mm``.
        extrapolates: (n,) quantities of a row beyond the training range, such as "joints load".
        interval: interval of the same rows; ``dx_lower_mm, dx_upper_mm, ...``.
    """
    columns = dict(zip(DEFLECTION_COLUMNS, deflection.T, strict=True))
    if interval is not None:
        columns |= interval_columns(interval)
    in_mm = {name: in_file_units(np.asarray(values), MM_PER_M) for name, values in columns.items()}
    marks = {EXTRAPOLATES_COLUMN: list(extrapolates)}
    write_table(path, [table.columns.assign(**in_mm).assign(**marks)])


def interval_columns(interval: Interval) -> dict[str, FloatArray]:
    """Return the columns of an interval: names -> bounds, m."""
    columns = {}
    for i, axis in enumerate(AXES):
        columns[f"d{axis}_lower_mm"] = interval.lower[:, i]
        columns[f"d{axis}_upper_mm"] = interval.upper[:, i]
    return columns
