"""The history of measured ratios and figures, so that a slowdown shows.

One CSV file, a row a figure and run. Runs are compared on one processor alone: ratios, too, differ
between machines.
"""

from __future__ import annotations

import csv
import io
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from stiff_bench.perf_report import Finding
from stiff_protocols.errors import StoreError
from stiff_protocols.files import written_whole

COLUMNS = ("date", "commit", "dirty", "processor", "path", "what", "value", "unit")
RUNS = 5
"""How many of the last runs give what is expected now."""
SLOWDOWN = 0.2
"""Share that a figure must get worse by to be called out; less is this machine's noise."""


@dataclass(frozen=True)
class History:
    """Figures of earlier runs.

    Attributes:
        rows: as in the file, a mapping of `COLUMNS` each.
    """

    rows: tuple[Mapping[str, str], ...]

    def expected(self, finding: Finding, processor: str) -> float | None:
        """Return the median of the last runs on that processor; None: there are none."""
        earlier = [
            float(row["value"])
            for row in self.rows
            if (row["processor"], row["path"], row["what"])
            == (processor, finding.path, finding.what)
        ]
        return statistics.median(earlier[-RUNS:]) if earlier else None


def worse_by(finding: Finding, expected: float | None) -> float:
    """Return the share by which a figure is worse than expected; negative where it is better."""
    if expected is None or expected <= 0.0 or finding.value <= 0.0:
        return 0.0
    change = finding.value / expected
    return 1.0 / change - 1.0 if finding.more_is_better else change - 1.0


def read_history(path: Path) -> History:
    """Read a history; a file that is not there is an empty one.

    Raises:
        StoreError: it cannot be read, or is no history.
    """
    if not path.exists():
        return History(())
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            rows, columns = tuple(reader), tuple(reader.fieldnames or ())
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StoreError(f"{path}: cannot be read: {error}") from error
    if columns != COLUMNS:
        raise StoreError(
            f"{path}: has the columns {', '.join(columns)}; a history has {', '.join(COLUMNS)}"
        )
    for number, row in enumerate(rows, start=2):
        if not _is_number(row["value"]):
            raise StoreError(f"{path}: line {number}, column value: {row['value']!r} is no number")
    return History(rows)


def _is_number(text: str | None) -> bool:
    try:
        float(text or "")
    except ValueError:
        return False
    return True


def write_history(
    path: Path,
    history: History,
    findings: Iterable[Finding],
    *,
    date: str,
    environment: Mapping[str, str],
) -> None:
    """Write the history with the figures of one more run at its end.

    Raises:
        StoreError: the file cannot be written.
    """
    about = {"date": date} | {key: environment[key] for key in ("commit", "dirty", "processor")}
    added = [
        about | {"path": one.path, "what": one.what, "value": f"{one.value:.6g}", "unit": one.unit}
        for one in findings
    ]
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows([*history.rows, *added])
    with written_whole(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def n_runs(history: History, processor: str) -> int:
    """Return how many runs on that processor a history holds."""
    return len({row["date"] for row in history.rows if row["processor"] == processor})
