"""Results on disk: each file is written whole or not at all.

::

    OUTPUT/cells/*.json        a cell: identity, metric values, predictions, timings, or why it
                               failed or was skipped (see loose_cells.py)
    OUTPUT/packs/*.parquet     many cells together (see packs.py, packing.py)
    OUTPUT/runs/<run id>.json  a run's manifest
    OUTPUT/data/<sha256>.npz   the samples (see stored_data.py)

Of several records of a cell one counts, for everybody who reads (see counting_records.py); a file
of its own is newer than a pack. A damaged file is renamed by the run that has computed its cells
again (`ResultStore.set_aside`).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Set
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import orjson

from stiff_bench.cell_content import cell_content, fields_of
from stiff_bench.checked_json import DamagedFile, read_checked, write_checked
from stiff_bench.counting_records import CountingRecords
from stiff_bench.folder_lock import make_lock, shared
from stiff_bench.loose_cells import (
    cell_file,
    is_failure,
    json_files,
    key_of,
    loose_files,
    read_cell_file,
)
from stiff_bench.stored_data import write_data
from stiff_protocols.errors import StoreError
from stiff_protocols.files import read_plain
from stiff_protocols.record import SCHEMA, CellResult, RunManifest
from stiff_protocols.types import BenchmarkData

if TYPE_CHECKING:
    from stiff_bench.packs import Pack

Report = Callable[[StoreError], None]
"""Is told of each file that cannot be read or is damaged."""


class ResultStore:
    """A folder of results.

    Args:
        folder: made if it does not exist.

    Raises:
        StoreError: it cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        """Make the folder and see that it can be written."""
        self.folder = folder
        try:
            for part in ("cells", "runs", "data"):
                (folder / part).mkdir(parents=True, exist_ok=True)
                with tempfile.TemporaryFile(dir=folder / part):
                    pass  # only whether it can be made
            make_lock(folder)
        except OSError as error:
            raise StoreError(
                f"--output {folder}: cannot be written: {error.strerror or error}"
            ) from error
        _refuse_other_format(folder)

    def write_cell(self, result: CellResult) -> Path:
        """Store a cell's record, replacing an older one of the same key and status.

        A failure takes nothing from a result, and a result takes the failure's file away.

        Raises:
            StoreError: it cannot be written, as on a full disk; what was there stands.
        """
        key, ok = result.cell.key, result.status == "ok"
        path = cell_file(self.folder, key, ok=ok)
        with shared(self.folder):
            write_checked(path, cell_content(result))
            if ok:
                cell_file(self.folder, key, ok=False).unlink(missing_ok=True)
        return path

    def set_aside(self, path: Path) -> None:
        """Rename a damaged file to ``<name>.damaged``, so that nobody reads it any more.

        A file that has been written anew since keeps its name.

        Args:
            path: of a cell's own file or a pack, as `DamagedFile` has it.

        Raises:
            StoreError: it cannot be renamed.
        """
        with shared(self.folder):
            if path.suffix == ".json" and not _is_damaged(path):  # a pack is never written anew
                return
            try:
                with suppress(FileNotFoundError):  # another run was sooner
                    path.rename(path.with_name(f"{path.name}.damaged"))
            except OSError as error:
                raise StoreError(f"{path}: cannot be renamed: {error.strerror or error}") from error

    def write_manifest(self, manifest: RunManifest) -> Path:
        """Store a run's manifest, replacing an older state of it."""
        path = self.folder / "runs" / f"{manifest.run_id}.json"
        write_checked(path, fields_of(manifest))
        return path

    def write_data(self, data: BenchmarkData) -> None:
        """Store the samples that results belong to, once."""
        write_data(self.folder / "data", data, data.sha256)

    def read_cell(self, key: str) -> CellResult:
        """Read a cell's result.

        Raises:
            StoreError: there is none, or the folder is damaged.
        """
        for result in stored_results(self.folder, {key}):
            if result.status == "ok":
                return result
        raise StoreError(f"{self.folder}: holds no result of the cell {key}")

    def loose(self, key: str) -> CellResult | None:
        """Return a result that stands in a file of its own now, as one that was just computed."""
        path = cell_file(self.folder, key, ok=True)
        with suppress(StoreError):
            return read_cell_file(path) if path.exists() else None
        return None

    def find(self, keys: Set[str], report: Report) -> Iterator[CellResult]:
        """Yield what is stored of some cells; see `stored_results`."""
        return stored_results(self.folder, keys, report)

    def read_manifest(self, run_id: str) -> RunManifest:
        """Read a run's manifest.

        Raises:
            StoreError: there is none, or it is damaged.
        """
        return _manifest(self.folder / "runs" / f"{run_id}.json")


def read_results(folder: Path) -> Iterator[CellResult]:
    """Yield every cell of a folder once, failed and skipped ones too, in the order of their keys.

    Raises:
        StoreError: a file cannot be read or is damaged.
    """
    yield from sorted(stored_results(folder), key=lambda one: one.cell.key)


def stored_results(
    folder: Path, keys: Set[str] | None = None, report: Report | None = None
) -> Iterator[CellResult]:
    """Yield what is stored of some cells, each once, in no particular order, a pack at a time.

    Nobody can pack the folder before the last one is taken or the iterator is closed.

    Args:
        folder: of the results; it may be one that cannot be written.
        keys: of the cells; None: all.
        report: is told of files that cannot be read or are damaged, which stand for nothing; None:
            the first is raised.

    Raises:
        StoreError: a file cannot be read or is damaged, and nobody asked for a report.
    """
    tell = report or _raise
    counting = CountingRecords(keys)
    with shared(folder):
        yield from counting.results(_loose(folder, counting, tell))
        for pack in _packs(folder, tell):
            yield from counting.results(_packed(pack, counting, tell))
        yield from counting.failures()


def _loose(folder: Path, counting: CountingRecords, tell: Report) -> Iterator[CellResult]:
    for path in loose_files(folder):
        key = key_of(path)
        if counting.may_count(key, ok=not is_failure(path)):
            # a run may have put a result in the place of a failure since the folder was listed
            there = path if path.exists() else cell_file(folder, key, ok=True)
            try:
                yield read_cell_file(there)
            except StoreError as error:
                tell(error)


def _packed(pack: Pack, counting: CountingRecords, tell: Report) -> Iterator[CellResult]:
    keys = enumerate(zip(pack.keys, pack.ok, strict=True))
    rows = [row for row, (key, ok) in keys if counting.may_count(key, ok=ok)]
    if rows:
        try:
            yield from pack.results(rows)
        except StoreError as error:
            tell(error)


def stored_keys(folder: Path, report: Report | None = None) -> dict[str, bool]:
    """Return which cells are stored: key -> whether with a result, not with a failure alone.

    Only names and the packs' columns of keys are read; a cell whose own file is damaged counts.

    Args:
        folder: of the results.
        report: is told of damaged packs; None: the first is raised.

    Raises:
        StoreError: a pack cannot be read or is damaged, and nobody asked for a report.
    """
    found: dict[str, bool] = {}
    with shared(folder):
        for path in loose_files(folder):
            found[key_of(path)] = found.get(key_of(path), False) or not is_failure(path)
        for pack in _packs(folder, report or _raise):
            for key, ok in zip(pack.keys, pack.ok, strict=True):
                found[key] = found.get(key, False) or ok
    return found


def read_manifests(folder: Path) -> Iterator[RunManifest]:
    """Yield every run's manifest of a folder, in the order of their names.

    Raises:
        StoreError: a file cannot be read or is damaged.
    """
    for path in json_files(folder / "runs"):
        yield _manifest(path)


def _packs(folder: Path, tell: Report) -> Iterator[Pack]:
    """Yield the packs, the newest first."""
    if not (folder / "packs").is_dir():
        return
    from stiff_bench.packs import pack_files, read_pack  # pyarrow takes 0.2 s to import

    for path in pack_files(folder):
        try:
            pack = read_pack(path)
        except StoreError as error:
            tell(error)
        else:
            yield pack


def _is_damaged(path: Path) -> bool:
    """Say whether a cell's own file is there and damaged."""
    try:
        read_cell_file(path)
    except DamagedFile:
        return True
    except StoreError:
        return False
    return False


def _raise(error: StoreError) -> None:
    raise error


def _refuse_other_format(folder: Path) -> None:
    """Keep new results out of a folder of another format: nobody could read both."""
    for path in islice(json_files(folder / "cells"), 1):
        with suppress(OSError, ValueError, KeyError, TypeError):  # a damaged file is found later
            schema = orjson.loads(read_plain(path))["schema"]
            if schema != SCHEMA:
                raise StoreError(
                    f"--output {folder}: holds results of format {schema}, this stiffbench writes "
                    f"{SCHEMA}; give a new folder"
                )


def _manifest(path: Path) -> RunManifest:
    content = read_checked(path)
    try:
        return RunManifest(**{**content, "cells": tuple(content["cells"])})
    except (KeyError, TypeError) as error:
        raise DamagedFile(path, f"{type(error).__name__}: {error}") from error
