"""Read the rows of Excel files; a file that is too large is refused before its cells are read."""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import ZipFile, is_zipfile

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.extras import require

Row = tuple[int, list[Any]]
"""Row number in the file, cells."""

MAX_UNPACKED_BYTES = 64 * 2**20
MAX_CELLS = 1_000_000
"""Cells of a file, and rows times columns of a sheet: about 55,000 samples."""
_TAGS_PER_CELL = 4
_MAX_STYLE_TAGS = 150_000
"""Excel has 65,490 formats of cells."""
_LONGEST_TAG = 2**18
"""Bytes with the text behind it; Excel's longest text has 32,767 characters."""
_TAG = re.compile(rb"<[^<]+")
_LAST_ROW = 2**20
"""The last row of Excel."""
_LARGEST_NAME = 1e15
"""Whole numbers below it may be names; larger ones are shown as Excel shows them, 1e+200."""
_REMARK = re.compile(r"\s*#(?!(?:N/A|NV|[A-Z\u00c4-\u00dc0-9/]+[!?])(?:[\s,;]|$))")
"""The begin of a remark, and not of an error of Excel such as #DIV/0!, #REF! or #WERT!."""


class _EmptyText(str):
    """The value of a formula that was computed and is empty."""

    __slots__ = ()


def excel_rows(path: Path, sheet: str | None) -> dict[str, list[Row]]:
    """Read the rows of an Excel file, without blank rows and remarks.

    Args:
        path: the file.
        sheet: the only sheet to read; None: all but hidden ones.

    Returns:
        Name of each sheet -> its rows; no rows for a sheet that was not asked for. Rows end at
        their last filled cell; an empty cell is "". An error is its text, such as "#DIV/0!".

    Raises:
        DataError: the file is not an Excel file, is corrupt, or is too large.
        ConfigError: openpyxl is not installed.
    """
    titles_and_rows = _parsed(path, sheet, values=True)
    return {
        title: [(number, row) for number, row in rows if not is_remark(str(row[0]))]
        for title, rows in titles_and_rows.items()
    }


def with_formulas(path: Path, sheet: str, rows: list[Row]) -> list[Row]:
    """Replace the empty cells of `rows` by their formulas, such as "=P2-M2".

    Excel stores a formula's value when it saves the file. Other programs may store none.

    Raises:
        DataError: as in `excel_rows`.
    """
    formulas = dict(_parsed(path, sheet, values=False)[sheet])
    filled_rows = []
    for number, row in rows:
        pairs = itertools.zip_longest(row, formulas.get(number, []), fillvalue="")
        cells = [formula if _is_empty(cell) else cell for cell, formula in pairs]
        filled_rows.append((number, cells))
    return filled_rows


def is_remark(text: str) -> bool:
    """Test if a line or a row begins with "#" and is not an error of Excel, such as "#DIV/0!"."""
    return bool(_REMARK.match(text))


def office_file(content: bytes) -> str:
    """Return what a file of another extension or an older Excel is, and the next step; "" if not.

    Args:
        content: first bytes of the file, eight or more.
    """
    if content.startswith(b"\xd0\xcf\x11\xe0"):
        return "an old Excel file (.xls), or one with a password; save it as .xlsx without one"
    is_zip = content.startswith(b"PK\x03\x04")
    return "an Excel or zip file; an Excel file needs the ending .xlsx" if is_zip else ""


def column_name(index: int) -> str:
    """Return the name of a column without a header, such as "column XFD", from its index."""
    from openpyxl.utils import get_column_letter

    return f"column {get_column_letter(index + 1)}"


def size_error(path: Path, size: str) -> DataError:
    """Return the error of a file that is too large; `size` says how large."""
    valid = f"valid: {MAX_UNPACKED_BYTES // 2**20} MiB and {MAX_CELLS:,} cells"
    return DataError(f"{path}: too large an Excel file: {size} ({valid}; or save the table as CSV)")


def _parsed(path: Path, sheet: str | None, *, values: bool) -> dict[str, list[Row]]:
    """Return the rows of each sheet, or of one; with formulas in place of their `values`."""
    require(f"{path}: Excel", "openpyxl")
    from openpyxl import load_workbook

    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of parts that are not read
        try:
            _check_size(path, file)
            book = load_workbook(file, read_only=True, data_only=values, keep_links=False)
            return {
                worksheet.title: [*_rows(path, worksheet)]
                if sheet == worksheet.title
                or (sheet is None and worksheet.sheet_state == "visible")
                else []
                for worksheet in book.worksheets
            }
        except DataError:
            raise
        except Exception as error:  # for a corrupt file openpyxl raises errors of its parsers
            file.seek(0)
            start = file.read(8)
            kind = "" if is_zipfile(file) else office_file(start)
            kind = kind or "not an Excel file (.xlsx), or a corrupt one"
            raise DataError(f"{path}: {kind}") from error


def _check_size(path: Path, file: BinaryIO) -> None:
    """Check the unpacked bytes and the number of XML tags, which take the time and the memory."""
    with ZipFile(file) as archive:
        parts = archive.infolist()
        n_bytes = sum(part.file_size for part in parts)
        if n_bytes > MAX_UNPACKED_BYTES:
            raise size_error(path, f"{n_bytes / 2**20:,.0f} MiB unpacked")
        texts = {part.filename: archive.read(part) for part in parts}
    n_tags = {name: text.count(b"<") for name, text in texts.items()}
    if sum(n_tags.values()) > MAX_CELLS * _TAGS_PER_CELL:
        raise size_error(path, f"more than {MAX_CELLS:,} cells")
    if n_tags.get("xl/styles.xml", 0) > _MAX_STYLE_TAGS:
        raise size_error(path, f"more than {_MAX_STYLE_TAGS:,} entries of its formats")
    for name, text in texts.items():
        if name.endswith(".xml") and any(len(tag[0]) > _LONGEST_TAG for tag in _TAG.finditer(text)):
            raise size_error(path, f"a tag of more than {_LONGEST_TAG:,} characters in {name}")
    file.seek(0)


def _check_places(path: Path, worksheet: Any) -> None:
    """Check that each row and each cell follows the one before; openpyxl drops others."""
    from openpyxl.utils.cell import coordinate_to_tuple
    from openpyxl.worksheet._reader import ROW_TAG
    from openpyxl.xml.functions import iterparse

    def error(place: str, fault: str) -> DataError:
        return DataError(
            f"{path}: sheet {worksheet.title!r}, {place}: {fault} (valid: each row and each cell "
            "once, in order; save the file again in Excel)"
        )

    last_row = 0
    with worksheet._get_source() as source:
        for _, element in iterparse(source):
            if element.tag != ROW_TAG:
                continue
            number, last_column = int(float(element.get("r", last_row + 1))), 0
            if number <= last_row or number < 1:
                fault = "stands twice" if number == last_row else f"stands behind row {last_row}"
                raise error(f"row {number}", fault)
            for cell in element:
                name = cell.get("r", "")
                row, column = coordinate_to_tuple(name) if name else (number, last_column + 1)
                if row != number:
                    raise error(f"row {number}", f"holds the cell {name}")
                if column <= last_column:
                    fault = "stands twice" if column == last_column else "stands behind a later one"
                    raise error(f"row {number}", f"its cell {name} {fault}")
                last_column = column
            last_row = number
            element.clear()


def _rows(path: Path, worksheet: Any) -> Iterator[Row]:
    """Yield the rows of a sheet that are not blank."""
    _check_places(path, worksheet)
    n_cells = 0
    worksheet.reset_dimensions()  # the file may state others than it has
    for number, cells in enumerate(worksheet.rows, start=1):
        n_cells += len(cells)
        if number > _LAST_ROW:
            raise size_error(path, f"row {number:,} of the sheet {worksheet.title!r}")
        if n_cells > MAX_CELLS:
            size = f"more than {MAX_CELLS:,} cells in {number:,} rows of {worksheet.title!r}"
            raise size_error(path, size)
        row = [*map(_value, cells)]
        while row and _is_empty(row[-1]):
            row.pop()
        if row:
            yield number, row


def _value(cell: Any) -> Any:
    """Return the value of a cell; "" for an empty one."""
    value = cell.value
    if value is None:
        return _EmptyText() if cell.data_type == "str" else ""
    if isinstance(value, str):
        return value.strip()
    if isinstance(value, float) and value.is_integer() and abs(value) < _LARGEST_NAME:
        return int(value)  # a name such as 7
    text = getattr(value, "text", None)  # of an array formula
    return text if isinstance(text, str) else value


def _is_empty(cell: object) -> bool:
    """Test if a cell is empty, and not the computed value of a formula."""
    return type(cell) is str and not cell
