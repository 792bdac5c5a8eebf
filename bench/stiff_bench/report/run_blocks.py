"""Runs of a page, and failed or skipped cells with reasons and logs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import chain

from stiff_bench.analysis.collected import Case, case_name_of
from stiff_bench.report.html_page import FEW_ROWS, Block
from stiff_bench.report.score_blocks import RequestedModels
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
    """Return the runs of a folder, newest first, with the number of results per run.

    `provenance` are the lines below the leaderboard. `hashes` is the table of the data hashes.
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
        notes.append("A commit with + had uncommitted changes: its results cannot be reproduced.")
    columns = [
        *(Column(name, "text") for name in ("run", "started (UTC)", "state")),
        Column("wall time", unit="s", format=".0f"),
        *(Column("results requested"), Column("results shown")),
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
    """Return each distinct environment with its runs."""
    folds = []
    for text, same in [*grouped(runs, _environment).items()][:MOST_ENVIRONMENTS]:
        more = f" and {counted(len(same) - 1, 'more run')}" if len(same) > 1 else ""
        folds.append((f"Versions and machine of {same[0].run_id}{more}", text))
    return folds


def _environment(run: RunManifest) -> str:
    of_machines = {"": run.environment}
    of_machines |= {
        f"machine {name}\n": environment for name, environment in sorted(run.machines.items())
    }
    return "\n\n".join(
        head + "\n".join(f"{name}: {value}" for name, value in about.items())
        for head, about in of_machines.items()
    )


MOST_LOGS = 40
LONGEST_REASON = 2000  # characters
LONGEST_SPLITS = 60
LONGEST_LOG = 8000


def failure_blocks(requested_models: RequestedModels) -> list[Block]:
    """Return a block of the failures, equal failures in one row; [] if nothing failed.

    Skipped fits have one line per reason, such as a package that is not installed.
    """
    competitors = chain.from_iterable(requested_models.values())
    failures = sorted(
        (failure for competitor in competitors for failure in competitor.failures.values()),
        key=lambda failure: (failure.presentation.model, case_name_of(failure), slot_of(failure)),
    )
    if not failures:
        return []
    skipped = failure_lines(failure for failure in failures if failure.status == "skipped")
    failures = [failure for failure in failures if failure.status != "skipped"]
    alike = grouped(
        failures,
        lambda failure: (
            failure.presentation.model,
            case_name_of(failure),
            failure.status,
            failure.cause,
            failure.failure,
        ),
    )
    header = ("model", "status", "reason", "cause", "data set", "protocol", "condition", "splits")
    logs = [failure for failure in failures if failure.log]
    cut = [f"The first {MOST_LOGS} of {len(logs)} logs are shown."]
    table = Table(
        f"{counted(len(failures), 'fit')} without a result",
        [Column(name, "text") for name in header],
        [_failure_row(members) for members in alike.values()],
        cut if len(logs) > MOST_LOGS else [],
    )
    folds = [_fold(failure) for failure in logs[:MOST_LOGS]]
    is_long = len(table.rows) > FEW_ROWS
    tables = [table] if failures else []
    return [Block("Failed and skipped", skipped, tables, folds=folds, is_detail=is_long)]


def _failure_row(members: Sequence[CellResult]) -> list[Entry]:
    first = members[0]
    presentation = first.presentation
    return [
        *(
            presentation.model,
            first.status,
            _cut(first.failure, LONGEST_REASON),
            first.cause or None,
        ),
        *(presentation.dataset, presentation.protocol, first.cell.condition or None),
        _cut(", ".join(str(failure.cell.split_index) for failure in members), LONGEST_SPLITS),
    ]


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:longest]} ... (cut)"


def _fold(failure: CellResult) -> tuple[str, str]:
    presentation, cell = failure.presentation, failure.cell
    place = " | ".join(filter(None, (presentation.dataset, presentation.protocol, cell.condition)))
    summary = f"Log of {presentation.model} on {place}, split {cell.split_index}"
    text = "\n".join(failure.log)
    return (summary, text if len(text) <= LONGEST_LOG else f"(cut) {text[-LONGEST_LOG:]}")
