"""A cell as rows of the database: its columns and values, and the checksum over both."""

from __future__ import annotations

import sqlite3
from array import array
from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
import orjson

from stiff_bench.store.codec import (
    COLUMNS,
    REALS,
    cell_content,
    cell_result,
    checksum,
)
from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.record import CellResult, Measures, StoredRecords
from stiff_protocols.contract.types import FloatArray

COLUMN_TYPES = dict.fromkeys(COLUMNS, "TEXT") | {
    **dict.fromkeys(("split_index", "seed", "scoring_version", "n_splits", "n_train"), "INTEGER"),
    **dict.fromkeys(("calibration_samples", "memory_bytes"), "INTEGER"),
    **dict.fromkeys(REALS, "REAL"),
    **dict.fromkeys(("prediction", "curves"), "BLOB"),
}
"""As SQLite has them; it does not enforce them."""
_TYPES = {"TEXT": str, "INTEGER": int, "REAL": float, "BLOB": bytes}
_OPTIONAL = {*REALS, "memory_bytes", "prediction_arrays", "prediction", "curves"}
_N_BLOBS = 2
_NAMES = f"sha256, {', '.join(COLUMNS)}"
SELECT_CELLS = f"SELECT id, {_NAMES} FROM cell"


def marks(entries: Sequence[object]) -> str:
    """Return "(?, ?)": a place in a statement for each entry."""
    return f"({', '.join('?' * len(entries))})"


def fetched(
    db: sqlite3.Connection, query: str, values: Sequence[object] = ()
) -> list[tuple[Any, ...]]:
    """Return all rows; bytes that are no text are left to the rows' checksums to find."""
    try:
        return db.execute(query, values).fetchall()
    except sqlite3.OperationalError as error:
        if "decode" not in str(error):
            raise
    db.text_factory = partial(str, encoding="utf-8", errors="surrogateescape")
    return db.execute(query, values).fetchall()


def checked_row(
    row: Sequence[Any], values: Mapping[int, tuple[_Measures, FloatArray]]
) -> CellResult:
    """Return the result in a row: its number, its checksum and its columns.

    Raises:
        DataError: it is not what was stored.
    """
    number, sha256, *columns = row
    _check_types(tuple(map(type, columns)))
    measures, numbers = values.get(number, _NO_VALUES)
    try:
        plain, blobs = columns[:-_N_BLOBS], columns[-_N_BLOBS:]
        if checksum(plain, measures.text, numbers[measures.order], blobs) != sha256:
            raise DataError("its checksum does not match its content")
    except TypeError as error:  # bytes in the place of a text
        raise DataError(str(error)) from error
    content = dict(zip(COLUMNS, columns, strict=True))
    content["metrics"] = StoredRecords(measures, numbers)
    return cell_result(content)


@cache  # most rows are alike
def _check_types(types: tuple[type, ...]) -> None:
    """Raise a DataError where a row has not the types of its columns."""
    for name, found in zip(COLUMNS, types, strict=True):
        known = _TYPES[COLUMN_TYPES[name]]
        if found is not known and not (found is type(None) and name in _OPTIONAL):
            raise DataError(f"{name} holds {found.__name__}, expected {known.__name__}")


class _Measures(Measures):
    """With what a checksum needs of them."""

    def __init__(self, names: Sequence[tuple[str, str, str]]) -> None:
        """Put them in order: by name, since another file has other numbers for them."""
        super().__init__(names)
        self.order = np.array(sorted(range(len(names)), key=names.__getitem__), dtype=np.int64)
        self.text = orjson.dumps(sorted(names))


_NO_VALUES = (_Measures(()), np.empty(0))


class _Packed:
    """Numbers of a group of rows as bytes: an aggregate of SQLite's."""

    def __init__(self) -> None:
        """Begin with none."""
        numbers = array("d")
        self.step, self.finalize = numbers.append, numbers.tobytes


class StoredValues:
    """Reads values; cells that have values of the same measures share what is known of these."""

    def __init__(self) -> None:
        """Know nothing."""
        self._names: dict[int, tuple[str, str, str]] = {}
        self._measures: dict[str, _Measures] = {}

    def values(
        self, db: sqlite3.Connection, cells: Sequence[int]
    ) -> dict[int, tuple[_Measures, FloatArray]]:
        """Return number of a cell -> its measures and its values, in the order of the measures."""
        if not cells:
            return {}
        whole = cells[-1] - cells[0] == len(cells) - 1  # a range is found sooner than single ones
        where = f"cell {'BETWEEN ? AND ?' if whole else f'IN {marks(cells)}'}"
        db.create_aggregate("packed", 1, _Packed)  # type: ignore[arg-type]  # of bytes, too
        number = "ifnull(CAST(value AS REAL), 0)"  # what was none fails the checksum
        query = f"SELECT cell, group_concat(measure), packed({number}) FROM value WHERE {where}"
        asked = (cells[0], cells[-1]) if whole else cells
        return {  # SQLite walks the table in the order of its key
            cell: (self._of(db, measures), np.frombuffer(numbers))
            for cell, measures, numbers in db.execute(f"{query} GROUP BY cell", asked)
        }

    def _of(self, db: sqlite3.Connection, measures: str) -> _Measures:
        """Return the measures with these numbers, "1,2,5"."""
        if measures not in self._measures:
            numbers = [int(number) for number in measures.split(",")]
            if not self._names.keys() >= {*numbers}:
                self._names = {row[0]: row[1:] for row in db.execute("SELECT * FROM measure")}
            self._measures[measures] = _Measures([self._names[number] for number in numbers])
        return self._measures[measures]


def write_row(db: sqlite3.Connection, result: CellResult) -> None:
    """Put a cell into the file in the place of an older state of it."""
    content = cell_content(result)
    there = db.execute("SELECT id, status FROM cell WHERE key = ?", (content["key"],)).fetchone()
    if there is not None:
        if there[1] == "ok" and result.status != "ok":
            return
        db.execute("DELETE FROM cell WHERE id = ?", (there[0],))
    named = [(metric, axis, unit) for metric, axis, _, unit in content["metrics"]]
    measures = _Measures(named)
    values = np.array([metric[2] for metric in content["metrics"]], dtype=np.float64)
    columns = [content[name] for name in COLUMNS]
    plain, blobs = columns[:-_N_BLOBS], columns[-_N_BLOBS:]
    sha256 = checksum(plain, measures.text, values[measures.order], blobs)
    row = (sha256, *columns)
    insert = f"INSERT INTO cell ({_NAMES}) VALUES {marks(row)}"
    number = db.execute(insert, row).lastrowid
    known = {row[1:]: row[0] for row in db.execute("SELECT * FROM measure")}
    for measure in named:
        if measure not in known:
            insert = f"INSERT INTO measure (metric, axis, unit) VALUES {marks(measure)}"
            known[measure] = db.execute(insert, measure).lastrowid
    rows = [(number, known[m], value) for m, value in zip(named, values.tolist(), strict=True)]
    db.executemany("INSERT INTO value VALUES (?, ?, ?)", rows)
