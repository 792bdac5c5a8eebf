"""Joins the results of several machines in one folder."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator, Sequence, Set
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from stiff_bench.checked_json import read_checked, write_checked
from stiff_bench.folder_lock import alone
from stiff_bench.loose_cells import json_files
from stiff_bench.merge_survey import (
    Disagreement,
    FolderSurvey,
    Kind,
    disagreements,
    survey,
)
from stiff_bench.packing import ENOUGH_TO_PACK
from stiff_bench.packs import CELLS_A_PACK, write_pack
from stiff_bench.store import ResultStore, stored_results
from stiff_bench.stored_data import is_whole, read_data
from stiff_protocols.errors import ConfigError, StoreError
from stiff_protocols.files import make_folder, written_whole
from stiff_protocols.record import CellResult


class Disagreeing(ConfigError):
    """The folders contradict each other, and nobody said that they may.

    Attributes:
        found: where.
    """

    def __init__(self, message: str, found: Sequence[Disagreement]) -> None:
        """Store both."""
        super().__init__(message)
        self.found = tuple(found)


@dataclass(frozen=True)
class Merged:
    """What became of a merge.

    Attributes:
        n_cells: of the output now.
        n_there: how many of them were there before.
        taken: folder -> how many cells it holds, and how many were taken from it.
        n_other_numbers: cells of which several folders have results with different numbers.
        damaged: one line for each file that was left out.
        disagreements: that were allowed.
    """

    n_cells: int
    n_there: int
    taken: dict[Path, tuple[int, int]]
    n_other_numbers: int
    damaged: tuple[str, ...]
    disagreements: tuple[Disagreement, ...]


def merge(folders: Sequence[Path], output: Path, allow: Collection[Kind]) -> Merged:
    """Join the results of folders in `output`, which may exist and hold some, or be one of them.

    Of a cell that is in several of them a result counts over a failure, and then the newest run.
    The folders stay as they are. What is stopped is completed by the same merge again.

    Raises:
        Disagreeing: the folders differ in data, splits or code, and `allow` does not have it.
        StoreError: a folder holds no results, changes meanwhile, or `output` cannot be written.
    """
    inputs = _inputs(folders, output)
    surveys = [survey(folder) for folder in inputs]
    _refuse(disagreements(surveys), allow)
    with _alone(output):
        there = survey(output, surveys)
        found = disagreements([*surveys, there])
        _refuse(found, allow)
        store = ResultStore(output)
        damaged = [line for one in (*surveys, there) for line in one.damaged]
        takes = _chosen(surveys, there)
        for one in surveys:
            damaged += _join_data(one.folder, output)
            _join_manifests(one.folder, output)
        for one, keys in zip(surveys, takes, strict=True):
            _join_cells(one, keys, store, there.records.keys())
    return Merged(
        n_cells=len(set().union(*(one.records for one in (*surveys, there)))),
        n_there=len(there.records),
        taken={
            one.folder: (len(one.records), len(keys))
            for one, keys in zip(surveys, takes, strict=True)
        },
        n_other_numbers=_n_other_numbers([*surveys, there]),
        damaged=tuple(dict.fromkeys(damaged)),
        disagreements=tuple(found),
    )


def _inputs(folders: Sequence[Path], output: Path) -> list[Path]:
    """Return each folder once, without the output."""
    for folder in folders:
        if not (folder / "cells").is_dir():
            raise StoreError(f"{folder}: holds no results; `bench run --output` makes them")
    different = {folder.resolve(): folder for folder in reversed(folders)}
    different.pop(output.resolve(), None)
    if not different:
        raise ConfigError(f"--output {output}: is the only folder given; name one to take from")
    return list(reversed(different.values()))


def _refuse(found: Sequence[Disagreement], allow: Collection[Kind]) -> None:
    refused = [one for one in found if one.kind not in allow]
    if refused:
        kinds = tuple(dict.fromkeys(one.kind for one in refused))
        names = "; ".join(
            f"{kind} of " + ", ".join(one.name for one in refused if one.kind == kind)
            for kind in kinds
        )
        raise Disagreeing(
            f"the folders differ in {names}; nothing was merged "
            f"({' '.join(f'--allow {kind}' for kind in kinds)} merges them all the same)",
            refused,
        )


@contextmanager
def _alone(output: Path) -> Iterator[None]:
    """Keep other merges into a folder out; runs may write there meanwhile."""
    lock = output / ".merge"
    make_folder(lock)
    with ExitStack() as stack:
        try:
            stack.enter_context(alone(lock))
        except StoreError as error:
            raise StoreError(
                f"--output {output}: another merge into it is running, or it cannot be locked: "
                f"{error}"
            ) from error
        yield


def _chosen(surveys: Sequence[FolderSurvey], there: FolderSurvey) -> list[set[str]]:
    """Return the keys of the cells to take from each folder."""
    best = {key: (record, -1) for key, record in there.records.items()}
    for number, one in enumerate(surveys):
        for key, record in one.records.items():
            if key not in best or record.counts_over(best[key][0]):
                best[key] = (record, number)
    takes: list[set[str]] = [set() for _ in surveys]
    for key, (_, number) in best.items():
        if number >= 0:
            takes[number].add(key)
    return takes


def _n_other_numbers(surveys: Sequence[FolderSurvey]) -> int:
    numbers: dict[str, bytes] = {}
    other = set()
    for one in surveys:
        for key, record in one.records.items():
            if record.ok and numbers.setdefault(key, record.numbers) != record.numbers:
                other.add(key)
    return len(other)


def _join_data(folder: Path, output: Path) -> Iterator[str]:
    """Copy the data sets that the output lacks; yield a line for each that is damaged."""
    for path in sorted((folder / "data").glob("[!.]*.npz")):
        if is_whole(output / "data", path.stem):
            continue
        try:
            read_data(folder / "data", path.stem)
        except StoreError as error:
            yield str(error)
        else:
            with written_whole(output / "data" / path.name) as temporary:
                shutil.copyfile(path, temporary)


def _join_manifests(folder: Path, output: Path) -> None:
    """Copy the runs' manifests; of a run that was copied while it ran, its last state counts."""
    for path in json_files(folder / "runs"):
        target = output / "runs" / path.name
        found, other = _manifest(path), _manifest(target)
        if found and (not other or _progress(found) > _progress(other)):
            write_checked(target, found)


def _manifest(path: Path) -> dict[str, object]:
    """Return a manifest's content; an empty one where there is none, or a damaged one."""
    try:
        return read_checked(path)
    except StoreError:
        return {}


def _progress(manifest: dict[str, object]) -> tuple[bool, bool]:
    return manifest.get("status") == "finished", manifest.get("status") == "interrupted"


def _join_cells(taken: FolderSurvey, keys: Set[str], store: ResultStore, there: Set[str]) -> None:
    """Copy cells, many of them as packs.

    Args:
        taken: whose cells.
        keys: of the cells.
        store: to write to.
        there: keys of the cells that are in it, whose records are to be replaced.

    Raises:
        StoreError: the folder changes meanwhile.
    """
    n_copied = 0
    new: list[CellResult] = []
    for result in stored_results(taken.folder, keys, report=lambda _: None):
        n_copied += 1
        if result.cell.key in there:
            store.write_cell(result)  # as a file of its own it counts before a pack's
            continue
        new.append(result)
        if len(new) == CELLS_A_PACK:
            _write(new, store)
            new = []
    _write(new, store)
    if n_copied < len(keys):
        raise StoreError(
            f"{taken.folder}: {len(keys) - n_copied} of its cells cannot be read any more; give "
            "the same command again"
        )


def _write(results: Sequence[CellResult], store: ResultStore) -> None:
    if len(results) < ENOUGH_TO_PACK:
        for result in results:
            store.write_cell(result)
        return
    make_folder(store.folder / "packs")
    with alone(store.folder):
        write_pack(store.folder, results)
