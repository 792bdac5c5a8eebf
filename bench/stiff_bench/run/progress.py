"""What a run shows while it works: a live bar on a terminal, plain lines elsewhere.

Both go to standard error, so that standard output holds the tables alone.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
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

from stiff_bench.console import one_line
from stiff_bench.plan.cells import CellTask
from stiff_protocols.contract.progress import Progress, listening
from stiff_protocols.contract.record import CellResult

SHOWN_LOG_LINES = 6


def failure_lines(result: CellResult) -> Iterator[str]:
    """Yield what is said of a cell that failed: the reason, and the end of its log."""
    if result.status == "failed":
        yield f"  {result.shown.model}: FAILED: {result.failure}"
        for line in result.log[-SHOWN_LOG_LINES:]:
            yield f"    | {line}"


SECONDS_BETWEEN_LINES = 5.0
SECONDS_BETWEEN_CELLS = 1.0


@dataclass(frozen=True)
class Expected:
    """How long cells are expected to take: their models' stored fits.

    Attributes:
        seconds: of a cell by its model's name with options, s.
        total_s: of all that are to be computed, one after another, s.
        at_once: how many are computed side by side.
    """

    seconds: Mapping[str, float]
    total_s: float
    at_once: int

    @classmethod
    def of(
        cls, missing: Sequence[CellTask], seconds: Mapping[str, float], at_once: int
    ) -> Expected | None:
        """Return what is expected of cells; None where a model has no stored fit."""
        models = [task.shown.model for task in missing]
        if not seconds.keys() >= {*models}:
            return None
        return cls(seconds, sum(seconds[model] for model in models), at_once)


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

    def __init__(self, total: int = 0, cached: int = 0, expected: Expected | None = None) -> None:
        """Start the clock."""
        self.total, self.cached, self.started = total, cached, 0
        self.ended: Counter[str] = Counter()
        self._begun = self._last_end = time.monotonic()
        self._expected, self._done_s = expected, 0.0
        self._left_s = 0.0 if expected is None else expected.total_s / expected.at_once

    def start(self, task: CellTask) -> str:
        """Count a cell that begins, and return its name for people."""
        self.started += 1
        cell = task.cell
        condition = f"({cell.condition}) " if cell.condition else ""
        return (
            f"[{self.started}/{self.total}] {task.shown.model} on {task.shown.dataset}, "
            f"{task.shown.protocol} {condition}split {cell.split_index + 1}/{task.n_splits}"
        )

    def end(self, result: CellResult) -> None:
        """Count a cell that has ended."""
        self.ended[result.status] += 1
        self._last_end = time.monotonic()
        if self._expected is not None:
            self._done_s += self._expected.seconds.get(result.shown.model, 0.0)
            # by the stored fits, until a tenth of their time is done: then by the pace of the
            # cells so far, since another machine has another one
            left_s = max(self._expected.total_s - self._done_s, 0.0)
            if self._done_s < self._expected.total_s / 10:
                self._left_s = left_s / self._expected.at_once
            else:
                self._left_s = left_s * (self._last_end - self._begun) / self._done_s

    def __str__(self) -> str:
        """Return what became of the cells so far, for people."""
        shown = dict(self.ended) | ({"cached": self.cached} if self.cached else {})
        return ", ".join(f"{number} {status}" for status, number in shown.items())

    def seconds_left(self) -> float | None:
        """Return how long the rest takes; None where nobody knows."""
        if self._expected is not None:
            return max(self._left_s - (time.monotonic() - self._last_end), 0.0)
        done, elapsed = self.ended.total(), self._last_end - self._begun
        if not done or elapsed < SECONDS_BETWEEN_CELLS:
            return None
        return elapsed / done * (self.total - done)


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
        self._cells = bars.add_task("cells", total=None, note="", visible=False)
        self._phase = bars.add_task("", total=None, visible=False, note="")
        self._shown: tuple[str, int] | None = None

    def begin(self, total: int, cached: int, expected: Expected | None = None) -> None:
        """Show the first bar."""
        self._count = Count(total, cached, expected)
        left = self._count.seconds_left
        self._bars.update(self._cells, total=total, visible=total > 0, seconds_left=left)

    def start(self, task: CellTask) -> None:
        """Name the cell."""
        self._bars.update(self._cells, description=self._count.start(task))
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
        self._count = Count(total, cached, expected)
        if cached:
            self._print(f"{cached} of {total + cached} cells are there; {total} to compute")

    def start(self, task: CellTask) -> None:
        """Print the cell's name, not too often."""
        self._phase, self._unsaid = "", self._count.start(task)
        is_last = self._count.started == self._count.total
        if is_last or time.monotonic() - self._last_line >= SECONDS_BETWEEN_CELLS:
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
        elapsed, left = now - self._phase_start, ""
        if 0 < progress.step < progress.total and elapsed >= SECONDS_BETWEEN_CELLS:
            left = f", {elapsed / progress.step * (progress.total - progress.step):.0f} s left"
        self._print(f"  {progress.phase} {progress.step}/{progress.total}{loss}{left}")

    def end(self, result: CellResult) -> None:
        """Count it; a failure is said at once."""
        self._count.end(result)
        for line in failure_lines(result):
            self._print(line)

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
def display() -> Iterator[Display]:
    """Show progress inside the block, of cells or of other work, as suits standard error."""
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
