"""Results on disk: each file is written whole or not at all.

::

    OUTPUT/cells/<key>.json        a cell: identity, metric values, predictions, timings
    OUTPUT/cells/<key>.failed.json why it failed or was skipped; never in the place of a result
    OUTPUT/packs/*.parquet         many cells together (see packs.py, packing.py)
    OUTPUT/runs/<run id>.json      a run's manifest
    OUTPUT/data/<sha256>.npz       the samples (see stored_data.py)

A JSON file has a checksum (checked_json.py). Of several records of a cell a file of its own stands
before a pack, and a newer pack before an older one; a result removes the failures before it.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Set
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import orjson

from stiff_bench.cell_content import cell_content, cell_result, fields_of
from stiff_bench.checked_json import read_checked, write_checked
from stiff_bench.folder_lock import make_lock, shared
from stiff_bench.stored_data import write_data
from stiff_protocols.errors import DataError, StoreError
from stiff_protocols.files import read_plain
from stiff_protocols.record import SCHEMA, CellResult, RunManifest
from stiff_protocols.types import BenchmarkData

if TYPE_CHECKING:
    from stiff_bench.packs import Pack

Report = Callable[[StoreError], None]
"""Is told of each damaged file."""

_FAILED = ".failed"


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
        """Store a cell's result, replacing an older one of the same key and status.

        Raises:
            StoreError: it cannot be written, as on a full disk; what was there stands.
        """
        done = self.folder / "cells" / f"{result.cell.key}.json"
        failed = done.with_suffix(f"{_FAILED}.json")
        path = done if result.status == "ok" else failed
        with shared(self.folder):
            write_checked(path, cell_content(result))
            if result.status == "ok":
                failed.unlink(missing_ok=True)
        return path

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
        path = self.folder / "cells" / f"{key}.json"
        with suppress(StoreError):
            return read_cell_file(path) if path.exists() else None
        return None

    def find(self, keys: Set[str], report: Report) -> Iterator[CellResult]:
        """Yield what is stored of some cells; see `stored_results`."""
        return stored_results(self.folder, keys, report)

    def keys(self, report: Report) -> dict[str, bool]:
        """Return the keys of the cells that are stored; see `stored_keys`."""
        return stored_keys(self.folder, report)

    def read_manifest(self, run_id: str) -> RunManifest:
        """Read a run's manifest.

        Raises:
            StoreError: there is none, or it is damaged.
        """
        return _manifest(self.folder / "runs" / f"{run_id}.json")


def read_results(folder: Path) -> Iterator[CellResult]:
    """Yield every cell of a folder, failed and skipped ones too, in the order of their keys.

    Raises:
        StoreError: a file cannot be read or is damaged.
    """
    yield from sorted(stored_results(folder), key=lambda one: (one.cell.key, one.status == "ok"))


def stored_results(
    folder: Path, keys: Set[str] | None = None, report: Report | None = None
) -> Iterator[CellResult]:
    """Yield what is stored of some cells, in no particular order, a pack at a time.

    A cell comes twice where it failed after it had succeeded. Nobody can pack the folder before the
    last one is taken or the iterator is closed.

    Args:
        folder: of the results; it may be one that cannot be written.
        keys: of the cells; None: all.
        report: is told of damaged files, which stand for nothing; None: the first is raised.

    Raises:
        StoreError: a file cannot be read or is damaged, and nobody asked for a report.
    """
    tell = report or _raise
    counting = _Counting()
    with shared(folder):
        for path in loose_files(folder):
            key = _key_of(path)
            if keys is None or key in keys:
                try:
                    result = read_cell_file(path)
                except StoreError as error:
                    tell(error)
                    continue
                if counting.takes(key, ok=result.status == "ok"):
                    yield result
        for pack in _packs(folder, tell):
            rows = [
                row
                for row, (key, ok) in enumerate(zip(pack.keys, pack.ok, strict=True))
                if (keys is None or key in keys) and counting.takes(key, ok=ok)
            ]
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
            found[_key_of(path)] = found.get(_key_of(path), False) or not is_failure(path)
        for pack in _packs(folder, report or _raise):
            for key, ok in zip(pack.keys, pack.ok, strict=True):
                found[key] = found.get(key, False) or ok
    return found


class _Counting:
    """Says of each record, the newest first, whether it counts."""

    def __init__(self) -> None:
        self._seen: dict[str, bool] = {}  # key -> whether a result was seen

    def takes(self, key: str, *, ok: bool) -> bool:
        """Say whether to take a record; behind a result nothing counts, nor a second failure."""
        seen = self._seen.get(key)
        if seen or (seen is not None and not ok):
            return False
        self._seen[key] = ok
        return True


def read_manifests(folder: Path) -> Iterator[RunManifest]:
    """Yield every run's manifest of a folder, in the order of their names.

    Raises:
        StoreError: a file cannot be read or is damaged.
    """
    for path in _stored(folder / "runs"):
        yield _manifest(path)


def loose_files(folder: Path) -> list[Path]:
    """Return the cells' own files; of one cell the failure first, which is the newer."""
    return list(_stored(folder / "cells"))


def read_cell_file(path: Path) -> CellResult:
    """Read a cell's own file.

    Raises:
        StoreError: it cannot be read or is damaged.
    """
    content = read_checked(path)
    try:
        result = cell_result(content)
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError, DataError) as error:
        raise StoreError(f"{path}: damaged: {type(error).__name__}: {error}") from error
    if result.cell.key != _key_of(path):
        raise StoreError(f"{path}: holds the cell {result.cell.key}, which is another one's file")
    if (result.status == "ok") == is_failure(path):
        raise StoreError(f"{path}: damaged: its status is {result.status!r}")
    return result


def _key_of(path: Path) -> str:
    return path.name.partition(".")[0]


def result_file(path: Path) -> Path:
    """Return the file of the result that stands beside a failure's, or is the one that is given."""
    return path.with_name(f"{_key_of(path)}.json")


def is_failure(path: Path) -> bool:
    """Say whether a cell's own file says why it failed, or was skipped."""
    return path.stem.endswith(_FAILED)


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


def _raise(error: StoreError) -> None:
    raise error


def _stored(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder by name, none where there is no folder.

    A name that begins with a dot is a temporary file's: of a run that writes it now, or was killed.
    """
    names = sorted(os.listdir(folder)) if folder.is_dir() else []
    for name in names:
        if name.endswith(".json") and not name.startswith("."):
            yield folder / name


def _refuse_other_format(folder: Path) -> None:
    """Keep new results out of a folder of another format: nobody could read both."""
    for path in islice(_stored(folder / "cells"), 1):
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
        raise StoreError(f"{path}: damaged: {type(error).__name__}: {error}") from error
