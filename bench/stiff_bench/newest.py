"""Which of several results of one contest count: those of the newest run.

A folder may hold results of several runs, of several versions of stiffbench, of other splits under
one name. They never mix: what contradicts the newest is left out, and is said. A run's name begins
with its time, so that names sort by it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import takewhile

from stiff_bench.grouped import grouped
from stiff_protocols.record import CellResult

Slot = tuple[int, str]
"""A split: its number and the hash of its rows."""


def slot_of(result: CellResult) -> Slot:
    """Return the split that a result is of."""
    return result.cell.split_index, result.cell.split_sha256


def newest_first(results: Iterable[CellResult]) -> list[CellResult]:
    """Return the results by run, the newest first; of one run, what succeeded before what failed.

    Equals stay in their order, which is that of their keys where a folder was read.
    """
    return sorted(results, key=lambda one: (one.run_id, one.status == "ok"), reverse=True)


def of_newest_splits(results: Sequence[CellResult]) -> tuple[list[CellResult], list[str]]:
    """Return the results of one contest that share the newest run's splits, and what is left out.

    Two splits of one number show that the data were divided in two ways (another version of the
    protocol). Then the newest run's splits count, with those of each run that shares a split with
    them and has none of another division. Who shares none may be of either, and is left out too.
    """
    if len({slot_of(one) for one in results}) == len({one.cell.split_index for one in results}):
        return list(results), []
    by_run = grouped(newest_first(results), lambda result: result.run_id)
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


def of_newest_options(results: Sequence[CellResult]) -> tuple[list[CellResult], list[str]]:
    """Return a model's results with the options of its newest one, and what is left out.

    A name holds the options that differ from their defaults; one name has other options where a
    default, or a file that an option names, was changed.
    """
    options = newest_first(results)[0].cell.model_params
    same = [result for result in results if result.cell.model_params == options]
    differing = sorted(
        {
            option
            for result in results
            for option in {*options, *result.cell.model_params}
            if options.get(option) != result.cell.model_params.get(option)
        }
    )
    if not differing:
        return same, []
    model = results[0].shown.model
    return same, [f"older results of {model} with other options ({', '.join(differing)})"]


def counting(results: Sequence[CellResult], coverages: Sequence[float]) -> CellResult:
    """Return which of a model's results on one split counts.

    The newest run's, also where it failed; but a model that was skipped on some machine does not
    lose what another machine computed. Results differ in their intervals alone, and those with
    intervals stand before those without.

    Args:
        results: at least one.
        coverages: of intervals, in the order of preference.
    """
    run = [result for result in newest_first(results) if result.status != "skipped"]
    valid = list(takewhile(lambda result: result.status == "ok", run))
    if not valid:
        return (run or newest_first(results))[0]

    def preference(result: CellResult) -> int:
        coverage = result.cell.coverage
        return len(coverages) if coverage is None else coverages.index(coverage)

    return min(valid, key=preference)
