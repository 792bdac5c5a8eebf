"""A folder's results: one SQLite file, `results.sqlite`, that any SQLite browser reads.

::

    run      a row per run: command, environment, the keys of the requested cells (JSON)
    data     a row a data set: its samples, joint torques and TCP positions (samples.py)
    cell     a row a cell: what it is, which run computed it, its status and cost; predictions and
             training curves as one blob (cell_rows.py)

Each write is one transaction; of a cell there is one row. A failure does not replace a result: a
cell has one key for all that shapes its numbers, so a rerun that timed out takes nothing away. Each
row of a cell has the SHA-256 of its content, checked when it is read.
"""

from __future__ import annotations

import hashlib
import lzma
import os
import shutil
import sqlite3
import zlib
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import fields
from pathlib import Path

import orjson

from stiff_bench.store.cell_rows import (
    COLUMN_TYPES,
    json_text,
    marks,
    read_row,
    storable,
    write_row,
)
from stiff_bench.store.samples import StoredData, data_content, stored_data
from stiff_protocols.contract.errors import DataError, StoreError, warn
from stiff_protocols.contract.files import make_folder, written_whole
from stiff_protocols.contract.record import CellResult, RunManifest
from stiff_protocols.contract.types import BenchmarkData

FILE = "results.sqlite"
PACKED = f"{FILE}.xz"
"""The same file as a repository keeps it, a quarter of the size: the first reader unpacks it."""
FORMAT = 5
"""Of the file, as `PRAGMA user_version` has it."""
BUSY_S = 60.0
"""Time that a command waits for another command that writes."""
SYNCHRONOUS = "FULL"
"""SQLite's word for: a transaction is on the disk before the next one begins."""

_RUN = tuple(item.name for item in fields(RunManifest))
_RUN_JSON = ("environment", "cells", "machines")
_SCHEMA = f"""
CREATE TABLE run (run_id TEXT PRIMARY KEY, command TEXT, started TEXT, status TEXT,
    environment TEXT, cells TEXT, wall_s REAL, peak_memory_bytes INTEGER, machines TEXT);
CREATE TABLE data (sha256 TEXT PRIMARY KEY, content BLOB, content_sha256 TEXT);
CREATE TABLE cell ({", ".join(f"{name} {kind}" for name, kind in COLUMN_TYPES.items())},
    sha256 TEXT, PRIMARY KEY (key));
PRAGMA user_version = {FORMAT};
"""


def _corrupt(path: Path, reason: str, remedy: str = "") -> StoreError:
    """Return the error for a corrupt file or row."""
    remedy = remedy or "delete the file and repeat the `bench run` that made it"
    return StoreError(f"{path}: corrupt: {reason}; {remedy}")


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

    def write_cells(self, results: Iterable[CellResult]) -> None:
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

    def result(self, key: str) -> CellResult | None:
        """Return a cell's result; None if nothing or only a failure is stored."""
        results = read_results(self.folder, [key])
        return next((result for result in results if result.status == "ok"), None)


def has_results(folder: Path) -> bool:
    """Check for a file of results; a packed file is unpacked into the same folder.

    Raises:
        StoreError: the packed file is corrupt, or the folder cannot be written.
    """
    path, packed = folder / FILE, folder / PACKED
    if path.exists() or not packed.exists():
        return path.exists()
    with sqlite_errors_as_store_error(path, "written"), written_whole(path) as temporary:
        try:
            with lzma.open(packed) as content, temporary.open("wb") as file:
                shutil.copyfileobj(content, file)
        except (lzma.LZMAError, EOFError) as error:
            raise _corrupt(packed, str(error)) from error
        with closing(sqlite3.connect(temporary)) as db:
            db.execute(f"PRAGMA application_id = {_number_of(packed)}")
    return True


def _number_of(packed: Path) -> int:
    """Return a number of a packed file's content, which its unpacked file stores."""
    return zlib.crc32(packed.read_bytes()) & 0x7FFFFFFF


def _warn_of_other_packed_file(folder: Path, db: sqlite3.Connection) -> None:
    """Warn if the packed file was replaced after the file was unpacked from it."""
    packed = folder / PACKED
    (number,) = db.execute("PRAGMA application_id").fetchone()
    if number and packed.exists() and number != _number_of(packed):
        warn(
            f"{folder / FILE} was unpacked from an older {PACKED}: move it away to read the new "
            "results, or combine both with `bench merge`"
        )


def why_no_results(folder: Path) -> str:
    """Return the reason why a folder has no results to read."""
    if folder.is_dir():
        return "no results in this folder"
    return "is a file, not a folder of results" if folder.exists() else "no such folder"


def read_results(folder: Path, keys: Collection[str] | None = None) -> list[CellResult]:
    """Return the cells of a folder, failed and skipped ones too, in the order of their keys.

    Args:
        folder: of the results; it may be one that cannot be written.
        keys: of the cells; None: all. Those that are not stored are left out.

    Raises:
        StoreError: the file is corrupt, of another format, or cannot be read.
    """
    where = "" if keys is None else "WHERE key IN (SELECT value FROM json_each(?))"
    values = [] if keys is None else [orjson.dumps([*keys]).decode()]
    with reading(folder) as db:
        if keys is None:  # a run asks for one key after another
            _warn_of_other_packed_file(folder, db)
        rows = db.execute(f"SELECT * FROM cell {where} ORDER BY key", values).fetchall()
    results = []
    for row in rows:
        try:
            results.append(read_row(row))
        except DataError as error:
            remedy = _rerun(folder, row[0])
            raise _corrupt(folder / FILE, f"cell {row[0]}: {error}", remedy) from error
    return results


def _rerun(folder: Path, key: str) -> str:
    """Return the command that computes a cell again, whatever is stored of it; "": not known."""
    commands = [run.command for run in read_manifests(folder) if key in run.cells]
    return f"repeat this run with --rerun all: {commands[-1]}" if commands else ""


def stored_statuses(folder: Path) -> dict[str, str]:
    """Return which cells are stored: key -> "ok", "failed" or "skipped"."""
    with reading(folder) as db:
        return dict(db.execute("SELECT key, status FROM cell").fetchall())


def mean_seconds(folder: Path) -> dict[str, float]:
    """Return model, with its options -> mean wall time of a stored fit and its predictions, s."""
    query = "SELECT model, avg(fit_s + predict_s) FROM cell WHERE status = 'ok' GROUP BY model"
    with reading(folder) as db:
        return {model: seconds for model, seconds in db.execute(query) if seconds is not None}


def read_manifests(folder: Path) -> list[RunManifest]:
    """Return every run's manifest of a folder, in the order of their names."""
    with reading(folder) as db:
        rows = db.execute(f"SELECT {', '.join(_RUN)} FROM run ORDER BY run_id").fetchall()
    manifests = []
    for row in rows:
        run = dict(zip(_RUN, row, strict=True))
        try:
            run |= {name: orjson.loads(run[name]) for name in _RUN_JSON}
        except ValueError as error:
            raise _corrupt(folder / FILE, f"run {row[0]}: {error}") from error
        manifests.append(RunManifest(**{**run, "cells": tuple(run["cells"])}))
    return manifests


def read_data(folder: Path, sha256: str) -> StoredData:
    """Read the data set with this hash that results of a folder belong to.

    Raises:
        StoreError: there is none, or it is corrupt.
    """
    query = "SELECT content, content_sha256 FROM data WHERE sha256 = ?"
    with reading(folder) as db:
        row = db.execute(query, (sha256,)).fetchone()
    if row is None:
        raise StoreError(f"{folder / FILE}: holds no data set {sha256!r}")
    try:
        if hashlib.sha256(row[0]).hexdigest() != row[1]:
            raise DataError("its checksum does not match its content")
        return stored_data(row[0])
    except (DataError, TypeError) as error:
        raise _corrupt(folder / FILE, f"data set {sha256}: {error}") from error


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
            if _has_tables(db):
                _check_format(path, db)
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
    run |= {name: json_text(run[name]) for name in _RUN_JSON}
    row = [storable(value) if type(value) is str else value for value in run.values()]
    db.execute(f"INSERT OR REPLACE INTO run ({', '.join(_RUN)}) VALUES {marks(row)}", row)


def _file_uri(path: Path) -> str:
    """Return how SQLite opens a file to read it.

    It may write where it can: what a command that was killed left half-written is taken back.
    """
    mode = "rw" if os.access(path, os.W_OK) and os.access(path.parent, os.W_OK) else "ro"
    return f"{path.resolve().as_uri()}?mode={mode}"


def _check_format(path: Path, db: sqlite3.Connection) -> None:
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
    except (sqlite3.Error, UnicodeDecodeError) as error:
        if type(error) in (sqlite3.DatabaseError, UnicodeDecodeError) or "decode" in str(error):
            raise _corrupt(path, str(error)) from error
        busy = any(word in str(error) for word in ("locked", "locking", "disk I/O"))
        hint = (
            f"; another command has used it for more than {BUSY_S:g} s, the disk is full, or its "
            "file system has no locks (network file systems often have none): give a folder on a "
            "local disk"
        )
        raise StoreError(f"{path}: cannot be {what}: {error}{hint if busy else ''}") from error
