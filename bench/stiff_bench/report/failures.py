"""Cells that failed or were skipped, with their reasons and what they printed last."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from stiff_bench.collected import Contest, stands_for
from stiff_bench.grouped import grouped
from stiff_bench.newest import Slot, slot_of
from stiff_bench.render import TextTable
from stiff_bench.report.content import Block, Fold
from stiff_bench.report.sorting import page_table
from stiff_bench.store import stored_results
from stiff_bench.words import counted
from stiff_protocols.record import CellResult

MOST_FAILURES = 500
MOST_LOGS = 40
LONGEST_REASON = 2000  # characters
LONGEST_SPLITS = 60
LONGEST_LOG = 8000


def failure_block(folder: Path, contests: Sequence[Contest], models: Sequence[str]) -> Block:
    """Return the failures that count among some contests.

    Args:
        folder: of the results.
        contests: to show.
        models: words of the command line; none named means all.

    Raises:
        StoreError: a file cannot be read or is damaged.
    """
    failed = _counting(contests, models)
    heading = "Failures and skipped cells"
    if not failed:
        return Block(heading, ["No cell failed and none was skipped."])
    found = [one for one in stored_results(folder) if _place(one) in failed]
    alike = grouped(sorted(found, key=_place), _story)
    shown = [*islice(alike.values(), MOST_FAILURES)]
    header = ("model", "data set", "protocol", "condition", "splits", "status", "cause", "reason")
    notes = ["A failed cell is no result: its model has no mean rank; the others count."]
    if len(shown) < len(alike):
        notes.append(f"The first {len(shown)} of {len(alike)} rows are shown.")
    logs = [one for members in shown for one in members if one.log]
    folds = [_fold(one) for one in logs[:MOST_LOGS]]
    if len(logs) > MOST_LOGS:
        notes.append(f"The first {MOST_LOGS} of {len(logs)} log ends are shown.")
    table = TextTable(
        f"{counted(len(found), 'cell')} without a result",
        header,
        [_row(members) for members in shown],
        notes,
    )
    return Block(heading, tables=[page_table(table)], folds=folds)


def _counting(contests: Sequence[Contest], models: Sequence[str]) -> set[tuple[object, ...]]:
    """Return the places whose newest record is no result."""
    return {
        (name, contest.name.dataset, contest.name.protocol, contest.name.condition, slot)
        for contest in contests
        for name, competitor in contest.competitors.items()
        if not models or any(stands_for(word, name) for word in models)
        for slot in competitor.reasons
    }


def _place(one: CellResult) -> tuple[str, str, str, str, Slot]:
    shown = one.shown
    if one.status == "ok":
        return "", "", "", "", (-1, "")
    return shown.model, shown.dataset, shown.protocol, one.cell.condition, slot_of(one)


def _story(one: CellResult) -> tuple[str, ...]:
    """Return what cells share that failed alike."""
    shown = one.shown
    place = (shown.model, shown.dataset, shown.protocol, one.cell.condition)
    return (*place, one.status, one.cause, one.failure)


def _row(members: Sequence[CellResult]) -> list[str]:
    """Return the cells of a row: failures that differ in their splits alone."""
    first = members[0]
    shown = first.shown
    return [
        *(shown.model, shown.dataset, shown.protocol, first.cell.condition or "-"),
        _cut(", ".join(str(one.cell.split_index) for one in members), LONGEST_SPLITS),
        *(first.status, first.cause or "-", _cut(first.failure, LONGEST_REASON)),
    ]


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:longest]} ... (cut)"


def _fold(one: CellResult) -> Fold:
    place = " | ".join(filter(None, (one.shown.dataset, one.shown.protocol, one.cell.condition)))
    summary = f"Log end: {one.shown.model} on {place}, split {one.cell.split_index}"
    text = "\n".join(one.log)
    return Fold(summary, text if len(text) <= LONGEST_LOG else f"(cut) {text[-LONGEST_LOG:]}")
