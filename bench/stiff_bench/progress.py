"""What a run shows while it works: a live bar on a terminal, plain lines elsewhere.

Both go to standard error, so that standard output holds the tables alone.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars

from stiff_bench.tasks import CellTask
from stiff_protocols.progress import Progress, listening

SECONDS_BETWEEN_LINES = 5.0
SECONDS_BETWEEN_CELLS = 1.0


class Display(Protocol):
    """Shows which cell runs and how far it is."""

    def cell(self, number: int, total: int, task: CellTask) -> None:
        """A cell starts."""

    def step(self, progress: Progress) -> None:
        """The cell reports."""


def name_of(number: int, total: int, task: CellTask) -> str:
    """Return a cell's name for people."""
    cell = task.cell
    condition = f"({cell.condition}) " if cell.condition else ""
    return (
        f"[{number + 1}/{total}] {task.shown.model} on {task.shown.dataset}, "
        f"{task.shown.protocol} {condition}split {cell.split_index + 1}/{task.n_splits}"
    )


class BarDisplay:
    """Two bars: cells, and the phase of the cell that runs."""

    def __init__(self, bars: Bars) -> None:
        """Add the bars."""
        self._bars = bars
        self._cells = bars.add_task("cells", total=None, loss="", visible=False)
        self._phase = bars.add_task("", total=None, visible=False, loss="")
        self._shown: tuple[str, int] | None = None

    def cell(self, number: int, total: int, task: CellTask) -> None:
        """Move the first bar."""
        name = name_of(number, total, task)
        self._bars.update(
            self._cells, description=name, total=total, completed=number, visible=True
        )
        self._bars.update(self._phase, visible=False)
        self._shown = None

    def step(self, progress: Progress) -> None:
        """Move the second bar; a new phase starts its clock again."""
        loss = "" if progress.loss is None else f"loss {progress.loss:.3g}"
        if self._shown != (progress.phase, progress.total):
            self._shown = (progress.phase, progress.total)
            self._bars.reset(
                self._phase, description=f"  {progress.phase}", total=progress.total, visible=True
            )
        self._bars.update(self._phase, completed=progress.step, loss=loss)


class LineDisplay:
    """A line for each cell and phase, and every few seconds in between.

    Cells that last less than a second share a line: a leave-one-out run has hundreds.
    """

    def __init__(self) -> None:
        """Start the clocks."""
        self._phase = self._unsaid = ""
        self._phase_start = time.monotonic()
        self._last_line = -math.inf

    def cell(self, number: int, total: int, task: CellTask) -> None:
        """Print the cell's name, not too often."""
        self._phase, self._unsaid = "", name_of(number, total, task)
        if time.monotonic() - self._last_line >= SECONDS_BETWEEN_CELLS or number + 1 == total:
            self._say_name()

    def step(self, progress: Progress) -> None:
        """Print where the phase is, not too often."""
        now = time.monotonic()
        if progress.phase != self._phase:
            self._phase, self._phase_start = progress.phase, now
        elif now - self._last_line < SECONDS_BETWEEN_LINES and progress.step < progress.total:
            return
        self._say_name()
        loss = "" if progress.loss is None else f", loss {progress.loss:.3g}"
        self._print(
            f"  {progress.phase} {progress.step}/{progress.total}{loss}{self._left(progress)}"
        )

    def _left(self, progress: Progress) -> str:
        elapsed = time.monotonic() - self._phase_start
        if not 0 < progress.step < progress.total or elapsed < SECONDS_BETWEEN_CELLS:
            return ""
        a_step = elapsed / progress.step
        return f", {a_step * (progress.total - progress.step):.0f} s left"

    def _say_name(self) -> None:
        if self._unsaid:
            self._print(self._unsaid)
            self._unsaid = ""

    def _print(self, line: str) -> None:
        self._last_line = time.monotonic()
        print(line, file=sys.stderr, flush=True)


@contextmanager
def phases() -> Iterator[None]:
    """Show the progress of work that has no cells."""
    with display():
        yield


@contextmanager
def display() -> Iterator[Display]:
    """Show progress inside the block, in the way that suits standard error."""
    console = Console(stderr=True)
    if not console.is_terminal:
        lines = LineDisplay()
        with listening(lines.step):
            yield lines
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TextColumn("{task.fields[loss]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=console, transient=True) as bars:
        live = BarDisplay(bars)
        with listening(live.step):
            yield live
