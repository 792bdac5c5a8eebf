"""Read the process loads of a program's motions from a table by line number, and write one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from stiff_apply.programs.program import RobotProgram
from stiff_datasets.measured.row_checks import (
    NO_TORQUE,
    Problem,
    cell_problem,
    checked_table,
    problems_error,
)
from stiff_datasets.measured.sample_columns import WRENCH_COLUMNS
from stiff_datasets.measured.table_reader import read_sheet, write_table
from stiff_protocols.contract.types import FloatArray

LINE_COLUMN = "line"


def loads_by_line(file: Path, program: RobotProgram) -> FloatArray:
    """Return the (n_motions, 6) loads of a program's motions, N and N m; NaN if not given.

    Args:
        file: CSV, Excel or Parquet with the columns line, fx_N, fy_N, fz_N and, if torques act,
            tx_Nm, ty_Nm, tz_Nm; `line` is the number of the motion's line in the program, from 1.
        program: the program with the motions.

    Raises:
        DataError: the file cannot be read, a value is invalid, a line has two loads, or a target
            has no load.
    """
    columns = (LINE_COLUMN, *WRENCH_COLUMNS)
    sheet = read_sheet(file, None).with_standard_columns(columns)
    sheet, numbers, problems = checked_table(sheet, columns, NO_TORQUE)
    wrench = numbers[:, 1:]
    lines, rows = np.unique(numbers[:, 0], return_index=True)
    targets, motion_lines = {*program.lines.tolist()}, {*program.motion_lines.tolist()}
    for row, line in enumerate(numbers[:, 0].tolist()):
        if line == line and line not in motion_lines:
            valid = f"a line of {program.paths[0]} with a motion"
            problems.append(cell_problem(sheet, row, LINE_COLUMN, valid))
        elif line == line and row not in rows:
            problems.append(cell_problem(sheet, row, LINE_COLUMN, "each line once"))
    if not problems and (missing := sorted(targets - {*lines.tolist()})):
        text = f"no load for line {missing[0]} of {program.paths[0]}"
        text += f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        problems = [Problem(text, f"a row for each of the {len(targets)} lines with a target")]
    if problems:
        raise problems_error(file, problems)
    place = np.searchsorted(lines, program.motion_lines).clip(max=len(lines) - 1)
    is_given = lines[place] == program.motion_lines
    return np.where(is_given[:, None], wrench[rows[place]], np.nan)


def write_loads_template(file: Path, program: RobotProgram, load: FloatArray) -> None:
    """Write a table for `loads_by_line`: each line with a motion, with the (n_motions, 6) loads."""
    lines, rows = np.unique(program.motion_lines, return_index=True)
    table = pd.DataFrame(np.nan_to_num(load[rows]), columns=[*WRENCH_COLUMNS])
    table.insert(0, LINE_COLUMN, lines)
    write_table(file, [table])
