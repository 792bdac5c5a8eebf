"""Which commands, commits and machines made the results of a folder, for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

from stiff_bench.render import markdown_code, markdown_text
from stiff_bench.result_source import sources
from stiff_bench.store import read_manifests, stored_results
from stiff_protocols.record import RunManifest


def provenance_lines(folder: Path, command: str) -> Iterator[str]:
    """Yield lines of markdown: the command, the versions, the time, and each machine.

    Raises:
        StoreError: a file of the folder is damaged.
    """
    runs = list(read_manifests(folder))
    counts: Counter[str] = Counter()
    fitting_s = 0.0
    for result in stored_results(folder):
        counts[result.run_id] += 1
        fitting_s += 0.0 if result.cost is None else result.cost.fit_s
    yield f"made by {markdown_code(command)}"
    for line in sources(folder, runs, counts):
        yield markdown_text(line)
    yield f"fits took {timedelta(seconds=round(fitting_s))} (h:min:s) of one thread in all"
    for machine, ids in _machines(runs).items():
        yield f"{markdown_text(machine)}; runs {', '.join(ids)}"


def _machines(runs: list[RunManifest]) -> dict[str, list[str]]:
    """Return machine -> ids of its runs."""
    found: dict[str, list[str]] = {}
    for run in runs:
        known = run.environment
        about = (
            f"{known.get('processor', 'unknown processor')}, {known.get('cores', '?')} cores, "
            f"{known.get('platform', 'unknown platform')}, Python {known.get('python', '?')}, "
            f"torch {known.get('torch', '?')}"
        )
        found.setdefault(about, []).append(run.run_id)
    return found
