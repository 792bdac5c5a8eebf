"""The runs behind a page, and the cells that failed or were skipped, with reasons and logs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import chain

from stiff_bench.analysis.collected import Case, case_name_of
from stiff_bench.report.html_page import FEW_ROWS, Block
from stiff_bench.report.score_blocks import Asked
from stiff_bench.store.names import grouped
from stiff_bench.store.newest import slot_of
from stiff_bench.store.versions import NO_MANIFEST
from stiff_bench.tables.fit_notes import failure_lines
from stiff_bench.tables.table import Column, Entry, Table
from stiff_bench.tables.units import counted
from stiff_protocols.contract.record import CellResult, RunManifest

MOST_ENVIRONMENTS = 10


def run_block(
    runs: Sequence[RunManifest], cases: Iterable[Case], provenance: Sequence[str], hashes: Table
) -> Block:
    """Return the runs of a folder, the newest first, and how many results of the cases are theirs.

    `provenance` are the lines that stand beneath the leaderboard; `hashes` are those of the data.
    """
    counts = Counter(
        result.run_id
        for case in cases
        for competitor in case.competitors.values()
        for result in competitor.done.values()
    )
    newest = sorted(runs, key=lambda run: run.run_id, reverse=True)
    rows: list[list[Entry]] = [_row(run, counts.pop(run.run_id, 0)) for run in newest]
    if counts:
        rows.append([NO_MANIFEST, *[None] * 4, counts.total(), *[None] * 6])
    notes = [*provenance]
    if any(run.environment.get("dirty") == "true" for run in runs):
        notes.append("A commit with + had uncommitted changes: its results cannot be made again.")
    columns = [
        *(Column(name, "text") for name in ("run", "started (UTC)", "state")),
        Column("wall time", unit="s", format=".0f"),
        *(Column("results asked for"), Column("results shown")),
        *(Column(name, "text") for name in ("stiffbench", "commit", "Python", "processor")),
        *(Column("cores"), Column("GPU", "text")),
    ]
    commands = "\n".join(dict.fromkeys(run.command for run in newest))
    folds = [("Commands that made these results, newest first", commands)] if runs else []
    return Block(
        "Provenance",
        tables=[Table("Runs", columns, rows, notes), hashes],
        folds=[*folds, *_environments(newest)],
        is_detail=True,
    )


def _row(run: RunManifest, n_results: int) -> list[Entry]:
    about = run.environment
    changed = "+" if about.get("dirty") == "true" else ""
    machines = f" and {counted(len(run.machines), 'other machine')}" if run.machines else ""
    processor = about.get("processor") or ("unknown" if machines else "")
    cores = about.get("cores", "")
    return [
        *(run.run_id, run.started, run.status, run.wall_s or None),
        *(len(run.cells), n_results, about.get("stiffbench") or None),
        f"{about.get('commit', '')[:12]}{changed}" or None,
        *(about.get("python") or None, f"{processor}{machines}" or None),
        int(cores) if cores.isdecimal() else cores or None,
        about.get("gpu") or None,
    ]


def _environments(runs: Sequence[RunManifest]) -> list[tuple[str, str]]:
    """Return each environment once, with the runs that had it."""
    folds = []
    for text, same in [*grouped(runs, _environment).items()][:MOST_ENVIRONMENTS]:
        more = f" and {counted(len(same) - 1, 'more run')}" if len(same) > 1 else ""
        folds.append((f"Versions and machine of {same[0].run_id}{more}", text))
    return folds


def _environment(run: RunManifest) -> str:
    of_machines = {"": run.environment}
    of_machines |= {f"machine {name}\n": one for name, one in sorted(run.machines.items())}
    return "\n\n".join(
        head + "\n".join(f"{name}: {value}" for name, value in about.items())
        for head, about in of_machines.items()
    )


MOST_LOGS = 40
LONGEST_REASON = 2000  # characters
LONGEST_SPLITS = 60
LONGEST_LOG = 8000


def failure_blocks(asked: Asked) -> list[Block]:
    """Return a block of the failures that count, like ones in one row; [] where nothing failed.

    Skipped fits are one line per reason, such as a package that is not installed.
    """
    competitors = chain.from_iterable(asked.values())
    found = sorted(
        (failure for competitor in competitors for failure in competitor.failures.values()),
        key=lambda one: (one.shown.model, case_name_of(one), slot_of(one)),
    )
    if not found:
        return []
    skipped = failure_lines(failure for failure in found if failure.status == "skipped")
    found = [failure for failure in found if failure.status != "skipped"]
    alike = grouped(
        found,
        lambda one: (one.shown.model, case_name_of(one), one.status, one.cause, one.failure),
    )
    header = ("model", "status", "reason", "cause", "data set", "protocol", "condition", "splits")
    logs = [one for one in found if one.log]
    cut = [f"The first {MOST_LOGS} of {len(logs)} logs are shown."]
    table = Table(
        f"{counted(len(found), 'fit')} without a result",
        [Column(name, "text") for name in header],
        [_failure_row(members) for members in alike.values()],
        cut if len(logs) > MOST_LOGS else [],
    )
    folds = [_fold(failure) for failure in logs[:MOST_LOGS]]
    is_long = len(table.rows) > FEW_ROWS
    tables = [table] if found else []
    return [Block("Failed and skipped", skipped, tables, folds=folds, is_detail=is_long)]


def _failure_row(members: Sequence[CellResult]) -> list[Entry]:
    first = members[0]
    shown = first.shown
    return [
        *(shown.model, first.status, _cut(first.failure, LONGEST_REASON), first.cause or None),
        *(shown.dataset, shown.protocol, first.cell.condition or None),
        _cut(", ".join(str(one.cell.split_index) for one in members), LONGEST_SPLITS),
    ]


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:longest]} ... (cut)"


def _fold(one: CellResult) -> tuple[str, str]:
    place = " | ".join(filter(None, (one.shown.dataset, one.shown.protocol, one.cell.condition)))
    summary = f"Log of {one.shown.model} on {place}, split {one.cell.split_index}"
    text = "\n".join(one.log)
    return (summary, text if len(text) <= LONGEST_LOG else f"(cut) {text[-LONGEST_LOG:]}")
