"""Which of several results of one case count: those of the newest run.

A folder may hold results of several runs, of several versions of stiffbench, of other splits under
one name. They never mix: what contradicts the newest is left out, and is said. A run's name begins
with its time, so that names sort by it. A result is of the newest run that was asked for its cell,
also where that run found it computed: a resumed run stands for all that it resumed. Of one cell
there is one record (`database.py`): one that fails when it is computed again keeps its result.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile

from stiff_bench.store.names import grouped
from stiff_protocols.contract.record import Cell, CellResult, RunManifest

Slot = tuple[int, str]
"""A split: its number and the hash of its rows."""


def slot_of(result: CellResult) -> Slot:
    """Return the split that a result is of."""
    return result.cell.split_index, result.cell.split_sha256


@dataclass(frozen=True)
class Runs:
    """Which run a result is of, and when it was first asked for.

    Attributes:
        newest: key of a cell -> the newest run that was asked for it.
        first_asked: key of a cell -> its place among all cells in the order of asking.
    """

    newest: Mapping[str, str]
    first_asked: Mapping[str, int]

    @classmethod
    def of(cls, manifests: Iterable[RunManifest]) -> Runs:
        """Return what a folder's manifests say."""
        in_order = sorted(manifests, key=lambda run: run.run_id)
        newest = {key: run.run_id for run in in_order for key in run.cells}
        return cls(newest, {key: place for place, key in enumerate(newest)})

    def run_of(self, result: CellResult) -> str:
        """Return the newest run that was asked for a result, or made it."""
        return max(self.newest.get(result.cell.key, ""), result.run_id)

    def newest_first(self, results: Iterable[CellResult]) -> list[CellResult]:
        """Return results by run, the newest first; of one run, what succeeded before what failed.

        What that run computed comes before what it found computed. Equals stay in their order,
        which is that of their keys where a folder was read.
        """

        def age(one: CellResult) -> tuple[str, str, bool]:
            return self.run_of(one), one.run_id, one.status == "ok"

        return sorted(results, key=age, reverse=True)


def of_newest_splits(
    results: Sequence[CellResult], runs: Runs
) -> tuple[list[CellResult], list[str]]:
    """Return the results of one case that share the newest run's splits, and what is left out.

    Two splits of one number show that the data were divided in two ways (another version of the
    protocol). Then the newest run's splits count, with those of each run that shares a split with
    them and has none of another division. Who shares none may be of either, and is left out too.
    """
    slots = {*map(slot_of, results)}
    if len(slots) == len(dict(slots)):
        return list(results), []
    by_run = grouped(runs.newest_first(results), runs.run_of)
    splits = [dict(sorted(map(slot_of, found))) for found in by_run.values()]
    kept = splits[0]
    while joining := [more for more in splits if _continues(kept, more)]:
        kept = kept | joining[0]
    same = [result for result in results if slot_of(result) in kept.items()]
    models = sorted({r.shown.model for r in results} - {r.shown.model for r in same})
    lacking = f" (all of {', '.join(models)})" if models else ""
    return same, [f"older results on other splits than those of the newest run{lacking}"]


def _continues(kept: Mapping[int, str], more: Mapping[int, str]) -> bool:
    """Say whether splits (number -> hash) overlap with others, agree with them and add to them."""
    shared = kept.keys() & more.keys()
    agree = all(kept[index] == more[index] for index in shared)
    return bool(shared) and agree and not more.keys() <= kept.keys()


def of_newest_options(
    results: Sequence[CellResult], newest: Cell
) -> tuple[list[CellResult], list[str]]:
    """Return a model's results with options and version of its newest one, and what is left out.

    A name holds the options that differ from their defaults; one name has other options where a
    default, or a file that an option names, was changed.
    """
    model = results[0].shown.model
    versions = dict[bool, int]()  # results with intervals have scoring versions of their own
    for cell in (result.cell for result in results):
        kind = cell.coverage is None
        versions[kind] = max(versions.get(kind, 0), cell.scoring_version)
    versions[newest.coverage is None] = newest.scoring_version
    same = [
        result
        for result in results
        if result.cell.model_version == newest.model_version
        and result.cell.scoring_version == versions[result.cell.coverage is None]
    ]
    notes = []
    if len(same) < len(results):
        notes.append(f"older results of {model} by another version of it")
    options = newest.model_params
    alike = [result for result in same if result.cell.model_params == options]
    if len(alike) < len(same):
        differing = sorted(
            {
                option
                for result in same
                for option in {*options, *result.cell.model_params}
                if options.get(option) != result.cell.model_params.get(option)
            }
        )
        notes.append(f"older results of {model} with other options ({', '.join(differing)})")
    return alike, notes


def counting(results: Sequence[CellResult], coverages: Sequence[float], runs: Runs) -> CellResult:
    """Return which of a model's results on one split counts.

    The newest run's, also where that failed and an older run's cell, of another key, did not; but a
    model that was skipped on some machine does not lose what another machine computed. Results
    differ in their intervals alone: those with intervals stand before those without, by the order
    of their coverages in `coverages`.
    """
    if len(results) == 1:
        return results[0]
    in_order = runs.newest_first(results)
    run = [result for result in in_order if result.status != "skipped"]
    valid = list(takewhile(lambda result: result.status == "ok", run))
    if not valid:
        return (run or in_order)[0]

    def preference(result: CellResult) -> int:
        coverage = result.cell.coverage
        return len(coverages) if coverage is None else coverages.index(coverage)

    return min(valid, key=preference)
