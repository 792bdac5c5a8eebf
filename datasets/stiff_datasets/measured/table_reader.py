"""Read and write tables of samples as CSV, Excel or Parquet files.

`sample_columns.py` lists the columns. Other common names and units are understood. So are a row of
units below the header, semicolons, tabs, bars or blanks with decimal commas, titles or merged cells
above the header, a header that begins with ``#``, and remarks.
"""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stiff_datasets.measured.excel_file import (
    MAX_CELLS,
    Row,
    column_name,
    excel_rows,
    is_remark,
    office_file,
    size_error,
    with_formulas,
)
from stiff_datasets.measured.sample_columns import (
    AFTER_COLUMNS,
    DEFLECTION_COLUMNS,
    DIRECTION_COLUMNS,
    ID_COLUMNS,
    MAX_CELL_LENGTH,
    MM_PER_M,
    NAMES,
    ORDER,
    POINT_COLUMNS,
    READING,
    UNITS,
    WRENCH_COLUMNS,
    file_units,
    in_file_units,
    joint_columns,
    shortened,
    split_header,
)
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.files import other_content, written_whole
from stiff_protocols.contract.types import (
    BenchmarkData,
    BoolArray,
    FloatArray,
    IntArray,
    Robot,
    Samples,
)

PARQUET, EXCEL = ".parquet", ".xlsx"
"""Extensions of Parquet and Excel files; every other file is CSV."""
MAX_COLUMNS = 1000

_MINUS_SIGNS = "\u2010\u2011\u2012\u2013\u2212\ufe63\uff0d"
"""Dashes and minus signs in numbers of Word, R and LaTeX."""
_PLAIN_MINUS = str.maketrans(_MINUS_SIGNS, "-" * len(_MINUS_SIGNS))
_SIGN = rf"[+{_MINUS_SIGNS}-]?"
NUMBER = re.compile(rf"{_SIGN}(\d+(\.\d*)?|\.\d+)([eE]{_SIGN}\d+)?", re.ASCII)
_GROUPED = re.compile(rf"{_SIGN}\d{{1,3}}(?:(?:\.\d{{3}})+,|(?:,\d{{3}})+\.)\d+", re.ASCII)
"""A number with thousands separators and decimals. For 1.234 see `MAYBE_GROUPED`."""
MAYBE_GROUPED = re.compile(rf"{_SIGN}[1-9]\d{{0,2}}[.,]\d{{3}}", re.ASCII)
_MIN_HEADER_NAMES, _MAX_TITLE_ROWS = 3, 20
"""The header is the first row with three names of columns, among the first twenty rows."""
_MAX_NAMES_SHOWN = 1000
"""Characters of the names of unused columns in a message."""
_WIDTH_HINTS = {
    ",": "; decimal commas need semicolons between columns",
    " ": "; blanks separate the columns, so that no cell may be empty or have a blank",
}
"""Separator -> what may be wrong with a row of another width."""
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f]")
"""Signs that no text has."""
_NO_UNIT = re.compile(r"[-\u2013\u2014]*")
_MIN_UNITS_IN_ROW = 3
"""Least number of units in a row of units below the header."""
_SEPARATORS = (r"[,;\t|]", r"\s{2,}|\t", r"\s+")
"""Separators of a header: signs, else columns that blanks align, else single blanks."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """The cells of a file, before any check.

    Attributes:
        path: the file.
        cells: text (CSV) or values of other types, without blank rows.
        lines: (n,) row number of each data row, for messages. In a CSV or Excel file it is the
            line number of an editor. A Parquet file has no header row; its first row is 1.
        decimal: decimal sign in text.
        factors: column -> factor from its unit in the file to the standard unit, if they differ.
        headers: column -> its name in the file, if it differs.
        unused: names of columns that are not recognised.
        odd_units: unused columns with a standard name and an invalid unit -> the valid units.
        notes: interpretations of the file that its header does not state.
    """

    path: Path
    cells: pd.DataFrame
    lines: IntArray
    decimal: str = "."
    factors: Mapping[str, float] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    unused: tuple[str, ...] = ()
    odd_units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def oddities(self) -> list[str]:
        """Notes, and one line with the names of unused columns."""
        unused = [f"columns not used: {self.unused_text}"] if self.unused else []
        return [f"{self.path}: {line}" for line in (*self.notes, *unused)]

    @property
    def unused_text(self) -> str:
        """Names of unused columns, as text for a message."""
        return shortened(", ".join(map(shortened, self.unused)), _MAX_NAMES_SHOWN)

    def take(self, rows: BoolArray | slice) -> Sheet:
        """Return the rows of `rows`."""
        cells = self.cells[rows].reset_index(drop=True)
        return replace(self, cells=cells, lines=self.lines[rows])

    def is_formula(self, cell: object) -> bool:
        """Test if a cell of an Excel file holds a formula without its value."""
        is_excel = self.path.suffix.lower() == EXCEL
        return is_excel and isinstance(cell, str) and cell.startswith("=")

    def numbers(self, columns: tuple[str, ...]) -> FloatArray:
        """Return the cells (n, len(columns)) in standard units; NaN if a cell is not finite."""
        doubtful = self._doubtful_signs
        values = [
            [_cell_number(cell, self.decimal, doubtful) for cell in self.cells[column]]
            for column in columns
        ]
        factors = [self.factors.get(column, 1.0) for column in columns]
        with np.errstate(over="ignore"):  # then it is not finite
            return np.asarray(np.array(values, dtype=np.float64).T * factors)

    @cached_property
    def _doubtful_signs(self) -> str:
        """Signs for decimals or thousands: the point in 1.234 if the file has 0,5, too."""
        if self.decimal != ",":
            return ""
        cells = self.cells.drop(columns=[*ID_COLUMNS, "frame"], errors="ignore")
        texts = [cell for cell in cells.to_numpy().ravel() if isinstance(cell, str)]
        texts = [text for text in texts if NUMBER.fullmatch(text.replace(",", "."))]
        plain = "".join(text for text in texts if not MAYBE_GROUPED.fullmatch(text))
        clear = {*plain} & {*".,"}
        has_comma = any("," in text for text in texts)
        doubtful = "." if "," in clear or (has_comma and not clear) else ""
        return doubtful + ("," if clear == {"."} else "")

    def with_standard_columns(self, columns: tuple[str, ...]) -> Sheet:
        """Give recognised columns the names in `columns`, and separate the others.

        Upper and lower case, common names, and no unit or another unit of `UNITS` are recognised:
        ``A1``, ``q1 [rad]``, ``Fx[kN]``, ``dx_um``.
        """
        column_by_name = {split_header(column)[0]: column for column in columns}
        file_headers = [*self.cells.columns]
        used: dict[int, str] = {}
        factors: dict[str, float] = {}
        odd_units: dict[str, str] = {}
        for i, header in enumerate(file_headers):
            name, unit = split_header(header)
            column = column_by_name.get(name, "")
            standard_unit = column.rpartition("_")[2]
            units = UNITS.get(standard_unit, {})
            if column and (not unit or unit in units):
                used[i] = column
                factors |= {column: units[unit]} if units.get(unit, 1.0) != 1.0 else {}
            elif units:
                valid_units = (u for u in units if u.isascii() and u != standard_unit.lower())
                odd_units[header] = ", ".join([standard_unit, *valid_units])
        return replace(
            self,
            cells=self.cells.iloc[:, [*used]].set_axis([*used.values()], axis="columns"),
            factors=factors,
            headers={column: file_headers[i] for i, column in used.items()},
            unused=tuple(name for i, name in enumerate(file_headers) if i not in used),
            odd_units=odd_units,
        )


def read_sheet(path: Path, sheet: str | None = None) -> Sheet:
    """Read a CSV, Excel or Parquet file without checks.

    Args:
        path: the file.
        sheet: name of the Excel file's sheet; None: the only one that holds a table.

    Raises:
        DataError: the file cannot be read, is empty, or is not a table.
        ConfigError: the package that reads Excel or Parquet is not installed; the file does not
            have the sheet; or it has several sheets with tables and none is named.
    """
    suffix = path.suffix.lower()
    if sheet is not None and suffix != EXCEL:
        raise ConfigError(f"{sheet!r}: {path} has no sheets (valid: an {EXCEL} file)", "sheet")
    try:
        if suffix == EXCEL:
            return _read_excel(path, sheet)
        return _read_parquet(path) if suffix == PARQUET else _read_csv(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error


def sheet_of(path: Path, table: pd.DataFrame, first_row: int = 2) -> Sheet:
    """Return a table as the sheet of the file `path`; rows count from `first_row`."""
    cells = _with_text_names(table.astype(object).rename(columns=str), strip=False)
    return Sheet(path, cells, np.arange(len(cells), dtype=np.int64) + first_row)


def sample_table(samples: Samples, robot: Robot) -> pd.DataFrame:
    """Return the samples as a table in the units of files (deg, N, N m, mm).

    Every number is the shortest that reads back as the sample's SI number (`in_file_units`). For
    9 % of arbitrary angles and 4 % of lengths there is none. Then the nearest number is used, which
    reads back as the neighbour of the SI number (relative difference 1e-16).

    Raises:
        DataError: samples and robot have different numbers of joints.
    """
    BenchmarkData(samples, robot)  # checks that they match
    columns: dict[str, object] = {
        name: pd.Series(getattr(samples, name).tolist(), dtype=object) for name in ID_COLUMNS
    }
    units = file_units(robot)
    for i, name in enumerate(joint_columns(robot)):
        columns[name] = in_file_units(samples.q[:, i], units[i])
    columns |= dict(zip(WRENCH_COLUMNS, samples.wrench.T, strict=True))
    columns |= _deflection_cells(samples)
    if samples.levers.size:
        points = robot.points(samples.q, samples.levers)
        columns |= dict(zip(POINT_COLUMNS, in_file_units(points, MM_PER_M).T, strict=True))
    if samples.order.size:
        columns[ORDER] = samples.order
    columns |= {f"approach_q{i}": sign for i, sign in enumerate(samples.approach.T, start=1)}
    for name, values in zip(AFTER_COLUMNS, samples.after.T, strict=False):
        columns[name] = in_file_units(values, MM_PER_M)
    return pd.DataFrame(columns)


def _deflection_cells(samples: Samples) -> dict[str, FloatArray]:
    """Return deflections, mm, empty along axes that were not read; else single readings.

    Raises:
        DataError: a row has several readings along other directions than the axes, or of another
            point than the TCP.
    """
    directions, is_read = samples.directions, samples.is_read
    along = (np.abs(directions) > 0.0).sum(axis=2) if directions.size else np.ones(1)
    if (along <= 1).all() and not samples.levers.size:
        axes = np.asarray(directions.any(axis=1)) if directions.size else is_read
        lengths = [in_file_units(values, MM_PER_M) for values in samples.deflection.T]
        return {
            name: np.where(seen, values, np.nan)
            for name, seen, values in zip(DEFLECTION_COLUMNS, axes.T, lengths, strict=True)
        }
    if directions.shape[1] > 1:
        raise DataError("several readings of a row along other directions, or of other points")
    cells = {READING: in_file_units(samples.values[:, 0], MM_PER_M)}
    return cells | dict(zip(DIRECTION_COLUMNS, directions[:, 0].T, strict=True))


def write_table(path: Path, parts: Iterable[pd.DataFrame]) -> None:
    """Write a table in parts, completely or not at all.

    Args:
        path: Parquet if it has that extension, else CSV.
        parts: at least one; each is written before the next is requested.

    Raises:
        StoreError: the file cannot be written.
        ConfigError: the format is Excel, or it is Parquet and pyarrow is not installed.
    """
    if path.suffix.lower() == EXCEL:
        raise ConfigError(f"{path}: Excel files are read, not written (valid: .csv, {PARQUET})")
    if path.suffix == PARQUET:
        require(f"{path}: Parquet", "pyarrow")
    with written_whole(path) as temporary:
        if path.suffix == PARQUET:
            import pyarrow as pa
            from pyarrow.parquet import ParquetWriter

            tables = (pa.Table.from_pandas(part, preserve_index=False) for part in parts)
            first = next(tables)
            with ParquetWriter(temporary, first.schema) as writer:
                for table in itertools.chain([first], tables):
                    writer.write_table(table)
            return
        with temporary.open("w", encoding="utf-8", newline="") as file:
            for i, part in enumerate(parts):
                part.to_csv(file, index=False, header=i == 0, lineterminator="\n")


def _read_csv(path: Path) -> Sheet:
    """Read the table as text, so that messages show invalid values unchanged."""
    text, notes = _text(path, path.read_bytes())
    all_lines = [*_filled_lines(io.StringIO(text, newline=None))]
    lines = [(number, line) for number, line in all_lines if not is_remark(line)]
    stated = re.fullmatch(r"sep=([,;\t|])", lines[0][1].strip(" \ufeff")) if lines else None
    lines = lines[1:] if stated else lines  # written by Excel
    if not lines:
        raise DataError(f"{path}: the file is empty")
    pattern, first = _text_header(lines)
    if first is None:  # numpy.savetxt writes the header as a remark above the rows
        n_remarks = all_lines.index(lines[0])
        remarks = [(number, line.strip().lstrip("#")) for number, line in all_lines[:n_remarks]]
        in_remark, first = _text_header(remarks)
        if first is not None:
            pattern, lines = in_remark, [remarks[first], *lines]
        first = 0
    above: list[str] = []
    number, header = lines[first]
    if pattern == _SEPARATORS[0]:
        separator = stated[1] if stated else max(",;\t|", key=header.count)
        if first:
            above = [cell.strip(' "') for cell in lines[first - 1][1].split(separator)]
        lines = _single_tabs(lines[first:]) if separator == "\t" else lines[first:]
    else:
        header = header.replace('"', "").strip()
        names = re.split(pattern, header)
        rows_below = [(row, line.replace("\t", " ").strip()) for row, line in lines[first + 1 :]]
        if rows_below and len(header.split()) == len(rows_below[-1][1].split()):
            names = header.split()  # blanks align columns, and are single between long names
        separator = " "
        lines = [(number, " ".join(f'"{name}"' for name in names)), *rows_below]
    rows = [*_csv_rows(path, lines, separator)]
    sheet = _sheet_of_rows(path, rows, "." if separator == "," else ",", above)
    return replace(sheet, notes=(*notes, *sheet.notes))


def _text(path: Path, content: bytes) -> tuple[str, tuple[str, ...]]:
    """Return the text of a file, and a note on its encoding if the file does not state it."""
    encoding = "utf-8-sig"
    if kind := office_file(content) or other_content(content[:1000].decode("latin-1")):
        raise DataError(f"{path}: {kind}")
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif b"\0" in content[:2]:  # no byte order mark, first character in ASCII
        encoding = "utf-16-be" if content[:1] == b"\0" else "utf-16-le"
    notes: tuple[str, ...] = ()
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        byte = f"byte 0x{content[error.start]:02x} at {error.start}"
        try:
            text = content.decode("cp1252")  # Latin-1 has the same letters
        except UnicodeDecodeError:
            text = "\0"
        if encoding != "utf-8-sig" or _CONTROL.search(text):
            raise DataError(
                f"{path}: not a text in UTF-8 or UTF-16 ({byte}); save it as 'CSV UTF-8' or .xlsx"
            ) from error
        notes = (f"not UTF-8 ({byte}), so read as Windows-1252",)
    if "\0" in text:
        raise DataError(f"{path}: not a CSV table in UTF-8 or UTF-16: it has NUL characters")
    return text, notes


def _filled_lines(text: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Yield lines with content, and their numbers; skip separators."""
    for number, line in enumerate(text, start=1):
        if line.strip(' ,;\t\n"'):
            yield number, line.rstrip("\n")


def _text_header(lines: Sequence[tuple[int, str]]) -> tuple[str, int | None]:
    """Return the pattern of the separators and the index of the header; None: no header."""
    texts = [line.replace('"', "") for _, line in lines[:_MAX_TITLE_ROWS]]
    for pattern in _SEPARATORS:
        is_sign = pattern == _SEPARATORS[0]
        rows = (re.split(pattern, text if is_sign else text.strip()) for text in texts)
        if (first := _header(rows)) is not None:
            return pattern, first
    numbers_only = texts and all(map(NUMBER.fullmatch, texts[0].split()))
    return _SEPARATORS[-1 if numbers_only else 0], None


def _single_tabs(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """Return the lines with one tab between cells, if some have more to align their columns."""
    tight = [
        (number, "\t".join(cell for cell in line.split("\t") if cell.strip()))
        for number, line in lines
    ]
    n_tabs, n_tight = ({line.count("\t") for _, line in rows} for rows in (lines, tight))
    return tight if len(n_tabs) > 1 and len(n_tight) == 1 else lines


def _csv_rows(path: Path, lines: list[tuple[int, str]], separator: str) -> Iterator[Row]:
    """Yield rows as wide as the first; quoted cells may span lines.

    Missing cells at the end of a row are empty, except where blanks separate the columns.
    """
    begun = width = 0

    def texts() -> Iterator[str]:
        nonlocal begun
        for number, line in lines:
            begun = begun or number
            yield line
        if begun:
            raise csv.Error("the file ends inside a cell")

    try:
        for cells in csv.reader(texts(), delimiter=separator, skipinitialspace=True):
            number, begun, width = begun, 0, width or len(cells)
            if width > MAX_COLUMNS:
                raise DataError(
                    f"{path}: row {number} has {width:,} cells (valid: {MAX_COLUMNS:,})"
                )
            if len(cells) > width or (separator == " " and len(cells) < width):
                hint = _WIDTH_HINTS.get(separator, "")
                reason = f"row {number} has {len(cells)} cells, the header {width}{hint}"
                raise DataError(f"{path}: not a CSV table: {reason}")
            cells = [cell.strip() for cell in cells]
            if any(cells):
                yield number, cells + [""] * (width - len(cells))
    except csv.Error as error:
        reason = f"row {begun}: {error} (a quotation mark that is not closed?)"
        raise DataError(f"{path}: not a CSV table: {reason}") from error


def _sheet_of_rows(path: Path, rows: list[Row], decimal: str, above: Sequence[str] = ()) -> Sheet:
    """Return the sheet of rows whose first is the header; `above` are the cells above it."""
    (_, header), *rows = rows
    names = [str(name) or f"column {i + 1}" for i, name in enumerate(header)]
    notes: tuple[str, ...] = ()
    labelled = _with_labels(names, above)
    if labelled != names:
        names, notes = labelled, ("the row above the header belongs to the names of columns",)
    if rows and (units := _units_row(rows[0][1])):
        (number, _), *rows = rows
        names = _with_units(path, names, units, number)
        notes += (f"row {number} states the units of the columns",)
    cells = pd.DataFrame([row for _, row in rows], columns=names, dtype=object)
    is_used = (np.array(header, dtype=object) != "") | (cells != "").any().to_numpy()
    lines = np.array([number for number, _ in rows], dtype=np.int64)
    return Sheet(path, _with_text_names(cells.loc[:, is_used]), lines, decimal=decimal, notes=notes)


def _units_row(cells: Sequence[Any]) -> list[str] | None:
    """Return the units of a row of units, "" for none; None: another row."""
    texts = [str(cell).strip() for cell in cells]
    if any(NUMBER.fullmatch(text.replace(",", ".")) for text in texts):
        return None
    units = [
        "" if _NO_UNIT.fullmatch(text) else split_header(f"? [{text.strip('[]()')}]")[1]
        for text in texts
    ]
    n_known = sum(any(unit in unit_factors for unit_factors in UNITS.values()) for unit in units)
    return units if n_known >= _MIN_UNITS_IN_ROW else None


def _with_units(path: Path, names: list[str], units: list[str], number: int) -> list[str]:
    """Add the units of row `number` to column names without a unit."""
    named_columns = []
    for name, unit in zip(names, units, strict=True):
        standard_name, stated = split_header(name)
        factors = NAMES.get(standard_name, {})
        if stated and unit and factors.get(unit) != factors.get(stated):
            raise DataError(f"{path}: row {number}: unit {unit!r} of the column {name!r}")
        needed = unit and not stated and standard_name not in ID_COLUMNS
        named_columns.append(f"{name} [{unit}]" if needed else name)
    return named_columns


def _with_labels(names: Sequence[str], labels: Sequence[str]) -> list[str]:
    """Join names with the label above them, such as "unloaded [mm]" above X, Y and Z.

    They are joined only where both together are the name of a column, and two labels or more are,
    or one states the unit of such a column. A label counts for the columns without a label to its
    right, as a merged cell does. Of another label, such as "Loads [kN]", the unit is not understood
    but stays in the names.
    """
    joined, used_labels, word, unit, label, states_unit = [], set(), "", "", "", False
    for i, name in enumerate(names):
        if i < len(labels) and labels[i]:
            label = labels[i]
            word, unit = split_header(label)
        bare_name, stated = split_header(name)
        together = split_header(f"{word} {name}")[0]
        factors, is_name = NAMES.get(bare_name, {}), bare_name in NAMES
        if unit in factors and factors.get(stated, factors[unit]) != factors[unit]:
            states_unit, name = True, f"{name} [{label}]"  # two units: refused
        elif len(word) > 1 and together in NAMES and (bare_name == together or not is_name):
            used_labels.add(word)
            states_unit |= bare_name == together and bool(unit and not stated)
            name = name if bare_name == together else f"{word} {name}"
            name += f" [{unit}]" * bool(unit and not stated)
        elif not stated and factors.get(unit, 1.0) != 1.0 and label.strip().endswith(("]", ")")):
            states_unit, name = True, f"{name} [{label}]"
        joined.append(name)
    return joined if states_unit or len(used_labels) > 1 else [*names]


def _read_excel(path: Path, sheet: str | None) -> Sheet:
    tables = excel_rows(path, sheet)
    title, first = _table_sheet(path, tables, sheet)
    notes = (f"sheet {title!r} read",) if sheet is None and title != next(iter(tables)) else ()
    above = [str(cell) for cell in tables[title][first - 1][1]] if first else []
    rows = with_formulas(path, title, tables[title][first:])
    filled = sorted({i for _, row in rows for i, cell in enumerate(row) if cell != ""})
    if len(filled) > MAX_COLUMNS or len(filled) * len(rows) > MAX_CELLS:
        raise size_error(path, f"{len(rows):,} rows and {len(filled):,} columns of {title!r}")
    rows = [(number, [row[i] if i < len(row) else "" for i in filled]) for number, row in rows]
    header = rows[0][1]
    header[:] = [name or column_name(i) for i, name in zip(filled, map(str, header), strict=True)]
    above = [above[i] if i < len(above) else "" for i in filled]
    table_sheet = _sheet_of_rows(path, rows, ",", above)
    return replace(table_sheet, notes=(*notes, *table_sheet.notes))


def _table_sheet(path: Path, tables: Mapping[str, list[Row]], sheet: str | None) -> tuple[str, int]:
    """Return the name of the sheet to read and the row of its header."""
    if sheet is not None and sheet not in tables:
        valid = ", ".join(map(repr, tables))
        raise ConfigError(f"{sheet!r}: no sheet of {path} (valid: {valid})", "sheet")
    filled = {title: rows for title, rows in tables.items() if rows and sheet in (None, title)}
    if not filled:
        raise DataError(f"{path}: {'every sheet' if sheet is None else repr(sheet)} is empty")
    headers = {title: _header([*map(str, row)] for _, row in filled[title]) for title in filled}
    with_header = [title for title, first in headers.items() if first is not None]
    if len(with_header) > 1:
        valid = ", ".join(map(repr, with_header))
        reason = f"is needed: {path} holds tables on {len(with_header)} sheets (valid: {valid})"
        raise ConfigError(reason, "sheet")
    title = (with_header or [*filled])[0]
    return title, headers[title] or 0


def _read_parquet(path: Path) -> Sheet:
    require(f"{path}: Parquet", "pyarrow")
    import pyarrow as pa
    from pyarrow.parquet import ParquetFile

    with path.open("rb") as file:
        try:
            cells = ParquetFile(file).read().to_pandas(ignore_metadata=True)
        except (OSError, ValueError, KeyError, pa.ArrowException) as error:
            raise DataError(f"{path}: not a Parquet file, or a corrupt one") from error
    return sheet_of(path, _with_text_names(cells.astype(object).rename(columns=str)), first_row=1)


def _with_text_names(cells: pd.DataFrame, *, strip: bool = True) -> pd.DataFrame:
    """Convert the columns of names to text; they may hold numbers."""
    for i, header in enumerate(cells.columns):
        if split_header(header)[0] in ID_COLUMNS:
            column = cells.iloc[:, i]
            names = [*map(str, column.where(column.notna(), ""))]
            names = [name.strip() for name in names] if strip else names
            cells.iloc[:, i] = names
    return cells


def _header(rows: Iterable[Sequence[str]]) -> int | None:
    """Return the index of the header, the first row with names of columns; None: no row."""
    above: Sequence[str] = ()
    for i, row in enumerate(itertools.islice(rows, _MAX_TITLE_ROWS)):
        names = (split_header(name)[0] for name in _with_labels(row[:MAX_COLUMNS], above))
        if sum(name in NAMES for name in names) >= _MIN_HEADER_NAMES:
            return i
        above = [cell.strip() for cell in row]
    return None


def plain_minus(text: str) -> str:
    """Return a text with "-" in place of typographic minus signs and dashes."""
    return text.translate(_PLAIN_MINUS)


def _cell_number(cell: object, decimal: str, doubtful: str) -> float:
    """Return the number in a cell; NaN if it is not a finite number.

    `decimal` marks decimals in text; `doubtful` signs may mark decimals or thousands, as in 1.234.
    """
    number = np.nan
    if isinstance(cell, str):
        if len(cell) > MAX_CELL_LENGTH:
            return np.nan
        cell = plain_minus(cell)
        if doubtful and MAYBE_GROUPED.fullmatch(cell) and any(sign in cell for sign in doubtful):
            return np.nan
        if _GROUPED.fullmatch(cell):
            decimal = "," if cell.rfind(",") > cell.rfind(".") else "."
            cell = cell.replace("." if decimal == "," else ",", "")
        cell = cell.replace(decimal, ".")
        number = float(cell) if NUMBER.fullmatch(cell) else np.nan
    elif isinstance(cell, int | float | np.integer | np.floating) and not isinstance(cell, bool):
        with suppress(OverflowError):  # of a whole number
            number = float(cell)
    return number if math.isfinite(number) else np.nan
