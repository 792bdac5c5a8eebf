"""Which runs made the results: commands, commits, versions, machines and dates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from stiff_bench.collected import Contest
from stiff_bench.render import TextTable
from stiff_bench.report.content import Block, Fold
from stiff_bench.report.sorting import page_table
from stiff_bench.result_source import NO_MANIFEST
from stiff_bench.words import counted
from stiff_protocols.record import RunManifest

MOST_RUNS = 100
MOST_ENVIRONMENTS = 10


def run_block(
    runs: Sequence[RunManifest], contests: Iterable[Contest], provenance: Sequence[str]
) -> Block:
    """Return the runs of a folder, the newest first.

    Args:
        runs: whose manifests the folder holds.
        contests: whose results are shown.
        provenance: lines that stand beneath the leaderboard.
    """
    counts = _counts(contests)
    newest = sorted(runs, key=lambda run: run.run_id, reverse=True)
    known = {run.run_id for run in runs}
    rows = [_row(run, counts[run.run_id]) for run in newest[:MOST_RUNS]]
    lost = sum(count for run_id, count in counts.items() if run_id not in known)
    if lost:
        rows.append([NO_MANIFEST, *["-"] * 4, str(lost), *["-"] * 6])
    notes = [*provenance]
    if len(runs) > MOST_RUNS:
        notes.append(f"The newest {MOST_RUNS} of {len(runs)} runs are shown.")
    if any(run.environment.get("dirty") == "true" for run in runs):
        notes.append("A commit with + had uncommitted changes: its results cannot be made again.")
    header = (
        *("run", "started (UTC)", "state", "wall time [s]", "cells asked for", "results shown"),
        *("stiffbench", "commit", "Python", "processor", "cores", "GPU"),
    )
    commands = "\n".join(dict.fromkeys(run.command for run in newest[:MOST_RUNS]))
    folds = [Fold("Commands that made these results, newest first", commands)] if runs else []
    return Block(
        "Provenance",
        tables=[page_table(TextTable("Runs", header, rows, notes))],
        folds=[*folds, *_environments(newest)],
    )


def _counts(contests: Iterable[Contest]) -> Counter[str]:
    """Return how many of the results each run made."""
    return Counter(
        result.run_id
        for contest in contests
        for competitor in contest.competitors.values()
        for result in competitor.done.values()
    )


def _row(run: RunManifest, n_results: int) -> list[str]:
    about = run.environment
    changed = "+" if about.get("dirty") == "true" else ""
    machines = f" and {counted(len(run.machines), 'other machine')}" if run.machines else ""
    return [
        *(run.run_id, run.started, run.status),
        f"{run.wall_s:.0f}" if run.wall_s else "-",
        *(str(len(run.cells)), str(n_results), about.get("stiffbench", "") or "-"),
        f"{about.get('commit', '')[:12]}{changed}" or "-",
        *(about.get("python", "") or "-", f"{about.get('processor', '') or '-'}{machines}"),
        *(about.get("cores", "") or "-", about.get("gpu", "") or "-"),
    ]


def _environments(runs: Sequence[RunManifest]) -> list[Fold]:
    """Return each environment once, with the runs that had it."""
    found: dict[str, list[str]] = {}
    for run in runs:
        parts = [_lines(run.environment)]
        parts += [f"machine {name}\n{_lines(one)}" for name, one in sorted(run.machines.items())]
        found.setdefault("\n\n".join(parts), []).append(run.run_id)
    return [
        Fold(f"Versions and machine of {_few(names)}", text)
        for text, names in [*found.items()][:MOST_ENVIRONMENTS]
    ]


def _lines(environment: Mapping[str, str]) -> str:
    return "\n".join(f"{name}: {value}" for name, value in environment.items())


def _few(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} and {counted(len(names) - 1, 'more run')}"
