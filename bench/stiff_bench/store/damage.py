"""A damaged file of results: what is wrong with it, and the rows that can still be read."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory

from stiff_bench.store import database
from stiff_bench.store.codec import CellReader, marks, write_row
from stiff_bench.store.database import (
    FILE,
    DamagedFile,
    OnDamage,
    file_uri,
    read_manifests,
    told_in_one_line,
    writing,
)
from stiff_protocols.contract.errors import DataError

_DAMAGES = (sqlite3.Error, UnicodeDecodeError)
"""What a damaged file can raise."""
MOST_ROWS = 100_000
"""How many numbers are tried in a damaged table that does not say its last."""


def fault_of(folder: Path) -> str | None:
    """Return why SQLite cannot read a folder's file through; None where it can."""
    path = folder / FILE
    try:
        with told_in_one_line(path, "read"):
            with closing(sqlite3.connect(path, timeout=database.BUSY_S)) as db:
                (said,) = db.execute("PRAGMA quick_check(1)").fetchone()
    except DamagedFile as error:
        return str(error.__cause__)
    return None if said == "ok" else " ".join(said.split())


def salvage(source: Path, target: Path, report: OnDamage, keep: Path | None = None) -> None:
    """Copy what can be read of a damaged file to another one, row by row.

    Args:
        source: the damaged file.
        target: to write; it may be `source`, which is then replaced.
        report: is told of every row that is lost and can still be named.
        keep: where the damaged file is copied first; None: nowhere.
    """
    with (
        told_in_one_line(target, "written"),
        TemporaryDirectory(dir=target.parent, prefix=f".{target.name}.") as scratch,
    ):
        with (
            writing(Path(scratch)) as new,
            closing(sqlite3.connect(file_uri(source), uri=True)) as old,
        ):
            for key in _copied(old, new):
                report(DamagedFile(source, f"cell {key}: cannot be read", key=key))
        if keep is not None:
            shutil.copyfile(source, keep)
        Path(scratch, FILE).replace(target)


def _copied(old: sqlite3.Connection, new: sqlite3.Connection) -> Iterator[str]:
    """Copy every readable row; yield the keys of the cells that were there besides."""
    try:
        old.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    except _DAMAGES:
        return  # not even its tables can be found
    for table in ("run", "data"):
        for number in _row_numbers(old, table):
            with suppress(*_DAMAGES):  # of one key a damaged file may have two
                for row in old.execute(f"SELECT * FROM {table} WHERE rowid = ?", (number,)):
                    new.execute(f"INSERT INTO {table} VALUES {marks(row)}", row)
    kept: set[str] = set()
    cells = CellReader()
    for number in _row_numbers(old, "cell"):
        with suppress(*_DAMAGES, DataError):
            for row in cells.rows(old, "WHERE id = ?", (number,)):
                result = cells.result(row)
                write_row(new, result)
                kept.add(result.cell.key)
    with suppress(*_DAMAGES):  # the index of keys has pages of its own
        for (key,) in old.execute("SELECT key FROM cell INDEXED BY cell_key").fetchall():
            if key not in kept:
                yield str(key)


def _row_numbers(db: sqlite3.Connection, table: str) -> range:
    """Return all numbers that rows may have: a broken page ends other ways to find them."""
    try:
        (last,) = db.execute(f"SELECT max(rowid) FROM {table}").fetchone()
    except _DAMAGES:
        last = MOST_ROWS
    return range(1, (last or 0) + 1)


def repair(folder: Path, report: OnDamage) -> None:
    """See that a folder's file can be read through, before anything is added to it.

    Of a file that SQLite cannot read through, the readable rows go to a new one; the old one is
    kept as ``results.sqlite.damaged``. Manifests that are not what was stored are deleted.
    """
    path = folder / FILE
    if (fault := fault_of(folder)) is not None:
        endings = chain([""], (f"-{number}" for number in count(2)))
        aside = (path.with_name(f"{FILE}.damaged{ending}") for ending in endings)
        kept = next(name for name in aside if not name.exists())
        report(DamagedFile(path, f"{fault}; its readable rows are kept, and all of it as {kept}"))
        salvage(path, path, report, keep=kept)
    lost: list[DamagedFile] = []
    read_manifests(folder, lost.append)
    for error in lost:
        with writing(folder) as db:
            db.execute("DELETE FROM run WHERE run_id = ?", (error.run_id,))
        report(error)
