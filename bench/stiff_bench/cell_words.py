"""What a run says of a cell while it works."""

from __future__ import annotations

from collections.abc import Iterator

from stiff_bench.tasks import CellTask
from stiff_protocols.record import CellResult

SHOWN_LOG_LINES = 6


def name_of(number: int, total: int, task: CellTask) -> str:
    """Return a cell's name for people."""
    cell = task.cell
    condition = f"({cell.condition}) " if cell.condition else ""
    return (
        f"[{number}/{total}] {task.shown.model} on {task.shown.dataset}, "
        f"{task.shown.protocol} {condition}split {cell.split_index + 1}/{task.n_splits}"
    )


def failure_lines(result: CellResult) -> Iterator[str]:
    """Yield what is said of a cell that failed: the reason, and the end of its log."""
    if result.status == "failed":
        yield f"  {result.shown.model}: FAILED: {result.failure}"
        for line in result.log[-SHOWN_LOG_LINES:]:
            yield f"    | {line}"
