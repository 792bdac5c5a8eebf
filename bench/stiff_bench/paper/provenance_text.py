"""Which commands, commits and machines made the results of a folder, for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

from stiff_bench.render import markdown_code, markdown_text
from stiff_bench.result_source import sources
from stiff_bench.store import FILE, read_manifests, stored_results
from stiff_bench.words import counted
from stiff_protocols.record import RunManifest


def provenance_lines(folder: Path, command: str, n_missing: int) -> Iterator[str]:
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
    if n_missing:
        yield f"not finished: {counted(n_missing, 'cell')} of it not computed"
    for line in sources(folder, runs, counts):
        yield markdown_text(line)
    yield f"fits took {timedelta(seconds=round(fitting_s))} (h:min:s) of one thread in all"
    name = f"{folder.name}/{FILE}"
    for machine, n_runs in _machines(runs).items():
        where = "its manifest is" if n_runs == 1 else "their manifests are"
        yield f"{markdown_text(machine)}: {counted(n_runs, 'run')}; {where} in `{name}`"


def _machines(runs: list[RunManifest]) -> Counter[str]:
    """Return machine -> number of its runs."""
    found: Counter[str] = Counter()
    for run in runs:
        known = run.environment
        about = (
            f"{known.get('processor', 'unknown processor')}, {known.get('cores', '?')} cores, "
            f"{known.get('platform', 'unknown platform')}, Python {known.get('python', '?')}, "
            f"torch {known.get('torch', '?')}"
        )
        found[about] += 1
    return found
