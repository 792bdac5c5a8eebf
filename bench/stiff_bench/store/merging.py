"""Merge the results of several machines into one folder."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from stiff_bench.console import printable
from stiff_bench.parameter_types import Folder, Form
from stiff_bench.store.database import (
    ResultStore,
    has_results,
    read_manifests,
    read_results,
    stored_rows,
    why_no_results,
    write_row,
    write_run,
    writing,
)
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.record import FitResult

ROUNDING_M = 1e-9
"""Largest difference between two predictions of one fit that is taken for rounding, m."""


@dataclass(frozen=True, repr=False)
class Merged:
    """Counts of a merge.

    Attributes:
        output: the folder that was merged into.
        n_fits, n_there: number of fits in the output, now and before.
        taken: folder -> number of fits that it holds, and that were taken from it.
    """

    output: Path
    n_fits: int
    n_there: int
    taken: dict[Path, tuple[int, int]]

    @property
    def report(self) -> list[str]:
        """Return the counts as lines of text."""
        note = "; the others are stored already"
        lines = [
            f"{folder}: {n_taken} of {n_fits} results taken{note if n_taken < n_fits else ''}"
            for folder, (n_fits, n_taken) in self.taken.items()
        ]
        return [*lines, f"{self.n_fits} results in {self.output}, {self.n_there} from before"]

    def __repr__(self) -> str:
        return printable("\n".join(self.report))


def merge(folders: Annotated[Sequence[Path | str], Form("DIR...")], output: Folder) -> Merged:
    """Merge the results of several machines into one folder.

    Folders with different numbers for the same fit are refused. The merge is one transaction: all
    of it, or nothing.

    Args:
        folders: folders of results; they are not changed.
        output: folder to merge into: new, or with results; it may be one of the folders.

    Raises:
        ConfigError: two folders have different numbers of one fit.
        StoreError: a folder holds no results, or `output` cannot be written.
    """
    return merge_fits([*map(Path, folders)], Path(output))


def merge_fits(
    folders: Sequence[Path], output: Path, keys: Collection[str] | None = None
) -> Merged:
    """Merge fits with their runs and data.

    The key of a fit contains everything that determines its numbers. A fit that is stored already
    is therefore left out; only a result replaces a failure.

    Args:
        folders: folders of results.
        output: folder to merge into.
        keys: keys of the fits to take; None: all.

    Raises:
        ConfigError: two folders have different numbers of one fit.
        StoreError: a folder holds no results, or `output` cannot be written.
    """
    inputs = {folder: read_results(folder, keys) for folder in _inputs(folders, output)}
    ResultStore(output)
    with writing(output) as db:
        # the transaction keeps other writers out, so what is read here stays as it is
        stored = {result.fit.key: (output, result) for result in read_results(output)}
        runs = {run.run_id: run for run in read_manifests(output)}
        n_there, taken = len(stored), {}
        for folder, results in inputs.items():
            new = [result for result in results if _is_new(folder, result, stored)]
            for result in new:
                write_row(db, result)
                stored[result.fit.key] = (folder, result)
            taken[folder] = (len(results), len(new))
            needed = {result.fit.data_sha256 for result in results}
            needed |= {result.fit.source_sha256 for result in results}
            data = stored_rows(folder, "SELECT * FROM data")
            data = [row for row in data if keys is None or row[0] in needed]
            db.executemany("INSERT OR IGNORE INTO data VALUES (?, ?, ?)", data)
            run_ids = {result.run_id for result in results}
            for run in read_manifests(folder):
                if keys is not None and run.run_id not in run_ids:
                    continue
                there = runs.get(run.run_id, run)
                # of a run that was copied while it ran: finished < interrupted < running
                runs[run.run_id] = min(there, run, key=lambda manifest: manifest.status)
        for run in runs.values():
            write_run(db, run)
    return Merged(output, len(stored), n_there, taken)


def _inputs(folders: Sequence[Path], output: Path) -> list[Path]:
    """Return each folder once, without the output."""
    for folder in folders:
        if not has_results(folder):
            raise StoreError(
                f"{folder}: {why_no_results(folder)} (valid: an output of `bench run`)"
            )
    different = {folder.resolve(): folder for folder in folders}
    different.pop(output.resolve(), None)
    if not different:
        raise ConfigError(f"{output}: is the only folder given; name one to take from", "output")
    return list(different.values())


def _is_new(folder: Path, result: FitResult, stored: dict[str, tuple[Path, FitResult]]) -> bool:
    """Check whether a result must be stored.

    Raises:
        ConfigError: another result of this fit is stored, with stored_result numbers.
    """
    key, labels = result.fit.key, result.presentation
    if key not in stored:
        return True
    other_folder, stored_result = stored[key]
    if stored_result.prediction is None:
        return result.status == "ok" or result.run_id > stored_result.run_id
    if result.prediction is not None:
        difference = np.abs(result.prediction.predicted - stored_result.prediction.predicted).max()
        if difference > ROUNDING_M:
            raise ConfigError(
                f"{folder} and {other_folder} have different numbers of one fit: {labels.model} on "
                f"{labels.dataset}, {labels.protocol}, split {result.fit.split_index} ({key}), up "
                f"to {difference:.1e} m apart; nothing was merged: leave one folder out, or "
                "compute it again there with --rerun all"
            )
    return False
