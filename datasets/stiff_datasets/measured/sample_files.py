"""Tables of measured samples as files, CSV or Parquet: the schema, reading and writing.

Columns, one row a load at a pose: ``pose_id, load_id, group, q1_deg .. qn_deg, fx_N, fy_N, fz_N,
tx_Nm, ty_Nm, tz_Nm, dx_mm, dy_mm, dz_mm`` (``q2_mm`` where joint 2 is prismatic). The wrench
acts at the TCP; wrench and deflection are expressed in the robot base frame; a deflection is the
loaded minus the unloaded position.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import written_whole
from stiff_protocols.contract.types import BenchmarkData, FloatArray, Robot, Samples

ID_COLUMNS = ("pose_id", "load_id", "group")
SIMULATED_GROUP = "simulated"
"""The group of rows that `bench data simulate` wrote."""
WRENCH_COLUMNS = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")
DEFLECTION_COLUMNS = ("dx_mm", "dy_mm", "dz_mm")
MM_PER_M = 1000.0
DEG_PER_RAD = 180.0 / np.pi

PARQUET = ".parquet"
"""The ending of a Parquet file; every other file is CSV."""

MOST_COLUMNS = 100
"""No robot has so many joints."""
LONGEST_CELL = 100
"""Characters of a name or a number; an array of names is as wide as its longest."""
LONGEST_LINE = 20_000
"""Characters; a line of 500,000 commas takes pandas seconds."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_DECIMALS = 10
"""Numbers are written with so few decimals where that reads back as the same SI number."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """The cells of a file, before any check.

    Attributes:
        path: the file.
        cells: text (CSV) or whatever the file holds (Parquet), without blank rows.
        lines: (n,) row number of each data row, for messages. In a CSV file it is the line as
            an editor counts, so row 1 is the header; a Parquet file has no header row, and row 1
            is its first.
    """

    path: Path
    cells: pd.DataFrame
    lines: NDArray[np.int64]

    def numbers(self, columns: tuple[str, ...]) -> FloatArray:
        """Return (n, len(columns)) the cells as numbers, NaN where a cell is no finite one.

        Text is read as Python reads it, to the nearest floating point number; not every version
        of pandas promises that.
        """
        values = [[_number(cell) for cell in self.cells[column]] for column in columns]
        return np.array(values, dtype=np.float64).T


def joint_columns(robot: Robot) -> tuple[str, ...]:
    """Return the names of the joint columns, base to tip, with their units."""
    units = {"revolute": "deg", "prismatic": "mm"}
    return tuple(f"q{i + 1}_{units[kind]}" for i, kind in enumerate(robot.joint_types))


def all_columns(robot: Robot) -> tuple[str, ...]:
    """Return the names of all columns, in the order in which they are written."""
    return (*ID_COLUMNS, *joint_columns(robot), *WRENCH_COLUMNS, *DEFLECTION_COLUMNS)


def file_units(robot: Robot) -> FloatArray:
    """Return (n_joints,) how many of the file's units make one rad or one m."""
    return np.array([DEG_PER_RAD if k == "revolute" else MM_PER_M for k in robot.joint_types])


def read_sheet(path: Path) -> Sheet:
    """Read a CSV or Parquet file as it is.

    Raises:
        DataError: the file cannot be read, is empty, or is no table.
        ConfigError: it is Parquet, and pyarrow is not installed.
    """
    try:
        return _read_parquet(path) if path.suffix == PARQUET else _read_csv(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error


def sample_table(samples: Samples, robot: Robot) -> pd.DataFrame:
    """Return the samples as a table in the units of files (deg, N, N m, mm).

    Every number is the plainest one that `measured.read_samples` turns into the
    sample's SI number again: rounded to ten decimals, else as it is, else one of its neighbours
    in floating point. One of these exists for every number that was read from a file (a division
    and a multiplication each err by less than half a unit in the last place, so their product
    lands on the number or next to it). Of arbitrary SI numbers, 9 % of the angles and 4 % of the
    lengths are the image of no number in deg or mm; the nearest one is taken, which reads back
    as the neighbour of the SI number (1e-16 of it).

    Raises:
        DataError: samples and robot have different numbers of joints.
    """
    BenchmarkData(samples, robot)  # checks that they belong together
    columns: dict[str, object] = {
        name: pd.Series(getattr(samples, name).tolist(), dtype=object) for name in ID_COLUMNS
    }
    units = file_units(robot)
    for i, name in enumerate(joint_columns(robot)):
        columns[name] = in_file_units(samples.q[:, i], units[i])
    columns |= dict(zip(WRENCH_COLUMNS, samples.wrench.T, strict=True))
    for name, values in zip(DEFLECTION_COLUMNS, samples.deflection.T, strict=True):
        columns[name] = in_file_units(values, MM_PER_M)
    return pd.DataFrame(columns)


def sheet_of(path: Path, table: pd.DataFrame) -> Sheet:
    """Return the sheet of a table that is, or is to be, the file `path`."""
    cells = table.astype(object)
    first = 1 if path.suffix == PARQUET else 2
    return Sheet(path, cells, np.arange(len(cells), dtype=np.int64) + first)


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write a `sample_table`, as Parquet if `path` ends so, else as CSV; whole or not at all.

    Raises:
        StoreError: the file cannot be written.
        ConfigError: Parquet is asked for and pyarrow is not installed.
    """
    if path.suffix == PARQUET:
        require(f"{path}: Parquet", "pyarrow")
    with written_whole(path) as temporary:
        if path.suffix == PARQUET:
            table.to_parquet(temporary, index=False)
        else:
            table.to_csv(temporary, index=False, lineterminator="\n", encoding="utf-8")


def _read_csv(path: Path) -> Sheet:
    """Return the table as text, so that a message can show a wrong value as it was written."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        longest = max(map(len, text.split("\n")))
        if longest > LONGEST_LINE:
            raise DataError(f"{path}: a line of {longest} characters (valid: {LONGEST_LINE})")
        header = text.partition("\n")[0]
        for name, separator in (("semicolons", ";"), ("tabs", "\t")):
            if separator in header and "," not in header:
                raise DataError(
                    f"{path}: header: separated by {name} (valid: commas, and points in numbers)"
                )
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            cells = pd.read_csv(
                io.StringIO(text),
                dtype=object,
                skipinitialspace=True,
                index_col=False,
                keep_default_na=False,  # a pose may be called NA
                skip_blank_lines=False,  # or the numbers of rows would not be those of lines
            )
    except pd.errors.EmptyDataError:
        raise DataError(f"{path}: the file is empty, or its first line is") from None
    except (pd.errors.ParserError, pd.errors.ParserWarning, UnicodeDecodeError) as error:
        raise DataError(f"{path}: not a CSV table: {' '.join(str(error).split())}") from error
    cells = cells.rename(columns=str.strip).fillna("").map(str.strip)
    cells = cells[(cells != "").any(axis=1)]
    return Sheet(path, cells, cells.index.to_numpy(dtype=np.int64) + 2)


def _read_parquet(path: Path) -> Sheet:
    require(f"{path}: Parquet", "pyarrow")
    import pyarrow as pa
    from pyarrow.parquet import ParquetFile

    size = path.stat().st_size
    try:
        about = ParquetFile(path).metadata
        if about.num_columns > MOST_COLUMNS:
            raise ValueError(f"{about.num_columns} columns (valid: at most {MOST_COLUMNS})")
        if about.num_rows > size:  # a measured row takes dozens of bytes, one repeated takes none
            raise ValueError(f"{about.num_rows} rows in {size} bytes")
        paths = [about.schema.column(i).path for i in range(about.num_columns)]
        # as a dictionary, a long text in many rows is kept once
        table = ParquetFile(path, read_dictionary=paths).read()
        cells = table.to_pandas(ignore_metadata=True)
    except (ValueError, KeyError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise DataError(f"{path}: not a Parquet table: {reason}") from error
    cells = cells.astype(object).rename(columns=str)
    for name in set(ID_COLUMNS) & set(cells.columns):
        names = cells[name].where(cells[name].notna(), "")
        stripped = [str(value).strip() for value in names]  # a name may be a number there
        cells[name] = pd.Series(stripped, dtype=object)
    return sheet_of(path, cells)


def _number(cell: object) -> float:
    number = np.nan
    if isinstance(cell, str):
        short = len(cell) <= LONGEST_CELL
        number = float(cell) if short and _NUMBER.fullmatch(cell) else np.nan
    elif isinstance(cell, int | float | np.integer | np.floating) and not isinstance(cell, bool):
        number = float(cell)
    return number if math.isfinite(number) else np.nan


def in_file_units(values: FloatArray, unit: float) -> FloatArray:
    """Return (n,) the numbers x for which x / `unit` is `values` (n,), or comes nearest."""
    with np.errstate(over="ignore"):  # then the next candidate is the right one
        result = np.asarray(values * unit)
        candidates = (
            np.nextafter(result, np.inf),
            np.nextafter(result, -np.inf),
            result,
            np.round(result, _DECIMALS),
        )
    for candidate in candidates:  # the best last
        result = np.where(candidate / unit == values, candidate, result)
    return result
