"""Cells that failed or were skipped, with their reasons and what they printed last."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from stiff_bench.analysis.collected import Contest, asked_for, contest_name_of
from stiff_bench.report.content import Block, Fold
from stiff_bench.report.scores import page_table
from stiff_bench.store.names import grouped
from stiff_bench.store.newest import slot_of
from stiff_bench.store.versions import NO_MANIFEST
from stiff_bench.tables.render import TextTable
from stiff_bench.tables.units import counted
from stiff_protocols.contract.record import CellResult, RunManifest


@dataclass(frozen=True)
class Selection:
    """Which contests and models a page shows, and what it ranks by.

    Attributes:
        models, datasets, protocols: words of the command line; none named means all.
        metric, axis: what is ranked by; no axis: the mean over them.
        seed: of the draws of poses.
    """

    models: tuple[str, ...] = ()
    datasets: tuple[str, ...] = ()
    protocols: tuple[str, ...] = ()
    metric: str = "norm"
    axis: str | None = None
    seed: int = 0

    def command(self, *words: str, folder: Path, ranked: bool = False) -> str:
        """Return a command line with these options.

        Args:
            words: that it begins with.
            folder: of the results.
            ranked: the command ranks, and draws poses.
        """
        options = [
            ("--results", str(folder)),
            *_each("--model", self.models),
            *_each("--dataset", self.datasets),
            *_each("--protocol", self.protocols),
        ]
        if ranked:
            options += [("--metric", self.metric)] if self.metric != "norm" else []
            options += [("--axis", self.axis)] if self.axis is not None else []
            options += [("--seed", str(self.seed))] if self.seed else []
        return shell_words("bench", *words, *(word for option in options for word in option))


def shell_words(*words: str) -> str:
    """Return words as a shell reads them."""
    return shlex.join(words)


def _each(option: str, values: Iterable[str]) -> list[tuple[str, str]]:
    return [(option, value) for value in values]


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


MOST_FAILURES = 500
MOST_LOGS = 40
LONGEST_REASON = 2000  # characters
LONGEST_SPLITS = 60
LONGEST_LOG = 8000


def failure_block(contests: Sequence[Contest], models: Sequence[str]) -> Block:
    """Return the failures that count among some contests.

    Args:
        contests: to show.
        models: words of the command line; none named means all.
    """
    found = _failures(contests, models)
    heading = "Failures and skipped cells"
    if not found:
        return Block(heading, ["No cell failed and none was skipped."])
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
        [_failure_row(members) for members in shown],
        notes,
    )
    return Block(heading, tables=[page_table(table)], folds=folds)


def _failures(contests: Sequence[Contest], models: Sequence[str]) -> list[CellResult]:
    """Return the records without a result that count, by model, contest and split."""
    found = (
        failure
        for contest in contests
        for name, competitor in contest.competitors.items()
        if asked_for(name, models)
        for failure in competitor.failures.values()
    )
    return sorted(found, key=lambda one: (one.shown.model, contest_name_of(one), slot_of(one)))


def _story(one: CellResult) -> tuple[object, ...]:
    """Return what cells share that failed alike."""
    return one.shown.model, contest_name_of(one), one.status, one.cause, one.failure


def _failure_row(members: Sequence[CellResult]) -> list[str]:
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
