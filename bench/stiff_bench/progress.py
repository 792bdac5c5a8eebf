"""What a run shows while it works: a live bar on a terminal, plain lines elsewhere.

Both go to standard error, so that standard output holds the tables alone.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars
from rich.text import Text

from stiff_bench.cell_words import failure_lines, name_of
from stiff_bench.messages import one_line
from stiff_bench.tasks import CellTask
from stiff_protocols.progress import Progress, listening
from stiff_protocols.record import CellResult, Presentation

SECONDS_BETWEEN_LINES = 5.0
SECONDS_BETWEEN_CELLS = 1.0
BELIEVED = 0.1


@dataclass(frozen=True)
class Expected:
    """How long cells are expected to take, where they differ much.

    Attributes:
        total_s: of all that are to be computed, side by side as they will be, s.
        of_cell: of one, as a share of that time, s.
    """

    total_s: float
    of_cell: Callable[[Presentation], float]


class Display(Protocol):
    """Shows which cells run, how far they are, and what became of those that ended."""

    def begin(self, total: int, cached: int, expected: Expected | None = None) -> None:
        """Cells are about to be computed, beside those that are there."""

    def start(self, task: CellTask) -> None:
        """A cell starts."""

    def step(self, progress: Progress) -> None:
        """A cell reports."""

    def end(self, result: CellResult) -> None:
        """A cell has ended."""


class Count:
    """How far a run is.

    Attributes:
        total: number of cells to compute.
        cached: number of those that were there.
        started: how many have begun.
        ended: how many have ended, by their status.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self.total = self.cached = self.started = 0
        self.ended: Counter[str] = Counter()
        self._begun = self._last_end = time.monotonic()
        self._expected: Expected | None = None
        self._done_s, self._pace, self._at_once = 0.0, 1.0, 1
        self._running: dict[str, tuple[float, float]] = {}

    def begin(self, total: int, cached: int, expected: Expected | None) -> None:
        """Start the clock."""
        self.total, self.cached = total, cached
        self._begun = self._last_end = time.monotonic()
        self._expected = None if expected is None or not expected.total_s else expected

    def start(self, task: CellTask) -> None:
        """Count a cell that begins."""
        self.started += 1
        if self._expected is not None:
            share_s = self._expected.of_cell(task.shown)
            self._running[task.cell.key] = (time.monotonic(), share_s)
            self._at_once = max(self._at_once, len(self._running))

    def end(self, result: CellResult) -> None:
        """Count a cell that has ended."""
        self.ended[result.status] += 1
        self._last_end = time.monotonic()
        if self._expected is not None:
            self._running.pop(result.cell.key, None)
            self._done_s += self._expected.of_cell(result.shown)
            self._pace = self._pace_now(self._expected)

    def __str__(self) -> str:
        """Return what became of the cells so far, for people."""
        shown = dict(self.ended) | ({"cached": self.cached} if self.cached else {})
        return ", ".join(f"{number} {status}" for status, number in shown.items())

    def seconds_left(self) -> float | None:
        """Return how long the rest takes, by what the cells so far took; None where nobody knows.

        A cell that runs is taken to be as far as the last one's pace has it, until it takes longer
        than expected.
        """
        if self._expected is not None:
            left_s = max(self._expected.total_s - self._done_now(), 0.0)
            return self._pace_now(self._expected) * left_s
        done, elapsed = self.ended.total(), self._last_end - self._begun
        if not done or elapsed < SECONDS_BETWEEN_CELLS:
            return None
        return elapsed / done * (self.total - done)

    def _pace_now(self, expected: Expected) -> float:
        """Return how many seconds one that was expected takes.

        What was expected counts as if a tenth of it had come true before the first cell.
        """
        believed = BELIEVED * expected.total_s
        return (time.monotonic() - self._begun + believed) / (self._done_now() + believed)

    def _done_now(self) -> float:
        """Return how much of the expected time lies behind, that of the running cells too, s."""
        now, slowed = time.monotonic(), self._pace * self._at_once
        running = self._running.values()
        return self._done_s + sum(min(share_s, (now - t) / slowed) for t, share_s in running)


class _TimeLeft(TimeRemainingColumn):
    """The time that we say is left, or what rich makes of the steps so far."""

    def render(self, task: Task) -> Text:
        """Return it as a cell of the bar's line."""
        seconds_left: Callable[[], float | None] = task.fields.get("seconds_left", lambda: None)
        seconds = seconds_left()
        if seconds is None or task.finished:
            return super().render(task)
        return Text(str(timedelta(seconds=round(seconds))), style="progress.remaining")


class BarDisplay:
    """Two bars: cells, and the phase of the cell that reported last."""

    def __init__(self, bars: Bars) -> None:
        """Add the bars."""
        self._bars, self._count = bars, Count()
        left = self._count.seconds_left
        self._cells = bars.add_task("cells", total=None, note="", visible=False, seconds_left=left)
        self._phase = bars.add_task("", total=None, visible=False, note="")
        self._shown: tuple[str, int] | None = None

    def begin(self, total: int, cached: int, expected: Expected | None = None) -> None:
        """Show the first bar."""
        self._count.begin(total, cached, expected)
        self._bars.update(self._cells, total=total, visible=total > 0)

    def start(self, task: CellTask) -> None:
        """Name the cell."""
        self._count.start(task)
        name = name_of(self._count.started, self._count.total, task)
        self._bars.update(self._cells, description=name)
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
        self._bars.update(self._phase, completed=progress.step, note=loss)

    def end(self, result: CellResult) -> None:
        """Move the first bar."""
        self._count.end(result)
        self._bars.update(self._cells, advance=1, note=str(self._count))
        for line in failure_lines(result):
            self._bars.console.print(one_line(line), markup=False, highlight=False)


class LineDisplay:
    """A line for each cell and phase, and every few seconds in between.

    Cells that last less than a second share a line: a leave-one-out run has hundreds.
    """

    def __init__(self) -> None:
        """Start the clocks."""
        self._count = Count()
        self._phase = self._unsaid = ""
        self._phase_start = time.monotonic()
        self._last_line = -math.inf

    def begin(self, total: int, cached: int, expected: Expected | None = None) -> None:
        """Say what is there, where that is something."""
        self._count.begin(total, cached, expected)
        if cached:
            self._print(f"{cached} of {total + cached} cells are there; {total} to compute")

    def start(self, task: CellTask) -> None:
        """Print the cell's name, not too often."""
        self._count.start(task)
        self._phase, self._unsaid = "", name_of(self._count.started, self._count.total, task)
        if (
            time.monotonic() - self._last_line >= SECONDS_BETWEEN_CELLS
            or self._count.started == self._count.total
        ):
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

    def end(self, result: CellResult) -> None:
        """Count it; a failure is said at once."""
        self._count.end(result)
        for line in failure_lines(result):
            self._print(line)

    def _left(self, progress: Progress) -> str:
        elapsed = time.monotonic() - self._phase_start
        if not 0 < progress.step < progress.total or elapsed < SECONDS_BETWEEN_CELLS:
            return ""
        a_step = elapsed / progress.step
        return f", {a_step * (progress.total - progress.step):.0f} s left"

    def _say_name(self) -> None:
        if not self._unsaid:
            return
        said, left = str(self._count), self._count.seconds_left()
        time_left = "" if left is None else f"; {timedelta(seconds=round(left))} left"
        self._print(self._unsaid + (f" ({said}{time_left})" if said else ""))
        self._unsaid = ""

    def _print(self, line: str) -> None:
        self._last_line = time.monotonic()
        print(one_line(line), file=sys.stderr, flush=True)


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
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}", markup=False),
        TimeElapsedColumn(),
        _TimeLeft(),
    )
    with Bars(*columns, console=console, transient=True) as bars:
        live = BarDisplay(bars)
        with listening(live.step):
            yield live
