"""Moves finished cells from files of their own into packs.

Killed at any moment, nothing is lost and nothing counts twice: a pack is on the disk before the
files that it holds are taken away, and of a cell that is in both one record counts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from stiff_bench.folder_lock import alone
from stiff_bench.loose_cells import loose_files, read_cell_file
from stiff_protocols.errors import StoreError
from stiff_protocols.files import flush_to_disk, make_folder
from stiff_protocols.record import CellResult

ENOUGH_TO_PACK = 1000
"""Fewer files are soon read."""


def pack_if_many(folder: Path) -> int:
    """Pack a folder of results that holds many files, if it can be packed now; say how many."""
    if len(loose_files(folder)) < ENOUGH_TO_PACK:
        return 0
    try:
        return pack(folder)
    except StoreError:  # no locks, or in use: nothing is lost by waiting
        return 0


def pack(folder: Path) -> int:
    """Pack the cells of a folder of results; say how many files were packed.

    Damaged files are left where they are, for `bench run` to report and compute again.

    Raises:
        StoreError: the folder holds no results, cannot be written or locked, or is in use.
    """
    if not (folder / "cells").is_dir():
        raise StoreError(f"{folder}: holds no results; `bench run --output` makes them")
    from stiff_bench.packs import write_pack  # pyarrow takes 0.2 s to import

    with alone(folder):
        _prepare(folder / "packs")
    waiting = deque(loose_files(folder))
    n_packed = 0
    while waiting:
        with alone(folder):  # anew for each pack, so that runs can write between two of them
            batch = _next_batch(waiting)
            if batch:
                write_pack(folder, [*batch.values()])
                _take_away(batch)
        n_packed += len(batch)
    return n_packed


def _prepare(packs: Path) -> None:
    """Make the folder of packs, without what a killed packing left there."""
    make_folder(packs)
    flush_to_disk(packs.parent)
    for path in packs.glob(".*.tmp.parquet"):
        path.unlink()


def _next_batch(waiting: deque[Path]) -> dict[Path, CellResult]:
    """Take files from a queue for one pack and read them."""
    from stiff_bench.packs import BYTES_A_PACK, CELLS_A_PACK

    batch: dict[Path, CellResult] = {}
    n_bytes = 0
    while waiting and len(batch) < CELLS_A_PACK and n_bytes < BYTES_A_PACK:
        path = waiting.popleft()
        with suppress(StoreError):  # damaged, or taken away since
            batch[path] = read_cell_file(path)
            n_bytes += path.stat().st_size
    return batch


def _take_away(paths: Iterable[Path]) -> None:
    try:
        for path in paths:
            path.unlink()
    except OSError as error:
        raise StoreError(f"{error.filename}: cannot be deleted: {error.strerror}") from error
