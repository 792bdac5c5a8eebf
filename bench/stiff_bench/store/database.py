"""A folder's results: one SQLite file, `results.sqlite`, that any SQLite browser reads.

::

    run      a row per run: command, environment, the keys of the requested fits (JSON)
    data     a row a data set: its samples and robot as one blob
    cell     a row a cell: what it is, which run computed it, its status and cost; predictions and
             training curves as one blob of little-endian float64, with names and shapes in `arrays`

Numbers are in SI units at full precision. What has no fixed shape is strict JSON. Each write is one
transaction; of a fit there is one row. A failure does not replace a result: a fit has one key for
all that shapes its numbers, so a rerun that timed out takes nothing away. Each row of a fit has
the SHA-256 of its content, checked when it is read.

A third-party file holds these three tables and nothing that SQLite would execute.
Types, shapes and sizes of its rows are checked when they are read.
"""

from __future__ import annotations

import hashlib
import io
import json
import lzma
import math
import os
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Annotated, Any, get_type_hints
from zipfile import ZipFile

import numpy as np
import orjson
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, create_model

from stiff_bench.store.samples import StoredData
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.files import make_folder, written_whole
from stiff_protocols.contract.record import Cost, Fit, FitResult, Presentation, RunManifest
from stiff_protocols.contract.types import (
    BOUND_NAMES,
    TRUTHS,
    BenchmarkData,
    ChainJoint,
    FloatArray,
    Interval,
    Prediction,
    Robot,
    Samples,
)

FILE = "results.sqlite"
RUNS = "runs"
"""Folder of the results inside the folder of a study."""
PACKED = f"{FILE}.xz"
"""The same file as a repository keeps it, a quarter of the size: the first reader unpacks it."""
FORMAT = 5
"""Of the file, as `PRAGMA user_version` has it."""
BUSY_S = 60.0
"""Time that a command waits for another command that writes."""
SYNCHRONOUS = "FULL"
"""SQLite's word for: a transaction is on the disk before the next one begins."""

_NAMES = ("model", "dataset", "protocol")
"""In the file these are names with options; the columns `model_key` ... have only keys."""
_OF_FIT = tuple(item.name for item in fields(Fit) if item.name not in _NAMES)
_OF_RESULT = ("run_id", "status", "n_splits", "n_train", "calibration_samples", "cause", "failure")
_PRESENTATION_FIELDS = tuple(item.name for item in fields(Presentation) if item.name not in _NAMES)
_ABOUT = ("diagnostics", "warnings", "log", "chosen", "n_labels", "n_poses")
_JSON = (*(f"{name}_params" for name in _NAMES), "shown", "about", "arrays")
_KEYS = tuple(f"{name}_key" for name in _NAMES)
_COLUMNS = ("key", *_NAMES, *_KEYS, *_OF_FIT, *_OF_RESULT, *Cost._fields, *_JSON[-3:], "numbers")

_INTEGERS = ("split_index", "seed", "interval_version", "n_splits", "n_train")
_REALS = ("coverage", "fit_s", "predict_s", "latency_s", "throughput_per_s")
_COLUMN_TYPES = dict.fromkeys(_COLUMNS, "TEXT") | {
    **dict.fromkeys((*_INTEGERS, "calibration_samples", "memory_bytes"), "INTEGER"),
    **dict.fromkeys(_REALS, "REAL"),
    "numbers": "BLOB",
}
"""Column of a fit -> SQLite's type, in the order of the table; its checksum follows."""

_LEAST_UNPACKED, _MOST_PACKED = 2**28, 50
"""Bytes that a packed file of any size may unpack to, and the largest factor of a larger one."""
_SPARE = 2**26
"""Bytes of a row or a query beyond the size of the file."""
_SUPER_JOURNAL = bytes.fromhex("d9d505f920a163d7")
"""End of a journal that names a file for SQLite to delete; a transaction of ours never has one."""

_CURVE = "curve "
"""How the names of the arrays of training curves begin."""
_FLOAT = np.dtype("<f8")

_RUN = tuple(item.name for item in fields(RunManifest))
_RUN_JSON = ("environment", "cells", "machines")
_SCHEMA = f"""
CREATE TABLE run (run_id TEXT PRIMARY KEY, command TEXT, started TEXT, status TEXT,
    environment TEXT, cells TEXT, wall_s REAL, peak_memory_bytes INTEGER, machines TEXT);
CREATE TABLE data (sha256 TEXT PRIMARY KEY, content BLOB, content_sha256 TEXT);
CREATE TABLE cell ({", ".join(f"{name} {kind}" for name, kind in _COLUMN_TYPES.items())},
    sha256 TEXT, PRIMARY KEY (key));
PRAGMA user_version = {FORMAT};
"""


def _corrupt(path: Path, reason: str, remedy: str = "") -> StoreError:
    """Return the error for a corrupt file or row."""
    remedy = remedy or "delete the file and repeat the `bench run` that made it"
    return StoreError(f"{path}: corrupt: {reason}; {remedy}")


_Count = Annotated[int, Field(ge=0)]
_Amount = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
_Option = str | int | float | bool | None
_STORED_TYPES: dict[Any, Any] = {int: _Count, Any: _Option}
"""Type of a field -> type in the file, where that is narrower."""


def _stored_record(owner: type, names: Iterable[str]) -> type[BaseModel]:
    """Return what the file holds of these fields of a record; each may be left out."""
    hints = get_type_hints(owner)
    given: dict[str, Any] = {
        name: (_STORED_TYPES.get(hints[name], hints[name]), None) for name in names
    }
    return create_model("Stored", __config__=ConfigDict(extra="forbid"), **given)


def _stored_columns() -> dict[str, Any]:
    """Return the type of each column of a fit after its JSON is read."""
    columns: dict[str, Any] = dict.fromkeys(("key", *_NAMES, *_KEYS), str)
    for owner, names in ((Fit, _OF_FIT), (FitResult, _OF_RESULT)):
        hints = get_type_hints(owner)
        columns |= {name: _STORED_TYPES.get(hints[name], hints[name]) for name in names}
    columns |= dict.fromkeys(Cost._fields, _Amount | None) | {"memory_bytes": _Count | None}
    columns |= dict.fromkeys([name for name in _JSON if name not in _ABOUT], dict[str, _Option])
    return columns | {
        "coverage": Annotated[float, Field(gt=0.0, lt=1.0)] | None,
        "shown": _stored_record(Presentation, _PRESENTATION_FIELDS),
        "about": _stored_record(FitResult, _ABOUT),
        "arrays": dict[str, list[_Count]],
        "numbers": bytes,
    }


_FIT_FIELDS: dict[str, Any] = {name: (kind, ...) for name, kind in _stored_columns().items()}
_STORED_FIT = create_model("StoredFit", **_FIT_FIELDS)
_STORED_RUN = TypeAdapter(RunManifest)


class ResultStore:
    """A folder of results that is written to.

    Args:
        folder: made if it does not exist.

    Raises:
        StoreError: it cannot be written, or holds results of another format.
    """

    def __init__(self, folder: Path) -> None:
        """Make the folder and its file, and see that it can be written."""
        self.folder = folder
        try:
            make_folder(folder)
            with writing(folder):
                pass
        except StoreError as error:
            raise StoreError(f"{error}", "output") from error

    def write_fits(self, results: Iterable[FitResult]) -> None:
        """Store results and failures as one transaction; a failure takes nothing from a result.

        Raises:
            StoreError: they cannot be written, as on a full disk; stored results are unchanged.
        """
        with writing(self.folder) as db:
            for result in results:
                write_row(db, result)

    def write_manifest(self, manifest: RunManifest) -> None:
        """Store a run's manifest, replacing an older state of it."""
        with writing(self.folder) as db:
            write_run(db, manifest)

    def write_data(self, data: BenchmarkData) -> None:
        """Store the samples that results belong to, once."""
        with reading(self.folder) as db:
            if db.execute("SELECT 1 FROM data WHERE sha256 = ?", (data.sha256,)).fetchone():
                return
        content = data_content(data)
        row = (data.sha256, content, hashlib.sha256(content).hexdigest())
        with writing(self.folder) as db:
            db.execute("INSERT OR IGNORE INTO data VALUES (?, ?, ?)", row)

    def result(self, key: str) -> FitResult | None:
        """Return a fit's result; None if nothing or only a failure is stored."""
        results = read_results(self.folder, [key])
        return next((result for result in results if result.status == "ok"), None)


def has_results(folder: Path) -> bool:
    """Check for a file of results; a packed file is unpacked into the same folder.

    Raises:
        StoreError: the packed file is corrupt or unpacks to too much, or the folder cannot be
            written.
    """
    path, packed = folder / FILE, folder / PACKED
    if path.exists() or not packed.exists():
        return path.exists()
    if not packed.is_file():  # a pipe would be waited for
        raise _corrupt(packed, "not a file")
    with sqlite_errors_as_store_error(path, "written"), written_whole(path) as temporary:
        try:
            with lzma.open(packed) as content, temporary.open("wb") as file:
                most = _most_unpacked(packed.stat().st_size)
                while chunk := content.read(2**20):
                    if file.tell() + len(chunk) > most:
                        raise _corrupt(packed, f"unpacks to more than {most} bytes")
                    file.write(chunk)
        except (lzma.LZMAError, EOFError, MemoryError) as error:
            raise _corrupt(packed, str(error)) from error
    return True


def _most_unpacked(size: int) -> int:
    """Return the most bytes that packed content of this size may unpack to."""
    return max(_LEAST_UNPACKED, _MOST_PACKED * size)


def why_no_results(folder: Path) -> str:
    """Return the reason why a folder has no results to read."""
    if (folder / RUNS).is_dir():
        return f"no results in this folder of a study; give {folder / RUNS}"
    if folder.is_dir():
        return "no results in this folder"
    return "is a file, not a folder of results" if folder.exists() else "no such folder"


def read_results(folder: Path, keys: Collection[str] | None = None) -> list[FitResult]:
    """Return the fits of a folder, failed and skipped ones too, in the order of their keys.

    Args:
        folder: of the results; it may be one that cannot be written.
        keys: of the fits; None: all. Those that are not stored are left out.

    Raises:
        StoreError: the file is corrupt, of another format, or cannot be read.
    """
    where = "" if keys is None else "WHERE key IN (SELECT value FROM json_each(?))"
    values = [] if keys is None else [orjson.dumps([*keys]).decode()]
    rows = stored_rows(folder, f"SELECT * FROM cell {where} ORDER BY key", values)
    results = []
    for row in rows:
        try:
            results.append(_read_row(row))
        except DataError as error:
            remedy = _rerun(folder, row[0])
            raise _corrupt(folder / FILE, f"fit {_short_name(row[0])}: {error}", remedy) from error
    return results


def stored_rows(folder: Path, query: str, values: Sequence[str] = ()) -> list[tuple[Any, ...]]:
    """Return the rows of a query of a folder's file.

    Raises:
        StoreError: the file is corrupt, of another format, or cannot be read.
    """
    rows, size = [], 0
    with reading(folder) as db:
        most = db.getlimit(sqlite3.SQLITE_LIMIT_LENGTH)
        for row in db.execute(query, values):
            size += sum(len(value) for value in row if isinstance(value, str | bytes))
            if size > most:  # rows of a crafted file share their pages
                raise _corrupt(folder / FILE, "its rows are larger than the file")
            rows.append(row)
    return rows


def _short_name(name: object) -> str:
    """Return the first characters of a row's name."""
    return f"{name}"[:40]


def _rerun(folder: Path, key: str) -> str:
    """Return the command that computes a fit again, whatever is stored of it; "": not known."""
    commands = [run.command for run in read_manifests(folder) if key in run.cells]
    return f"repeat this run with --rerun all: {commands[-1]}" if commands else ""


def stored_statuses(folder: Path) -> dict[str, str]:
    """Return which fits are stored: key -> "ok", "failed" or "skipped"."""
    with reading(folder) as db:
        return dict(db.execute("SELECT key, status FROM cell").fetchall())


def mean_seconds(folder: Path) -> dict[str, float]:
    """Return model, with its options -> mean wall time of a stored fit and its predictions, s."""
    query = "SELECT model, avg(fit_s + predict_s) FROM cell WHERE status = 'ok' GROUP BY model"
    with reading(folder) as db:
        return {model: seconds for model, seconds in db.execute(query) if seconds is not None}


def read_manifests(folder: Path) -> list[RunManifest]:
    """Return every run's manifest of a folder, in the order of their names."""
    rows = stored_rows(folder, f"SELECT {', '.join(_RUN)} FROM run ORDER BY run_id")
    manifests = []
    for row in rows:
        run = dict(zip(_RUN, row, strict=True))
        try:
            run |= {name: orjson.loads(run[name]) for name in _RUN_JSON}
            manifests.append(_STORED_RUN.validate_python(run))
        except (ValueError, TypeError) as error:
            raise _corrupt(folder / FILE, f"run {_short_name(row[0])}: {_reason(error)}") from error
    return manifests


def _reason(error: Exception) -> str:
    """Return which value of a row is wrong, in one line."""
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        return f"{_short_name('.'.join(map(str, first['loc'])))}: {first['msg']}"
    return str(error)


def read_data(folder: Path, sha256: str) -> StoredData:
    """Read the data set with this hash that results of a folder belong to.

    Raises:
        StoreError: there is none, it is corrupt, or a fit has rows that it does not have.
    """
    query = "SELECT content, content_sha256 FROM data WHERE sha256 = ?"
    with reading(folder) as db:
        row = db.execute(query, (sha256,)).fetchone()
    if row is None:
        raise StoreError(f"{folder / FILE}: holds no data set {sha256!r}")
    try:
        if hashlib.sha256(row[0]).hexdigest() != row[1]:
            raise DataError("its checksum does not match its content")
        data = stored_data(row[0])
        query = "SELECT key, arrays, numbers FROM cell WHERE data_sha256 = ?"
        for key, shapes, numbers in stored_rows(folder, query, [sha256]):
            rows = _arrays_in(orjson.loads(shapes), numbers).get("rows")
            if rows is not None and rows.max() >= len(data.samples):
                raise DataError(
                    f"fit {_short_name(key)} has row {rows.max():.0f} of {len(data.samples)} rows"
                )
        return data
    except (DataError, TypeError, ValueError) as error:
        raise _corrupt(folder / FILE, f"data set {_short_name(sha256)}: {error}") from error


@contextmanager
def reading(folder: Path) -> Iterator[sqlite3.Connection]:
    """Give a connection that reads a folder's file; empty tables where there are none yet.

    Raises:
        StoreError: the file is corrupt, of another format, or cannot be read.
    """
    path = folder / FILE
    with sqlite_errors_as_store_error(path, "read"), ExitStack() as stack:
        if has_results(folder):
            db = sqlite3.connect(_file_uri(path), uri=True, timeout=BUSY_S, isolation_level=None)
            stack.enter_context(closing(db)).execute("BEGIN")  # what is read is of one moment
            db.execute("PRAGMA query_only = ON")
            if _has_tables(db):
                _check_format(path, db)
                most = min(path.stat().st_size + _SPARE, 2**31 - 1)
                db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, most)
                yield db
                return
        with closing(sqlite3.connect(":memory:")) as db:
            _execute_each(db, _SCHEMA)
            yield db


@contextmanager
def writing(folder: Path) -> Iterator[sqlite3.Connection]:
    """Give a connection in a transaction, which is on the disk when the block ends, whole or not.

    The file is made if there is none.

    Raises:
        StoreError: the file is corrupt, of another format, or cannot be written.
    """
    path = folder / FILE
    has_results(folder)  # what is packed is not lost
    with sqlite_errors_as_store_error(path, "written"):
        _check_journal(path)
        uri = f"{path.resolve().as_uri()}?mode=rwc"
        with closing(sqlite3.connect(uri, uri=True, timeout=BUSY_S, isolation_level=None)) as db:
            db.execute(f"PRAGMA synchronous = {SYNCHRONOUS}")
            db.execute("BEGIN IMMEDIATE")
            try:
                if not _has_tables(db):
                    _execute_each(db, _SCHEMA)
                _check_format(path, db)
                yield db
            except BaseException:
                with suppress(sqlite3.Error):
                    db.execute("ROLLBACK")
                raise
            db.execute("COMMIT")


def _has_tables(db: sqlite3.Connection) -> bool:
    return bool(db.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0])


def _execute_each(db: sqlite3.Connection, statements: str) -> None:
    """Execute statements in the transaction, which `executescript` would end."""
    for statement in statements.split(";\n"):
        db.execute(statement)


def write_run(db: sqlite3.Connection, manifest: RunManifest) -> None:
    """Put a run's manifest into the file in the place of an older state of it."""
    run = {name: getattr(manifest, name) for name in _RUN}
    run |= {name: _json_text(run[name]) for name in _RUN_JSON}
    row = [*run.values()]
    db.execute(f"INSERT OR REPLACE INTO run ({', '.join(_RUN)}) VALUES {_marks(row)}", row)


def _file_uri(path: Path) -> str:
    """Return how SQLite opens a file to read it: read-only.

    What a command that was killed left half-written is taken back, which needs a writable file.

    Raises:
        StoreError: the journal of such a command is corrupt.
    """
    has_journal = _check_journal(path)
    writable = has_journal and os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
    return f"{path.resolve().as_uri()}?mode={'rw' if writable else 'ro'}"


def _check_journal(path: Path) -> bool:
    """Return whether a file has a journal of a transaction that has not ended.

    Raises:
        StoreError: the journal names another file, which SQLite would delete.
    """
    journal = path.with_name(f"{path.name}-journal")
    try:
        with journal.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - len(_SUPER_JOURNAL)))
            if file.read() == _SUPER_JOURNAL:
                raise _corrupt(journal, "it names another file")
    except FileNotFoundError:  # also one that another run's transaction has just removed
        return False
    return True


@cache
def _schema_objects() -> frozenset[tuple[str, ...]]:
    with closing(sqlite3.connect(":memory:")) as db:
        _execute_each(db, _SCHEMA)
        return _objects_in(db)


def _objects_in(db: sqlite3.Connection) -> frozenset[tuple[str, ...]]:
    """Return type, name, table and statement of everything in a file but its rows."""
    return frozenset(db.execute("SELECT type, name, tbl_name, sql FROM sqlite_schema"))


def _check_format(path: Path, db: sqlite3.Connection) -> None:
    db.execute("PRAGMA trusted_schema = OFF")
    (file_format,) = db.execute("PRAGMA user_version").fetchone()
    if file_format > FORMAT:
        raise StoreError(
            f"{path}: stored by a newer stiffbench (format {file_format}): upgrade this one"
        )
    if file_format < FORMAT:
        raise StoreError(
            f"{path}: stored format {file_format}, this stiffbench reads {FORMAT}; give a new "
            "folder and run again"
        )
    if difference := _objects_in(db) ^ _schema_objects():
        kind, name, *_ = max(difference, key=str)  # a view or a trigger first
        reason = f"{kind} {_short_name(name)!r} is not what `bench run` makes"
        raise _corrupt(path, reason, "drop what was added to the file, or repeat the run")


@contextmanager
def sqlite_errors_as_store_error(path: Path, what: str) -> Iterator[None]:
    """Describe in one line what SQLite could not do.

    Raises:
        StoreError: it could not.
    """
    try:
        yield
    except OSError as error:
        raise StoreError(f"{path}: cannot be {what}: {error.strerror or error}") from error
    except (sqlite3.Error, UnicodeError) as error:
        if type(error) in (sqlite3.DatabaseError, UnicodeDecodeError) or "decode" in str(error):
            raise _corrupt(path, str(error)) from error
        busy = any(word in str(error) for word in ("locked", "locking", "disk I/O"))
        hint = (
            f"; another command has used it for more than {BUSY_S:g} s, the disk is full, or its "
            "file system has no locks (network file systems often have none): give a folder on a "
            "local disk"
        )
        raise StoreError(f"{path}: cannot be {what}: {error}{hint if busy else ''}") from error


def _fit_row(result: FitResult) -> dict[str, Any]:
    """Return column -> what is stored of a result."""
    fit, arrays = result.fit, _arrays(result)
    row: dict[str, Any] = {"key": fit.key}
    row |= {name: getattr(result.presentation, name) for name in _NAMES}
    row |= {f"{name}_key": getattr(fit, name) for name in _NAMES}
    row |= {name: getattr(fit, name) for name in _OF_FIT}
    row |= {name: getattr(result, name) for name in _OF_RESULT}
    row |= {name: getattr(result.cost, name, None) for name in Cost._fields}
    row["shown"] = {name: getattr(result.presentation, name) for name in _PRESENTATION_FIELDS}
    row["about"] = {name: getattr(result, name) for name in _ABOUT}
    # JSON has no infinity (a rigid joint) and no NaN (one that cannot be identified)
    row["about"]["diagnostics"] = {
        name: value if math.isfinite(value) else str(value)
        for name, value in result.diagnostics.items()
    }
    row["arrays"] = {name: array.shape for name, array in arrays.items()}
    row["numbers"] = b"".join(array.astype(_FLOAT).tobytes() for array in arrays.values())
    row |= {name: _json_text(row[name]) for name in _JSON}
    return {name: _as_stored(row[name], kind) for name, kind in _COLUMN_TYPES.items()}


def _as_stored(value: Any, kind: str) -> Any:
    """Return a value as it comes back from a column of this type."""
    if value is None or kind == "BLOB":
        return value
    return {"TEXT": str, "REAL": float, "INTEGER": int}[kind](value)


def _fit_result(row: Mapping[str, Any]) -> FitResult:
    """Return the result that was stored as this row.

    Raises:
        DataError: a part of it has another name or shape, or numbers are missing.
        ValueError, TypeError: a value has another type or is out of range.
    """
    row = {**row, **{name: orjson.loads(row[name]) for name in _JSON}}
    row = vars(_STORED_FIT.model_validate(row))
    about, labels = (
        {name: getattr(row[part], name) for name in row[part].model_fields_set}
        for part in ("about", "shown")
    )
    arrays = _arrays_in(row["arrays"], row["numbers"])
    cost = [row[name] for name in Cost._fields]
    if (row["status"] == "ok") is not ("rows" in arrays):
        raise DataError(f"status {row['status']!r} with arrays {', '.join(arrays) or 'none'}")
    if cost[0] is not None and None in cost[:-1]:
        raise DataError(f"{Cost._fields[cost.index(None)]} is missing")
    curves = {name: arrays.pop(name) for name in [*arrays] if name.startswith(_CURVE)}
    fit = Fit(
        **{name: row[f"{name}_key"] for name in _NAMES}, **{name: row[name] for name in _OF_FIT}
    )
    if fit.key != row["key"]:
        raise DataError(f"it is of the fit {fit.key}")
    return FitResult(
        fit=fit,
        presentation=Presentation(**{name: row[name] for name in _NAMES}, **labels),
        **{name: row[name] for name in _OF_RESULT},
        **about,
        prediction=_prediction(arrays, row["coverage"]) if arrays else None,
        cost=None if cost[0] is None else Cost(*cost),
        curves={name.removeprefix(_CURVE): curve for name, curve in curves.items()},
    )


def _arrays(result: FitResult) -> dict[str, FloatArray]:
    """Return name -> array: of the prediction, (n,) row numbers and (n, 3) m each; the curves."""
    arrays: dict[str, FloatArray] = {}
    if (prediction := result.prediction) is not None:
        arrays |= {"rows": prediction.rows.astype(_FLOAT), "predicted": prediction.predicted}
        arrays |= {"measured": prediction.measured, **prediction.bound_deflections}
        if prediction.directions.size:
            vectors = np.moveaxis(prediction.directions, 1, 0)
            arrays |= dict(zip(_DIRECTIONS, vectors, strict=False))
        if prediction.reference is not None:
            arrays["reference"] = prediction.reference
        if prediction.interval is not None:  # its coverage is the fit's
            arrays |= {"lower": prediction.interval.lower, "upper": prediction.interval.upper}
    return arrays | {f"{_CURVE}{name}": curve for name, curve in result.curves.items()}


def _arrays_in(shapes: Mapping[str, Sequence[int]], numbers: bytes) -> dict[str, FloatArray]:
    """Return the arrays of a fit; only curves may hold numbers that are not finite.

    Raises:
        DataError: a name, a shape or a number is wrong.
        TypeError, ValueError: they have more numbers, or a part of one.
    """
    arrays, start = dict[str, FloatArray](), 0
    all_finite = not numbers or bool(np.isfinite(np.frombuffer(numbers, _FLOAT)).all())
    for name, shape in shapes.items():
        is_curve = name.startswith(_CURVE)
        n_rows = shape[0] if is_curve and shape else shapes.get("rows", [0])[0]
        expected = [n_rows] if name == "rows" else [n_rows, 3]
        if not is_curve and (name not in _ARRAYS or n_rows == 0):
            raise DataError(f"array {_short_name(name)!r} of {n_rows} rows")
        if shape != expected:
            raise DataError(f"{_short_name(name)} has shape {shape}, expected {expected}")
        arrays[name] = np.ndarray(shape, _FLOAT, numbers, start)
        start += arrays[name].nbytes
        if not all_finite and not is_curve and not np.isfinite(arrays[name]).all():
            raise DataError(f"{name} holds numbers that are not finite")
    if start != len(numbers):
        raise DataError(f"{len(numbers)} bytes of numbers, expected {start}")
    if arrays.keys() & _PARTS and not arrays.keys() >= _PARTS:
        raise DataError(f"no array {min(_PARTS - arrays.keys())!r}")
    rows = arrays.get("rows")
    if rows is not None and not ((rows >= 0.0) & (rows < 2**53) & (rows % 1.0 == 0.0)).all():
        raise DataError("rows holds numbers that are not row numbers")
    return arrays


_PARTS = {"rows", "predicted", "measured"}
"""Arrays of every prediction."""
_DIRECTIONS = tuple(f"direction {number}" for number in range(1, 4))
"""Arrays of readings along directions, one for each number of a row."""
_ARRAYS = {*_PARTS, "reference", "lower", "upper", *BOUND_NAMES, *TRUTHS, *_DIRECTIONS}


def _prediction(arrays: Mapping[str, FloatArray], coverage: float | None) -> Prediction:
    interval = None
    if (coverage is not None and "lower" in arrays) != ({"lower", "upper"} <= arrays.keys()):
        raise DataError("intervals without coverage or without a bound")
    if "lower" in arrays and coverage is not None:
        interval = Interval(arrays["lower"], arrays["upper"], coverage)
    vectors = [arrays[name] for name in _DIRECTIONS if name in arrays]
    return Prediction.of_stored(
        rows=arrays["rows"].astype(np.int64),
        predicted=arrays["predicted"],
        measured=arrays["measured"],
        interval=interval,
        reference=arrays.get("reference"),
        bound_deflections={
            name: arrays[name] for name in (*BOUND_NAMES, *TRUTHS) if name in arrays
        },
        directions=np.stack(vectors, axis=1) if vectors else np.empty(0),
    )


def write_row(db: sqlite3.Connection, result: FitResult) -> None:
    """Replace what is stored of a fit; a failure does not replace a result."""
    row = _fit_row(result)
    there = db.execute("SELECT status FROM cell WHERE key = ?", (row["key"],)).fetchone()
    if there == ("ok",) and result.status != "ok":
        return
    values = [*row.values(), _checksum([*row.values()])]
    db.execute(f"INSERT OR REPLACE INTO cell VALUES {_marks(values)}", values)


def _read_row(values: Sequence[Any]) -> FitResult:
    """Return the result in a row of the table `cell`.

    Raises:
        DataError: it is not what was stored.
    """
    *content, sha256 = values
    try:
        if _checksum(content) != sha256:
            raise DataError("its checksum does not match its content")
        return _fit_result(dict(zip(_COLUMN_TYPES, content, strict=True)))
    except (TypeError, ValueError) as error:
        raise DataError(_reason(error)) from error


def _checksum(values: Sequence[Any]) -> str:
    """Return the SHA-256 of a fit's columns, of which the last are bytes."""
    return hashlib.sha256(orjson.dumps(values[:-1]) + b"\0" + values[-1]).hexdigest()


def _json_text(content: Any) -> str:
    return json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _marks(entries: Sequence[object]) -> str:
    """Return "(?, ?)": a place in a statement for each entry."""
    return f"({', '.join('?' * len(entries))})"


_OF_ROBOT = "robot "
"""How the names of the robot's fields begin in the archive."""
_ROBOT_ARRAYS = tuple(
    item.name
    for item in fields(Robot)
    if item.name not in ("controller", "held", "stand", "mimics")
)
"""Fields of a robot that results need, with `_MIMICS` where it has such joints."""
_MIMICS = TypeAdapter(tuple[ChainJoint, ...])


def data_content(data: BenchmarkData) -> bytes:
    """Return what is stored of a data set: a NumPy archive (`.npz`) of samples and robot."""
    names = ("instrument_noise", *data.samples.columns)
    arrays = {name: getattr(data.samples, name) for name in names}
    arrays |= {f"{_OF_ROBOT}{name}": getattr(data.robot, name) for name in _ROBOT_ARRAYS}
    if data.robot.mimics:
        arrays[f"{_OF_ROBOT}mimics"] = np.array(_MIMICS.dump_json(data.robot.mimics).decode())
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def stored_data(content: bytes) -> StoredData:
    """Return the data set whose content this is.

    Raises:
        DataError: it is none.
    """
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            size = sum(part.file_size for part in archive.infolist())
        if size > _most_unpacked(len(content)):
            raise DataError(f"{len(content)} bytes unpack to {size} bytes")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            names = [name for name in arrays if not name.startswith(_OF_ROBOT)]
            samples = Samples(**{name: arrays[name] for name in names})
            of_robot: dict[str, Any] = {
                name: arrays[f"{_OF_ROBOT}{name}"] for name in _ROBOT_ARRAYS
            }
            if (mimics := f"{_OF_ROBOT}mimics") in arrays:
                of_robot["mimics"] = _MIMICS.validate_json(str(arrays[mimics]))
        of_robot["name"] = str(of_robot["name"])
        joints = {name: tuple(of_robot[name].tolist()) for name in ("joint_names", "joint_types")}
        return StoredData(samples, Robot(**(of_robot | joints)))
    except Exception as error:  # of NumPy, zipfile and our own types, which raise many
        raise DataError(str(error)) from error
