"""Select the results of the newest run for each comparison.

A folder may contain results of several runs, versions of stiffbench, and splits with one name. They
never mix: results that contradict the newest run are left out with a note. A run's name
begins with its time, so that names sort by it. A result belongs to the newest run that requested
its cell, also if an earlier run computed it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from stiff_bench.store.names import grouped
from stiff_protocols.contract.record import CellResult, RunManifest

Slot = tuple[int, str]
"""A split: its number and the hash of its rows."""


def slot_of(result: CellResult) -> Slot:
    """Return the split that a result is of."""
    return result.cell.split_index, result.cell.split_sha256


@dataclass(frozen=True)
class Runs:
    """The run of each result, and the order of the first requests.

    Attributes:
        newest: key of a cell -> the newest run that requested it.
        first_requested: key of a cell -> its place among all cells in the order of requests.
    """

    newest: Mapping[str, str]
    first_requested: Mapping[str, int]

    @classmethod
    def of(cls, manifests: Iterable[RunManifest]) -> Runs:
        """Return the runs of a folder's manifests."""
        in_order = sorted(manifests, key=lambda run: run.run_id)
        newest = {key: run.run_id for run in in_order for key in run.cells}
        return cls(newest, {key: place for place, key in enumerate(newest)})

    def run_of(self, result: CellResult) -> str:
        """Return the newest run that requested or computed a result."""
        return max(self.newest.get(result.cell.key, ""), result.run_id)

    def newest_first(self, results: Iterable[CellResult]) -> list[CellResult]:
        """Return results by run, the newest first; of one run, what succeeded before what failed.

        What that run computed comes before what it found computed. Equals stay in their order.
        """

        def age(result: CellResult) -> tuple[str, str, bool]:
            return self.run_of(result), result.run_id, result.status == "ok"

        return sorted(results, key=age, reverse=True)


def of_newest_splits(
    results: Sequence[CellResult], runs: Runs
) -> tuple[list[CellResult], list[str]]:
    """Return the results of one comparison with the newest run's splits, and a note.

    Two splits of one number show that the data were divided in two ways (another version of the
    protocol). Then the newest run's splits count, with splits of older runs that share some of them
    and contradict none.
    """
    slots = {*map(slot_of, results)}
    if len(slots) == len(dict(slots)):
        return list(results), []
    newest_splits: dict[int, str] = {}
    for of_run in grouped(runs.newest_first(results), runs.run_of).values():
        splits = dict(map(slot_of, of_run))
        shared = newest_splits.keys() & splits.keys()
        if not newest_splits or (
            shared and all(newest_splits[index] == splits[index] for index in shared)
        ):
            newest_splits |= splits
    same = [result for result in results if slot_of(result) in newest_splits.items()]
    without = sorted({r.presentation.model for r in results} - {r.presentation.model for r in same})
    models = f" (all of {', '.join(without)})" if without else ""
    return same, [f"older results on other splits than those of the newest run{models}"]


def of_newest_options(
    results: Sequence[CellResult], newest: CellResult
) -> tuple[list[CellResult], list[str]]:
    """Return a model's results with options and version of its newest one, and notes.

    A name contains only the options that differ from their defaults. The same name has other
    options if a default, or a file that an option names, was changed.
    """
    cell, name = newest.cell, newest.presentation.model
    intervals = {0, max(result.cell.interval_version for result in results)}  # 0: no intervals
    same = [
        result
        for result in results
        if result.cell.model_version == cell.model_version
        and result.cell.interval_version in intervals
    ]
    notes = [f"older results of {name} by another version of it"] * (len(same) < len(results))
    options = cell.model_params
    alike = [result for result in same if result.cell.model_params == options]
    differing = {
        option
        for result in same
        for option in {*options, *result.cell.model_params}
        if options.get(option) != result.cell.model_params.get(option)
    }
    if differing:
        notes.append(f"older results of {name} with other options ({', '.join(sorted(differing))})")
    return alike, notes


def select_result(results: Sequence[CellResult], runs: Runs) -> CellResult:
    """Return the result to use among a model's results on one split.

    It is the newest run's result, also if it failed. A skipped result does not replace a result
    of another machine. The results differ only in their intervals: a result with intervals is
    preferred, then newer intervals.
    """
    newest_first = runs.newest_first(results)
    tried = [result for result in newest_first if result.status != "skipped"]
    if not tried or tried[0].status != "ok":
        return (tried or newest_first)[0]
    done = [result for result in tried if result.status == "ok"]
    return next((result for result in done if result.cell.coverage is not None), done[0])
