"""A cell's result as plain content, which a cell's process sends, and as rows of the database.

Numbers are in SI units at full precision. Texts hold what is for people or has no fixed shape, as
strict JSON; arrays are float64 in little-endian order, compressed with zlib.
"""

from __future__ import annotations

import hashlib
import json
import math
import sqlite3
import zlib
from array import array
from collections.abc import Sequence
from dataclasses import fields
from functools import cache, lru_cache, partial
from operator import itemgetter
from typing import Any, TypeVar

import numpy as np
import orjson

from stiff_protocols.contract.errors import DataError
from stiff_protocols.contract.record import (
    Cell,
    CellResult,
    Cost,
    Measures,
    Presentation,
    StoredRecords,
)
from stiff_protocols.contract.types import KNOWN, FloatArray, Interval, Prediction

_T = TypeVar("_T")
Content = dict[str, Any]
"""Name of a column -> str, int, float, bytes or None; "metrics" -> the records."""

_NAMES = ("model", "dataset", "protocol")
_PARAMS = tuple(f"{name}_params" for name in _NAMES)
_SAME = (
    *(*_PARAMS, "condition", "split_index", "seed", "coverage", "data_sha256", "split_sha256"),
    *("rows_sha256", "source_sha256", "model_version", "scoring_version"),
)
_OF_CELL = {f"{name}_key": name for name in _NAMES} | {name: name for name in _SAME}
"""Column -> field of `Cell`; the columns of `_NAMES` are names with options."""
_SHOWN = tuple(item.name for item in fields(Presentation) if item.name not in _NAMES)
_COST = Cost._fields
_PLAIN = ("run_id", "status", "n_splits", "n_train", "calibration_samples", "cause", "failure")
_ABOUT = ("warnings", "log", "chosen", "n_labels", "n_poses")
COLUMNS = (
    *("key", *_NAMES, *_OF_CELL, *_PLAIN, *_COST),
    *("shown", "about", "prediction_arrays", "prediction", "curves"),
)
"""In the order of the table, beside the checksum."""
_REALS = ("coverage", "fit_s", "predict_s", "latency_s", "throughput_per_s")
COLUMN_TYPES = dict.fromkeys(COLUMNS, "TEXT") | {
    **dict.fromkeys(("split_index", "seed", "scoring_version", "n_splits", "n_train"), "INTEGER"),
    **dict.fromkeys(("calibration_samples", "memory_bytes"), "INTEGER"),
    **dict.fromkeys(_REALS, "REAL"),
    **dict.fromkeys(("prediction", "curves"), "BLOB"),
}
"""As SQLite has them; it does not enforce them."""
_TYPES = {"TEXT": str, "INTEGER": int, "REAL": float, "BLOB": bytes}
_OPTIONAL = {*_REALS, "memory_bytes", "prediction_arrays", "prediction", "curves"}
_N_BLOBS = 2
_SELECT = f"""SELECT sha256, {", ".join(COLUMNS)},
    (SELECT group_concat(measure) FROM value WHERE cell = id),
    (SELECT packed(ifnull(CAST(value AS REAL), 0)) FROM value WHERE cell = id), id FROM cell"""
"""Values as text and bytes; a value that is none becomes 0, which fails the checksum."""
_INTEGER, _FLOAT = np.dtype("<i8"), np.dtype("<f8")
_ARRAYS = ("predicted", "measured", "reference", "lower", "upper", *KNOWN)

_FAULTS = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, zlib.error)
"""What content that is none of ours can raise."""


def cell_content(result: CellResult) -> Content:
    """Return what is stored of a result."""
    cell, shown = result.cell, result.shown
    content: Content = {"key": cell.key}
    content |= {name: getattr(shown, name) for name in _NAMES}
    content |= {column: getattr(cell, name) for column, name in _OF_CELL.items()}
    content |= {name: json_text(content[name]) for name in _PARAMS}
    content |= {name: getattr(result, name) for name in _PLAIN}
    content |= {name: getattr(result.cost, name, None) for name in _COST}
    content["shown"] = json_text({name: getattr(shown, name) for name in _SHOWN})
    # JSON has no infinity (a rigid joint) and no NaN (one that cannot be identified)
    diagnostics = {k: v if math.isfinite(v) else str(v) for k, v in result.diagnostics.items()}
    about = {name: getattr(result, name) for name in _ABOUT}
    content["about"] = json_text({"diagnostics": diagnostics, **about})
    content["prediction_arrays"], content["prediction"] = _packed(result.prediction)
    curves = {name: curve.tolist() for name, curve in result.curves.items()}
    content["curves"] = zlib.compress(orjson.dumps(curves)) if curves else None
    content["metrics"] = tuple(result.records)
    for name, value in content.items():
        if type(value) is str:
            content[name] = storable(value)
        elif name in _REALS and value is not None:
            content[name] = float(value)  # as it comes back
    return content


def cell_result(content: Content) -> CellResult:
    """Return the result whose content this is; its key is not worked out again.

    Raises:
        DataError: it is no result's content.
    """
    try:
        return _result(content)
    except _FAULTS as error:
        raise DataError(f"{type(error).__name__}: {error}") from error


_shown_of, _cost_of = itemgetter(*_NAMES, "shown"), itemgetter(*_COST)


def _result(content: Content) -> CellResult:
    cell = {name: content[column] for column, name in _OF_CELL.items()}
    for name in _PARAMS:
        cell[name] = _parsed(cell[name])
    cell["key"] = content["key"]
    values = {name: content[name] for name in _PLAIN}
    values |= _about(content["about"])
    values["cell"] = _made(Cell, cell)
    values["shown"] = _presentation(*_shown_of(content))
    values["records"] = content["metrics"]
    values["prediction"] = _prediction(content)
    values["cost"] = None if content["fit_s"] is None else Cost(*_cost_of(content))
    values["curves"] = _curves(content["curves"])
    return _made(CellResult, values)


def _made(cls: type[_T], values: dict[str, Any]) -> _T:
    """Return a frozen dataclass with all of its fields: calling it takes three times as long."""
    made = object.__new__(cls)
    object.__setattr__(made, "__dict__", values)
    return made


@lru_cache(maxsize=4096)
def _about(text: str) -> dict[str, Any]:
    about = orjson.loads(text)
    return {
        "diagnostics": {name: float(value) for name, value in about["diagnostics"].items()},
        "warnings": tuple(about["warnings"]),
        "log": tuple(about["log"]),
        "chosen": about["chosen"],
        # older results may lack them
        "n_labels": about.get("n_labels", 0),
        "n_poses": about.get("n_poses", 0),
    }


def _curves(blob: bytes | None) -> dict[str, FloatArray]:
    if blob is None:
        return {}
    return {
        name: np.array(points, dtype=np.float64).reshape(-1, 3)
        for name, points in orjson.loads(_unpacked(blob)).items()
    }


_parsed = lru_cache(maxsize=4096)(orjson.loads)
"""What a JSON text says, which many cells share."""


@lru_cache(maxsize=4096)
def _presentation(model: str, dataset: str, protocol: str, rest: str) -> Presentation:
    stored = orjson.loads(rest)
    shown = {name: stored[name] for name in _SHOWN if name in stored}
    return Presentation(model, dataset, protocol, **{**shown, "caveats": tuple(shown["caveats"])})


def _packed(prediction: Prediction | None) -> tuple[str | None, bytes | None]:
    """Return the names of the arrays that a prediction has, and all of them one behind the other.

    First the row numbers (n,), int64, then (n, 3) m each.
    """
    if prediction is None:
        return None, None
    interval = prediction.interval  # its coverage is the cell's
    arrays = {
        "predicted": prediction.predicted,
        "measured": prediction.measured,
        "reference": prediction.reference,
        "lower": None if interval is None else interval.lower,
        "upper": None if interval is None else interval.upper,
        **prediction.known,
    }
    there = {name: array for name, array in arrays.items() if array is not None}
    content = [np.asarray(prediction.rows, "<i8").tobytes()]
    content += [np.ascontiguousarray(array, "<f8").tobytes() for array in there.values()]
    return " ".join(there), _compressed(b"".join(content))


def _compressed(content: bytes) -> bytes:
    """Return what zlib makes of content; what it hardly shortens is read sooner as it is."""
    found = zlib.compress(content)
    return found if len(found) < 0.8 * len(content) else zlib.compress(content, level=0)


@lru_cache(maxsize=16)
def _array_names(text: str) -> list[str]:
    names = text.split(" ")
    if not {"predicted", "measured"} <= {*names} <= {*_ARRAYS}:
        raise ValueError(f"prediction_arrays {text!r}")
    return names


def _prediction(content: Content) -> Prediction | None:
    if content["prediction"] is None:
        return None
    names, coverage = _array_names(content["prediction_arrays"]), content["coverage"]
    raw = _unpacked(content["prediction"])
    n, more = divmod(len(raw), 8 + 24 * len(names))
    if more:
        raise ValueError(f"{len(raw)} bytes are no rows of {' '.join(names)!r}")
    numbers = np.ndarray((len(names), n, 3), _FLOAT, raw, 8 * n)
    arrays: dict[str, FloatArray] = dict(zip(names, numbers, strict=True))
    interval = None
    if "lower" in arrays:
        lower, upper = arrays.pop("lower"), arrays.pop("upper")
        interval = None if coverage is None else Interval(lower, upper, coverage)
    return Prediction.of_stored(
        rows=np.ndarray((n,), _INTEGER, raw),
        predicted=arrays.pop("predicted"),
        measured=arrays.pop("measured"),
        interval=interval,
        reference=arrays.pop("reference", None),
        known=arrays,
    )


LARGEST_BYTES = 2**31
"""What a blob may unpack to; few bytes can stand for many."""


def _unpacked(blob: bytes) -> bytes:
    if len(blob) < LARGEST_BYTES // 2048:  # zlib shortens to a thousandth at the most
        return zlib.decompress(blob)
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(blob, LARGEST_BYTES)
    if unpacker.unconsumed_tail or not unpacker.eof:
        raise ValueError("its compressed content is cut, or unpacks to more than 2 GiB")
    return content


def checksum(columns: Sequence[Any], names: bytes, values: FloatArray) -> str:
    """Return the SHA-256 of a cell's columns, names of its values as JSON, and (n,) values.

    Raises:
        TypeError: there are bytes in the place of a text.
    """
    plain, blobs = columns[:-_N_BLOBS], columns[-_N_BLOBS:]
    parts = [orjson.dumps(plain), names, values.tobytes(), *(blob or b"" for blob in blobs)]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()


def json_text(content: Any) -> str:
    """Return strict JSON that is `storable`."""
    return storable(json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")))


def storable(text: str) -> str:
    """Return a text with a question mark for what is no character, as a file's name may hold."""
    return text if text.isascii() else text.encode(errors="replace").decode()


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


@cache  # most rows are alike
def _check_types(*types: type) -> None:
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


_NO_NAME = ("", "", "")  # of a measure that the file has lost


class _Packed:
    """Numbers of a group of rows as bytes: an aggregate of SQLite's."""

    def __init__(self) -> None:
        """Begin with none."""
        numbers = array("d")
        self.step, self.finalize = numbers.append, numbers.tobytes


class CellReader:
    """Reads the cells of one file; those that have values of the same measures share these."""

    def __init__(self) -> None:
        """Know no measure yet."""
        self._measures: dict[str | None, _Measures] = {None: _Measures(())}

    def rows(
        self, db: sqlite3.Connection, where: str, values: Sequence[object]
    ) -> list[tuple[Any, ...]]:
        """Return the rows of some cells, for `result`; a row's last entry is its number."""
        db.create_aggregate("packed", 1, _Packed)  # type: ignore[arg-type]  # of bytes, too
        rows = fetched(db, f"{_SELECT} {where}", values)
        for text in {row[-3] for row in rows} - self._measures.keys():
            names = {str(row[0]): row[1:] for row in db.execute("SELECT * FROM measure")}
            self._measures[text] = _Measures([names.get(n, _NO_NAME) for n in text.split(",")])
        return rows

    def result(self, row: Sequence[Any]) -> CellResult:
        """Return the result in a row.

        Raises:
            DataError: it is not what was stored.
        """
        sha256, *columns, text, packed, _ = row
        _check_types(*map(type, columns))
        measures, numbers = self._measures[text], np.frombuffer(packed or b"")
        try:
            if checksum(columns, measures.text, numbers[measures.order]) != sha256:
                raise DataError("its checksum does not match its content")
        except (TypeError, IndexError) as error:  # bytes for a text, a text for a measure
            raise DataError(str(error)) from error
        content = dict(zip(COLUMNS, columns, strict=True))
        content["metrics"] = StoredRecords(measures, numbers)
        return cell_result(content)


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
    row = (checksum(columns, measures.text, values[measures.order]), *columns)
    insert = f"INSERT INTO cell (sha256, {', '.join(COLUMNS)}) VALUES {marks(row)}"
    number = db.execute(insert, row).lastrowid
    known = {row[1:]: row[0] for row in db.execute("SELECT * FROM measure")}
    for measure in named:
        if measure not in known:
            insert = f"INSERT INTO measure (metric, axis, unit) VALUES {marks(measure)}"
            known[measure] = db.execute(insert, measure).lastrowid
    rows = [(number, known[m], value) for m, value in zip(named, values.tolist(), strict=True)]
    db.executemany("INSERT INTO value VALUES (?, ?, ?)", rows)
