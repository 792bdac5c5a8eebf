"""Cells that failed or were skipped, with their reasons and what they printed last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import islice

from stiff_bench.collected import Contest, asked_for, contest_name_of
from stiff_bench.contest_name import ContestName
from stiff_bench.grouped import grouped
from stiff_bench.newest import Runs, Slot, slot_of
from stiff_bench.render import TextTable
from stiff_bench.report.content import Block, Fold
from stiff_bench.report.sorting import page_table
from stiff_bench.store import stored_results
from stiff_bench.stored_leaderboard import StoredResults
from stiff_bench.words import counted
from stiff_protocols.record import CellResult

MOST_FAILURES = 500
MOST_LOGS = 40
LONGEST_REASON = 2000  # characters
LONGEST_SPLITS = 60
LONGEST_LOG = 8000

Place = tuple[str, ContestName, Slot]
"""Model's name, contest and split: several cells stand there where options or code changed."""


def failure_block(
    stored: StoredResults, contests: Sequence[Contest], models: Sequence[str]
) -> Block:
    """Return the failures that count among some contests.

    Args:
        stored: the folder.
        contests: of it, to show.
        models: words of the command line; none named means all.

    Raises:
        StoreError: a file cannot be read or is damaged.
    """
    reasons = _reasons(contests, models)
    heading = "Failures and skipped cells"
    if not reasons:
        return Block(heading, ["No cell failed and none was skipped."])
    found = _counting(stored, reasons)
    alike = grouped(found, _story)
    shown = [*islice(alike.values(), MOST_FAILURES)]
    header = ("model", "status", "reason", "cause", "data set", "protocol", "condition", "splits")
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


def _reasons(contests: Sequence[Contest], models: Sequence[str]) -> dict[Place, str]:
    """Return why there is no result, for each place that has none."""
    return {
        (name, contest.name, slot): reason
        for contest in contests
        for name, competitor in contest.competitors.items()
        if asked_for(name, models)
        for slot, reason in competitor.reasons.items()
    }


def _counting(stored: StoredResults, reasons: Mapping[Place, str]) -> list[CellResult]:
    """Return the record behind each reason: the newest that says so, by place.

    A place has several records where a model was run again there with other options or code.
    """
    failed = (one for one in stored_results(stored.folder) if one.status != "ok")
    said = [one for one in failed if reasons.get(_place(one)) == f"{one.status}: {one.failure}"]
    newest_first = Runs.of(stored.runs).newest_first(said)
    of_places = sorted(grouped(newest_first, _place).items(), key=lambda item: item[0])
    return [records[0] for _, records in of_places]


def _place(one: CellResult) -> Place:
    return one.shown.model, contest_name_of(one), slot_of(one)


def _story(one: CellResult) -> tuple[object, ...]:
    """Return what cells share that failed alike."""
    model, contest, _ = _place(one)
    return model, contest, one.status, one.cause, one.failure


def _row(members: Sequence[CellResult]) -> list[str]:
    """Return the cells of a row: failures that differ in their splits alone."""
    first = members[0]
    shown = first.shown
    return [
        *(shown.model, first.status, _cut(first.failure, LONGEST_REASON), first.cause or "-"),
        *(shown.dataset, shown.protocol, first.cell.condition or "-"),
        _cut(", ".join(str(one.cell.split_index) for one in members), LONGEST_SPLITS),
    ]


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:longest]} ... (cut)"


def _fold(one: CellResult) -> Fold:
    place = " | ".join(filter(None, (one.shown.dataset, one.shown.protocol, one.cell.condition)))
    summary = f"Log end: {one.shown.model} on {place}, split {one.cell.split_index}"
    text = "\n".join(one.log)
    return Fold(summary, text if len(text) <= LONGEST_LOG else f"(cut) {text[-LONGEST_LOG:]}")
