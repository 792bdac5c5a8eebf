"""A folder's results: one SQLite file, `results.sqlite`, that any SQLite browser reads.

::

    run      a row a run: command, environment, the keys of the cells it was asked for (JSON)
    data     a row a data set: its samples, joint torques and TCP positions (stored_data.py)
    cell     a row a cell: what it is, which run computed it, its status and cost; texts in JSON;
             predictions and curves as blobs (cell_content.py)
    measure  metric, axis and unit of a value
    value    a row a value: cell, measure, value in SI units
    metric   a view for people: every value beside its cell's names

One process writes, the run's own, a transaction a cell; of a cell there is one row. A result stands
over a failure, whenever that came: a cell has one key for all that shapes its numbers, so a rerun
that timed out takes nothing away. Each row has the SHA-256 of its content, checked at reading.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import fields
from functools import cache
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from stiff_bench.store.codec import (
    COLUMNS,
    REALS,
    cell_content,
    checked_result,
    checksum,
    json_text,
    measure_names,
)
from stiff_bench.store.samples import StoredData, data_content, stored_data
from stiff_protocols.contract.errors import DataError, StoreError
from stiff_protocols.contract.files import make_folder
from stiff_protocols.contract.record import CellResult, Measures, RunManifest, StoredRecords
from stiff_protocols.contract.types import BenchmarkData, FloatArray

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

OnDamage = Callable[[StoreError], None]
"""Is told of each row or file that is damaged."""

_NUMBERS = {
    **dict.fromkeys(
        (
            *("split_index", "seed", "scoring_version", "n_splits", "n_train"),
            *("calibration_samples", "memory_bytes"),
        ),
        "INTEGER",
    ),
    **dict.fromkeys(REALS, "REAL"),
    **dict.fromkeys(("prediction", "curves"), "BLOB"),
}
_N_BLOBS = 2
_RUN = tuple(item.name for item in fields(RunManifest))
_RUN_JSON = ("environment", "cells", "machines")
_SCHEMA = f"""
CREATE TABLE run (run_id TEXT PRIMARY KEY, command TEXT, started TEXT, status TEXT,
    environment TEXT, cells TEXT, wall_s REAL, peak_memory_bytes INTEGER, machines TEXT,
    sha256 TEXT);
CREATE TABLE data (sha256 TEXT PRIMARY KEY, content BLOB, content_sha256 TEXT);
CREATE TABLE cell (id INTEGER PRIMARY KEY,
    {", ".join(f"{name} {_NUMBERS.get(name, 'TEXT')}" for name in COLUMNS)}, sha256 TEXT);
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
_INSERT = (
    f"INSERT INTO cell ({', '.join(COLUMNS)}, sha256) "
    f"VALUES ({', '.join('?' * (len(COLUMNS) + 1))})"
)
_SELECT = f"SELECT id, sha256, {', '.join(COLUMNS)} FROM cell"


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
            _refuse_old_format(folder)
            with writing(folder):
                pass
        except DamagedFile:
            pass  # for `repair`
        except StoreError as error:
            raise StoreError(f"--output {error}") from error

    def write_cell(self, result: CellResult) -> None:
        """Store a cell's result or failure; a failure takes nothing from a result.

        Raises:
            StoreError: it cannot be written, as on a full disk; what was there stands.
        """
        self.write_cells([result])

    def write_cells(self, results: Iterable[CellResult]) -> None:
        """Store many as one transaction, all of them or none; see `write_cell`."""
        with writing(self.folder) as db:
            for result in results:
                _write(db, result)

    def write_manifest(self, manifest: RunManifest) -> None:
        """Store a run's manifest, replacing an older state of it."""
        with writing(self.folder) as db:
            write_run(db, manifest)

    def write_data(self, data: BenchmarkData) -> None:
        """Store the samples that results belong to, once; damaged ones are replaced.

        Raises:
            StoreError: they are too many, or cannot be written.
        """
        with suppress(StoreError):
            read_data(self.folder, data.sha256)
            return
        content = data_content(data)
        row = (data.sha256, content, hashlib.sha256(content).hexdigest())
        with writing(self.folder) as db:
            db.execute("INSERT OR REPLACE INTO data VALUES (?, ?, ?)", row)

    def result(self, key: str) -> CellResult | None:
        """Return a cell's result; None where there is none, or a failure alone."""
        found = stored_results(self.folder, {key}, report=lambda _: None)
        return next((one for one in found if one.status == "ok"), None)

    def repair(self, report: OnDamage) -> None:
        """See that the file can be read through, before anything is added to it.

        Of a file that SQLite cannot read through, the readable rows go to a new one; the old one is
        kept as ``results.sqlite.damaged``. Manifests that are not what was stored are deleted.

        Args:
            report: is told what was damaged.

        Raises:
            StoreError: the folder cannot be written, or another command uses it for a minute.
        """
        path = self.folder / FILE
        fault = fault_of(self.folder)
        if fault is not None:
            endings = chain([""], (f"-{number}" for number in count(2)))
            aside = (path.with_name(f"{FILE}.damaged{ending}") for ending in endings)
            kept = next(name for name in aside if not name.exists())
            report(
                DamagedFile(path, f"{fault}; its readable rows are kept, and all of it as {kept}")
            )
            salvage(path, path, report, keep=kept)
        lost: list[DamagedFile] = []
        list(readable_manifests(self.folder, lost.append))
        if lost:
            with writing(self.folder) as db:
                names = [(error.run_id,) for error in lost]
                db.executemany("DELETE FROM run WHERE run_id = ?", names)
        for error in lost:
            report(error)

    def remove(self, keys: Iterable[str]) -> None:
        """Delete what is stored of cells, as of damaged ones that are to be computed again."""
        with writing(self.folder) as db:
            db.executemany("DELETE FROM cell WHERE key = ?", [(key,) for key in keys])


def has_results(folder: Path) -> bool:
    """Say whether there is a file of results.

    Raises:
        StoreError: the folder holds results of an older format.
    """
    if (folder / FILE).is_file():
        return True
    _refuse_old_format(folder)
    return False


def read_results(folder: Path) -> list[CellResult]:
    """Return every cell of a folder, failed and skipped ones too, in the order of their keys.

    Raises:
        StoreError: the folder is none of ours, or something in it is damaged.
    """
    return sorted(stored_results(folder), key=lambda one: one.cell.key)


def stored_results(
    folder: Path, keys: Set[str] | None = None, report: OnDamage | None = None
) -> Iterator[CellResult]:
    """Yield what is stored of some cells, in no particular order; writers need not wait meanwhile.

    Args:
        folder: of the results; it may be one that cannot be written.
        keys: of the cells; None: all.
        report: is told of damaged rows, which are left out; None: the first is raised.

    Raises:
        StoreError: the folder is none of ours, the file is damaged as a whole, or a row is and
            nobody asked for a report.
    """
    tell = report or _raise
    asked = sorted(keys or ())
    last = 0
    known = _Known()
    while keys is None or asked:
        with reading(folder) as db:
            if keys is None:
                query = f"{_SELECT} WHERE id > ? ORDER BY id LIMIT {AT_ONCE}"
                rows = _fetched(db, query, (last,))
            else:
                some, asked = asked[:AT_ONCE], asked[AT_ONCE:]
                rows = _fetched(db, f"{_SELECT} WHERE key IN {_marks(some)}", some)
            values = known.values(db, [row[0] for row in rows])
        for row in rows:
            try:
                yield _checked(row, values)
            except DataError as error:
                tell(DamagedFile(folder / FILE, f"cell {row[2]}: {error}", key=str(row[2])))
        if keys is None:
            if len(rows) < AT_ONCE:
                return
            last = rows[-1][0]


def stored_statuses(folder: Path) -> dict[str, str]:
    """Return which cells are stored: key -> "ok", "failed" or "skipped".

    Raises:
        StoreError: the folder is none of ours, or its file is damaged.
    """
    with reading(folder) as db:
        return dict(_fetched(db, "SELECT key, status FROM cell"))


def mean_seconds(folder: Path) -> dict[str, float]:
    """Return model, with its options -> mean wall time of a stored fit and its predictions, s.

    Raises:
        StoreError: the folder is none of ours, or its file is damaged.
    """
    query = "SELECT model, avg(fit_s + predict_s) FROM cell WHERE status = 'ok' GROUP BY model"
    with reading(folder) as db:
        return {model: seconds for model, seconds in _fetched(db, query) if seconds is not None}


def read_manifests(folder: Path) -> list[RunManifest]:
    """Return every run's manifest of a folder, in the order of their names.

    Raises:
        StoreError: the folder is none of ours, or something in it is damaged.
    """
    return list(readable_manifests(folder, _raise))


def readable_manifests(
    folder: Path, report: Callable[[DamagedFile], None]
) -> Iterator[RunManifest]:
    """Yield the manifests of a folder that are whole; `report` is told of the others."""
    with reading(folder) as db:
        rows = _fetched(db, f"SELECT sha256, {', '.join(_RUN)} FROM run ORDER BY run_id")
    for row in rows:
        try:
            yield _manifest(*row)
        except (DataError, TypeError, ValueError) as error:
            report(DamagedFile(folder / FILE, f"run {row[1]}: {error}", run_id=row[1]))


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
    with _said(path, "read"), ExitStack() as stack:
        if has_results(folder):
            db = sqlite3.connect(_uri(path), uri=True, timeout=BUSY_S, isolation_level=None)
            stack.enter_context(closing(db)).execute("BEGIN")  # what is read is of one moment
            if _has_tables(db):
                _check_format(path, db)
                yield db
                return
        with closing(sqlite3.connect(":memory:")) as db:
            _make_tables(db)
            yield db


@contextmanager
def writing(folder: Path, other: Path | None = None) -> Iterator[sqlite3.Connection]:
    """Give a connection in a transaction, which is on the disk when the block ends.

    After an exception nothing of the block is there.

    Args:
        folder: of the results; its file is made if there is none.
        other: a folder whose file is attached as `other`, to be read.

    Raises:
        StoreError: the file is damaged, of another format, or cannot be written.
    """
    path = folder / FILE
    with _said(path, "written"):
        uri = f"{path.resolve().as_uri()}?mode=rwc"
        with closing(sqlite3.connect(uri, uri=True, timeout=BUSY_S, isolation_level=None)) as db:
            db.execute(f"PRAGMA page_size = {PAGE_BYTES}")  # of a new file
            db.execute(f"PRAGMA synchronous = {SYNCHRONOUS}")
            db.execute("PRAGMA foreign_keys = ON")
            if other is not None:
                db.execute("ATTACH ? AS other", (_uri(other / FILE),))
            db.execute("BEGIN IMMEDIATE")
            try:
                if not _has_tables(db):
                    _make_tables(db)
                _check_format(path, db)
                yield db
            except BaseException:
                with suppress(sqlite3.Error):
                    db.execute("ROLLBACK")
                raise
            db.execute("COMMIT")


def _has_tables(db: sqlite3.Connection) -> bool:
    return bool(db.execute("SELECT count(*) FROM main.sqlite_schema").fetchone()[0])


def _make_tables(db: sqlite3.Connection) -> None:
    for statement in _SCHEMA.split(";\n"):
        db.execute(statement)


def fault_of(folder: Path) -> str | None:
    """Return why SQLite cannot read a folder's file through; None where it can.

    Raises:
        StoreError: it cannot be opened.
    """
    path = folder / FILE
    with _said(path, "read"):
        try:
            with closing(sqlite3.connect(path, timeout=BUSY_S)) as db:
                (said,) = db.execute("PRAGMA quick_check(1)").fetchone()
        except UnicodeDecodeError as error:
            return str(error)
        except sqlite3.DatabaseError as error:
            if type(error) is not sqlite3.DatabaseError:
                raise
            return str(error)
    return None if said == "ok" else " ".join(said.split())


def salvage(source: Path, target: Path, report: OnDamage, keep: Path | None = None) -> None:
    """Copy what can be read of a damaged file to another one, row by row.

    Args:
        source: the damaged file.
        target: to write; it may be `source`, which is then replaced.
        report: is told of every row that is lost and can still be named.
        keep: where the damaged file is copied first; None: nowhere.

    Raises:
        StoreError: the target cannot be written.
    """
    with _said(target, "written"):
        scratch = target.parent / f".{target.name}.{os.getpid()}"
        scratch.mkdir()
        try:
            with writing(scratch) as new, closing(sqlite3.connect(_uri(source), uri=True)) as old:
                for key in _copied(old, new):
                    report(DamagedFile(source, f"cell {key}: cannot be read", key=key))
            if keep is not None:
                shutil.copyfile(source, keep)
            (scratch / FILE).replace(target)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)


def _copied(old: sqlite3.Connection, new: sqlite3.Connection) -> Iterator[str]:
    """Copy every readable row; yield the keys of the cells that were there besides."""
    try:
        old.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    except _DAMAGES:
        return  # not even its tables can be found
    for table in ("run", "data"):
        for row in _readable_rows(old, table):
            with suppress(*_DAMAGES):  # of one key a damaged file may have two
                new.execute(f"INSERT INTO {table} VALUES {_marks(row)}", row)
    kept: set[str] = set()
    known = _Known()
    for row in _readable_rows(old, "cell"):
        with suppress(*_DAMAGES, DataError, KeyError):
            # id, columns, checksum -> id, checksum, columns
            result = _checked((row[0], row[-1], *row[1:-1]), known.values(old, [row[0]]))
            _write(new, result)
            kept.add(result.cell.key)
    with suppress(*_DAMAGES):  # the index of keys has pages of its own
        for (key,) in old.execute("SELECT key FROM cell INDEXED BY cell_key").fetchall():
            if key not in kept:
                yield str(key)


def _fetched(
    db: sqlite3.Connection, query: str, values: Sequence[object] = ()
) -> list[tuple[Any, ...]]:
    """Return all rows; bytes that are no text are left to the rows' checksums to find."""
    try:
        return db.execute(query, values).fetchall()
    except sqlite3.OperationalError as error:
        if "decode" not in str(error):
            raise
    db.text_factory = _lenient
    return db.execute(query, values).fetchall()


def _lenient(text: bytes) -> str:
    return text.decode(errors="surrogateescape")


def _readable_rows(db: sqlite3.Connection, table: str) -> Iterator[tuple[Any, ...]]:
    """Yield every row that can be read, found by its number: a broken page ends other searches."""
    try:
        (last,) = db.execute(f"SELECT max(rowid) FROM {table}").fetchone()
    except _DAMAGES:
        last = MOST_ROWS
    for number in range(1, (last or 0) + 1):
        try:
            row = db.execute(f"SELECT * FROM {table} WHERE rowid = ?", (number,)).fetchone()
        except _DAMAGES:
            continue
        if row is not None:
            yield row


_DAMAGES = (sqlite3.Error, UnicodeDecodeError)
"""What a damaged file can raise."""
MOST_ROWS = 100_000
"""How many numbers are tried in a damaged table that does not say its last."""


def _checked(row: Sequence[Any], values: Mapping[int, tuple[_Measures, FloatArray]]) -> CellResult:
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
    return checked_result(columns, StoredRecords(measures, numbers))


@cache  # most rows are alike
def _check_types(types: tuple[type, ...]) -> None:
    """See that a row has the types of its columns, which SQLite does not enforce.

    Raises:
        DataError: it has not.
    """
    for name, found in zip(COLUMNS, types, strict=True):
        known = _TYPES[_NUMBERS.get(name, "TEXT")]
        if found is not known and not (found is type(None) and name in _OPTIONAL):
            raise DataError(f"{name} holds {found.__name__}, expected {known.__name__}")


_TYPES = {"TEXT": str, "INTEGER": int, "REAL": float, "BLOB": bytes}
_OPTIONAL = {*REALS, "memory_bytes", "prediction_arrays", "prediction", "curves"}


class _Measures(Measures):
    """With what a checksum needs of them."""

    def __init__(self, names: Sequence[tuple[str, str, str]]) -> None:
        """Put them in order: by name, since another file has other numbers for them."""
        super().__init__(names)
        self.order = np.array(sorted(range(len(names)), key=names.__getitem__), dtype=np.int64)
        self.text = measure_names(sorted(names))


_NO_VALUES = (_Measures(()), np.empty(0))


class _Known:
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
        where = f"cell {'BETWEEN ? AND ?' if whole else f'IN {_marks(cells)}'}"
        asked = (cells[0], cells[-1]) if whole else cells
        # both walk the table in the order of its key
        query = f"SELECT cell, count(*), group_concat(measure) FROM value WHERE {where} GROUP BY 1"
        owners = db.execute(query, asked).fetchall()
        query = f"SELECT value FROM value WHERE {where} ORDER BY cell, measure"
        values = chain.from_iterable(db.execute(query, asked))
        numbers = np.fromiter(values, np.float64, sum(row[1] for row in owners))
        found, start = {}, 0
        for cell, n_values, measures in owners:
            found[cell] = self._of(db, measures), numbers[start : start + n_values]
            start += n_values
        return found

    def _of(self, db: sqlite3.Connection, measures: str) -> _Measures:
        """Return the measures with these numbers, "1,2,5"."""
        if measures not in self._measures:
            numbers = [int(number) for number in measures.split(",")]
            if not self._names.keys() >= {*numbers}:
                self._names = {row[0]: row[1:] for row in db.execute("SELECT * FROM measure")}
            self._measures[measures] = _Measures([self._names[number] for number in numbers])
        return self._measures[measures]


def _write(db: sqlite3.Connection, result: CellResult) -> None:
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
    number = db.execute(_INSERT, (*columns, sha256)).lastrowid
    known = {row[1:]: row[0] for row in db.execute("SELECT * FROM measure")}
    for measure in named:
        if measure not in known:
            insert = "INSERT INTO measure (metric, axis, unit) VALUES (?, ?, ?)"
            known[measure] = db.execute(insert, measure).lastrowid
    rows = [(number, known[m], value) for m, value in zip(named, values.tolist(), strict=True)]
    db.executemany("INSERT INTO value VALUES (?, ?, ?)", rows)


def write_run(db: sqlite3.Connection, manifest: RunManifest) -> None:
    """Put a run's manifest into the file in the place of an older state of it."""
    row = [getattr(manifest, name) for name in _RUN]
    row = [json_text(v) if n in _RUN_JSON else v for n, v in zip(_RUN, row, strict=True)]
    row = [orjson.loads(json_text(value)) if type(value) is str else value for value in row]
    db.execute(
        f"INSERT OR REPLACE INTO run ({', '.join(_RUN)}, sha256) VALUES {_marks([*row, ''])}",
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


def _marks(entries: Sequence[object]) -> str:
    return f"({', '.join('?' * len(entries))})"


def _uri(path: Path) -> str:
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


def _refuse_old_format(folder: Path) -> None:
    """Refuse a folder of before there was a database."""
    if (folder / FILE).exists():
        return
    if any(any((folder / name).glob("*.*")) for name in ("cells", "packs")):
        raise StoreError(
            f"{folder}: holds results of an older stiffbench (files in cells/ or packs/), which "
            "this one does not read; give a new folder and run again"
        )


@contextmanager
def _said(path: Path, what: str) -> Iterator[None]:
    """Say in one line what SQLite could not do.

    Raises:
        StoreError: it could not.
    """
    try:
        yield
    except sqlite3.OperationalError as error:
        raise StoreError(f"{path}: cannot be {what}: {error}{_hint(str(error))}") from error
    except sqlite3.DatabaseError as error:
        if type(error) is not sqlite3.DatabaseError:  # such as a blob that is too large
            raise StoreError(f"{path}: cannot be {what}: {error}") from error
        remedy = "the `bench run` that made it keeps what can be read and computes the rest again"
        raise DamagedFile(path, f"{error}; {remedy}") from error
    except UnicodeDecodeError as error:  # even the names of its tables are no text
        raise DamagedFile(path, str(error)) from error
    except (sqlite3.Error, OverflowError) as error:
        raise StoreError(f"{path}: cannot be {what}: {error}") from error
    except OSError as error:
        raise StoreError(f"{path}: cannot be {what}: {error.strerror or error}") from error


def _hint(message: str) -> str:
    if any(word in message for word in ("locked", "locking", "disk I/O")):
        return (
            f"; another command has used it for more than {BUSY_S:g} s, the disk is full, or its "
            "file system has no locks (network file systems often have none): give a folder on a "
            "local disk"
        )
    return ""


def _raise(error: StoreError) -> None:
    raise error
