"""A folder's results: one SQLite file, `results.sqlite`, that any SQLite browser reads.

::

    run      a row a run: command, environment, the keys of the cells it was asked for (JSON)
    data     a row a data set: its samples, joint torques and TCP positions (samples.py)
    cell     a row a cell: what it is, which run computed it, its status and cost; texts in JSON;
             predictions and curves as blobs (codec.py)
    measure  metric, axis and unit of a value
    value    a row a value: cell, measure, value in SI units
    metric   a view for people: every value beside its cell's names

One process writes, the run's own, a transaction a cell; of a cell there is one row. A result stands
over a failure, whenever that came: a cell has one key for all that shapes its numbers, so a rerun
that timed out takes nothing away. Each row has the SHA-256 of its content, checked at reading;
`damage.py` saves the rows of a damaged file.
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import orjson

from stiff_bench.store.codec import (
    COLUMN_TYPES,
    CellReader,
    fetched,
    json_text,
    marks,
    storable,
    write_row,
)
from stiff_bench.store.samples import StoredData, data_content, stored_data
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.files import make_folder
from stiff_protocols.contract.record import CellResult, RunManifest
from stiff_protocols.contract.types import BenchmarkData

FILE = "results.sqlite"
FORMAT = 4
"""Of the file, as `PRAGMA user_version` has it."""
BUSY_S = 60.0
"""How long a command waits for another one that writes."""
SYNCHRONOUS = "FULL"
"""SQLite's word for: a transaction is on the disk before the next one begins."""
PAGE_BYTES = 16384
"""A cell has about 2.5 kB: of SQLite's own 4 kB a third would stay empty."""
AT_ONCE = 2000
"""Cells that are read with one statement, so that those who write soon get their turn."""

_RUN = tuple(item.name for item in fields(RunManifest))
_RUN_JSON = ("environment", "cells", "machines")
_SCHEMA = f"""
CREATE TABLE run (run_id TEXT PRIMARY KEY, command TEXT, started TEXT, status TEXT,
    environment TEXT, cells TEXT, wall_s REAL, peak_memory_bytes INTEGER, machines TEXT,
    sha256 TEXT);
CREATE TABLE data (sha256 TEXT PRIMARY KEY, content BLOB, content_sha256 TEXT);
CREATE TABLE cell (id INTEGER PRIMARY KEY,
    {", ".join(f"{name} {kind}" for name, kind in COLUMN_TYPES.items())}, sha256 TEXT);
CREATE UNIQUE INDEX cell_key ON cell (key);
CREATE TABLE measure (id INTEGER PRIMARY KEY, metric TEXT, axis TEXT, unit TEXT,
    UNIQUE (metric, axis, unit));
CREATE TABLE value (cell INTEGER REFERENCES cell ON DELETE CASCADE, measure INTEGER, value REAL,
    PRIMARY KEY (cell, measure)) WITHOUT ROWID;
CREATE VIEW metric AS SELECT key, status, run_id, model, dataset, protocol, condition, split_index,
    metric, axis, value, unit
    FROM cell JOIN value ON value.cell = cell.id JOIN measure ON measure.id = value.measure;
PRAGMA user_version = {FORMAT};
"""


class DamagedFile(StoreError):
    """A file, or a row of it, does not hold what was once written there.

    Attributes:
        key: of the damaged cell; "" where it is another row or the whole file.
        run_id: of the damaged manifest; "" likewise.
    """

    def __init__(self, path: Path, why: str, *, key: str = "", run_id: str = "") -> None:
        """Say where and why."""
        super().__init__(f"{path}: damaged: {why}")
        self.key, self.run_id = key, run_id


OnDamage = Callable[[DamagedFile], None]
"""Is told of each row or file that is damaged."""


def _raise(error: DamagedFile) -> None:
    raise error


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
        except DamagedFile:
            pass  # for `repair`
        except StoreError as error:
            raise StoreError(f"{error}", "output") from error

    def write_cells(self, results: Iterable[CellResult]) -> None:
        """Store results and failures as one transaction; a failure takes nothing from a result.

        Raises:
            StoreError: they cannot be written, as on a full disk; what was there stands.
        """
        with writing(self.folder) as db:
            for result in results:
                write_row(db, result)

    def write_manifest(self, manifest: RunManifest) -> None:
        """Store a run's manifest, replacing an older state of it."""
        with writing(self.folder) as db:
            write_run(db, manifest)

    def write_data(self, data: BenchmarkData) -> None:
        """Store the samples that results belong to, once; damaged or older ones are replaced."""
        with suppress(StoreError):
            if read_data(self.folder, data.sha256).geometry is not None:
                return
        content = data_content(data)
        row = (data.sha256, content, hashlib.sha256(content).hexdigest())
        with writing(self.folder) as db:
            db.execute("INSERT OR REPLACE INTO data VALUES (?, ?, ?)", row)

    def result(self, key: str) -> CellResult | None:
        """Return a cell's result; None where there is none, or a failure alone."""
        found = stored_results(self.folder, {key}, report=lambda _: None)
        return next((one for one in found if one.status == "ok"), None)

    def remove(self, keys: Iterable[str]) -> None:
        """Delete what is stored of cells, as of damaged ones that are to be computed again."""
        with writing(self.folder) as db:
            db.executemany("DELETE FROM cell WHERE key = ?", [(key,) for key in keys])


def has_results(folder: Path) -> bool:
    """Say whether there is a file of results."""
    return (folder / FILE).exists()


def why_no_results(folder: Path) -> str:
    """Return why a folder has no results to read, for people."""
    if folder.is_dir():
        return "holds no results"
    return "is a file, no folder of results" if folder.exists() else "there is no such folder"


def read_results(folder: Path) -> list[CellResult]:
    """Return every cell of a folder, failed and skipped ones too, in the order of their keys."""
    return sorted(stored_results(folder), key=lambda one: one.cell.key)


def stored_results(
    folder: Path, keys: Set[str] | None = None, report: OnDamage = _raise
) -> Iterator[CellResult]:
    """Yield what is stored of some cells, in no particular order; writers need not wait meanwhile.

    Args:
        folder: of the results; it may be one that cannot be written.
        keys: of the cells; None: all.
        report: is told of damaged rows, which are left out; default: the first is raised.

    Raises:
        StoreError: the file is of another format, damaged as a whole, or cannot be read.
    """
    asked = sorted(keys or ())
    last = 0
    cells = CellReader()
    while keys is None or asked:
        with reading(folder) as db:
            if keys is None:
                rows = cells.rows(db, f"WHERE id > ? ORDER BY id LIMIT {AT_ONCE}", (last,))
            else:
                some, asked = asked[:AT_ONCE], asked[AT_ONCE:]
                rows = cells.rows(db, f"WHERE key IN {marks(some)}", some)
        for row in rows:
            try:
                yield cells.result(row)
            except DataError as error:
                report(DamagedFile(folder / FILE, f"cell {row[1]}: {error}", key=str(row[1])))
        if keys is None:
            if len(rows) < AT_ONCE:
                return
            last = rows[-1][-1]


def stored_statuses(folder: Path) -> dict[str, str]:
    """Return which cells are stored: key -> "ok", "failed" or "skipped"."""
    with reading(folder) as db:
        return dict(fetched(db, "SELECT key, status FROM cell"))


def mean_seconds(folder: Path) -> dict[str, float]:
    """Return model, with its options -> mean wall time of a stored fit and its predictions, s."""
    query = "SELECT model, avg(fit_s + predict_s) FROM cell WHERE status = 'ok' GROUP BY model"
    with reading(folder) as db:
        return {model: seconds for model, seconds in fetched(db, query) if seconds is not None}


def read_manifests(folder: Path, report: OnDamage = _raise) -> list[RunManifest]:
    """Return every run's manifest of a folder, in the order of their names.

    `report` is told of damaged manifests, which are left out; default: the first is raised.
    """
    with reading(folder) as db:
        rows = fetched(db, f"SELECT sha256, {', '.join(_RUN)} FROM run ORDER BY run_id")
    found = []
    for row in rows:
        try:
            found.append(_manifest(*row))
        except (DataError, TypeError, ValueError) as error:
            report(DamagedFile(folder / FILE, f"run {row[1]}: {error}", run_id=row[1]))
    return found


def read_data(folder: Path, sha256: str) -> StoredData:
    """Read the data set with this hash that results of a folder belong to.

    Raises:
        StoreError: there is none, or it is damaged.
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
        raise DamagedFile(folder / FILE, f"data set {sha256}: {error}") from error


@contextmanager
def reading(folder: Path) -> Iterator[sqlite3.Connection]:
    """Give a connection that reads a folder's file; empty tables where there are none yet.

    Raises:
        StoreError: the file is damaged, of another format, or cannot be read.
    """
    path = folder / FILE
    with told_in_one_line(path, "read"), ExitStack() as stack:
        if has_results(folder):
            db = sqlite3.connect(file_uri(path), uri=True, timeout=BUSY_S, isolation_level=None)
            stack.enter_context(closing(db)).execute("BEGIN")  # what is read is of one moment
            if _has_tables(db):
                _check_format(path, db)
                yield db
                return
        with closing(sqlite3.connect(":memory:")) as db:
            execute_each(db, _SCHEMA)
            yield db


@contextmanager
def writing(folder: Path, other: Path | None = None) -> Iterator[sqlite3.Connection]:
    """Give a connection in a transaction, which is on the disk when the block ends, whole or not.

    Args:
        folder: of the results; its file is made if there is none.
        other: a folder whose file is attached as `other`, to be read.

    Raises:
        StoreError: the file is damaged, of another format, or cannot be written.
    """
    path = folder / FILE
    with told_in_one_line(path, "written"):
        uri = f"{path.resolve().as_uri()}?mode=rwc"
        with closing(sqlite3.connect(uri, uri=True, timeout=BUSY_S, isolation_level=None)) as db:
            db.execute(f"PRAGMA page_size = {PAGE_BYTES}")  # of a new file
            db.execute(f"PRAGMA synchronous = {SYNCHRONOUS}")
            db.execute("PRAGMA foreign_keys = ON")
            if other is not None:
                db.execute("ATTACH ? AS other", (file_uri(other / FILE),))
            db.execute("BEGIN IMMEDIATE")
            try:
                if not _has_tables(db):
                    execute_each(db, _SCHEMA)
                _check_format(path, db)
                yield db
            except BaseException:
                with suppress(sqlite3.Error):
                    db.execute("ROLLBACK")
                raise
            db.execute("COMMIT")


def _has_tables(db: sqlite3.Connection) -> bool:
    return bool(db.execute("SELECT count(*) FROM main.sqlite_schema").fetchone()[0])


def execute_each(db: sqlite3.Connection, statements: str) -> None:
    """Execute statements in the transaction, which `executescript` would end."""
    for statement in statements.split(";\n"):
        db.execute(statement)


def write_run(db: sqlite3.Connection, manifest: RunManifest) -> None:
    """Put a run's manifest into the file in the place of an older state of it."""
    run = {name: getattr(manifest, name) for name in _RUN}
    run |= {name: json_text(run[name]) for name in _RUN_JSON}
    row = [storable(value) if type(value) is str else value for value in run.values()]
    db.execute(
        f"INSERT OR REPLACE INTO run ({', '.join(_RUN)}, sha256) VALUES {marks([*row, ''])}",
        (*row, _sha256(row)),
    )


def _manifest(sha256: str, *row: Any) -> RunManifest:
    if _sha256(row) != sha256:
        raise DataError("its checksum does not match its content")
    content = dict(zip(_RUN, row, strict=True))
    content |= {name: orjson.loads(content[name]) for name in _RUN_JSON}
    return RunManifest(**{**content, "cells": tuple(content["cells"])})


def _sha256(row: Sequence[Any]) -> str:
    return hashlib.sha256(orjson.dumps(row)).hexdigest()


def file_uri(path: Path) -> str:
    """Return how SQLite opens a file to read it.

    It may write where it can: what a command that was killed left half-written is taken back.
    """
    mode = "rw" if os.access(path, os.W_OK) and os.access(path.parent, os.W_OK) else "ro"
    return f"{path.resolve().as_uri()}?mode={mode}"


def _check_format(path: Path, db: sqlite3.Connection) -> None:
    (found,) = db.execute("PRAGMA main.user_version").fetchone()
    if found != FORMAT:
        raise StoreError(
            f"{path}: stored format {found}, this stiffbench reads {FORMAT}; give a new folder and "
            "run again"
        )


@contextmanager
def told_in_one_line(path: Path, what: str) -> Iterator[None]:
    """Say in one line what SQLite could not do.

    Raises:
        StoreError: it could not.
    """
    try:
        yield
    except UnicodeDecodeError as error:  # even the names of its tables are no text
        raise DamagedFile(path, str(error)) from error
    except OSError as error:
        raise StoreError(f"{path}: cannot be {what}: {error.strerror or error}") from error
    except (sqlite3.Error, OverflowError) as error:
        if type(error) is sqlite3.DatabaseError:
            remedy = "the `bench run` that made it keeps what can be read and computes the rest"
            raise DamagedFile(path, f"{error}; {remedy} again") from error
        busy = any(word in str(error) for word in ("locked", "locking", "disk I/O"))
        hint = (
            f"; another command has used it for more than {BUSY_S:g} s, the disk is full, or its "
            "file system has no locks (network file systems often have none): give a folder on a "
            "local disk"
        )
        raise StoreError(f"{path}: cannot be {what}: {error}{hint if busy else ''}") from error
