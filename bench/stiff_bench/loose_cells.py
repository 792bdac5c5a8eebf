"""Cells in files of their own.

::

    OUTPUT/cells/<key>.json          a result
    OUTPUT/cells/<key>.failed.json   why a cell failed or was skipped
    OUTPUT/cells/*.json.damaged      set aside: nobody reads it
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from stiff_bench.cell_content import cell_result
from stiff_bench.checked_json import DamagedFile, read_checked
from stiff_protocols.errors import DataError
from stiff_protocols.record import CellResult

_FAILED = ".failed"


def cell_file(folder: Path, key: str, *, ok: bool) -> Path:
    """Return where a cell's result, or its failure, has a file of its own."""
    return folder / "cells" / f"{key}{'' if ok else _FAILED}.json"


def loose_files(folder: Path) -> list[Path]:
    """Return the cells' own files, results before failures."""
    return sorted(json_files(folder / "cells"), key=is_failure)


def json_files(folder: Path) -> Iterator[Path]:
    """Yield the stored files of a folder by name, none where there is no folder.

    A name that begins with a dot is a temporary file's: of a run that writes it now, or was killed.
    """
    names = sorted(os.listdir(folder)) if folder.is_dir() else []
    for name in names:
        if name.endswith(".json") and not name.startswith("."):
            yield folder / name


def key_of(path: Path) -> str:
    """Return the key of a cell by the name of its file."""
    return path.name.partition(".")[0]


def is_failure(path: Path) -> bool:
    """Say whether a cell's own file says why it failed, or was skipped."""
    return path.stem.endswith(_FAILED)


def read_cell_file(path: Path) -> CellResult:
    """Read a cell's own file.

    Raises:
        DamagedFile: it is damaged.
        StoreError: it cannot be read, or is of another format.
    """
    content = read_checked(path)
    try:
        result = cell_result(content)
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError, DataError) as error:
        raise DamagedFile(path, f"{type(error).__name__}: {error}") from error
    if result.cell.key != key_of(path):
        raise DamagedFile(path, f"holds the cell {result.cell.key}, which is another one's file")
    if (result.status == "ok") == is_failure(path):
        raise DamagedFile(path, f"its status is {result.status!r}")
    return result
