"""What a run shows while it works: a live bar on a terminal, plain lines elsewhere.

Both go to standard error, so that standard output holds the tables alone.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta

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
SECONDS_BETWEEN_LINES = 5.0
SECONDS_BETWEEN_CELLS = 1.0


class Display:
    """Counts cells and foretells the time that is left; its subclasses show that."""

    def begin(
        self, missing: Sequence[CellTask], n_cached: int, seconds: Mapping[str, float], at_once: int
    ) -> None:
        """Cells that are `missing` are about to be computed, `at_once` side by side.

        `n_cached` others are there; `seconds` has the mean time of a model's stored fits, s.
        """
        models = [task.shown.model for task in missing]
        self._known = seconds.keys() >= {*models}
        self._seconds = seconds if self._known else dict.fromkeys(models, 1.0)
        self._total_s, self._done_s = sum(self._seconds[model] for model in models), 0.0
        self._total, self._n_cached, self._at_once = len(missing), n_cached, at_once
        self._n_started, self._ended = 0, Counter[str]()
        self._begun = self._last_end = time.monotonic()
        if n_cached:
            n_cells = len(missing) + n_cached
            self.show(f"{n_cached} of {n_cells} fits are stored; {len(missing)} to compute")

    def start(self, task: CellTask) -> None:
        """A cell starts."""
        self._n_started += 1

    def step(self, progress: Progress) -> None:
        """A cell reports."""

    def end(self, result: CellResult) -> None:
        """A cell has ended; of one that failed, reason and end of the log are shown at once."""
        self._ended[result.status] += 1
        self._last_end = time.monotonic()
        self._done_s += self._seconds.get(result.shown.model, 0.0)
        if result.status == "failed":
            self.show(f"  {result.shown.model}: FAILED: {result.failure}")
            for line in result.log[-SHOWN_LOG_LINES:]:
                self.show(f"    | {line}")

    def show(self, line: str) -> None:
        """Show a line that stays."""
        print(one_line(line), file=sys.stderr, flush=True)

    def name_of(self, task: CellTask) -> str:
        """Return the name for people of the cell that has started last."""
        cell = task.cell
        condition = f"({cell.condition}) " if cell.condition else ""
        return (
            f"[{self._n_started}/{self._total}] {task.shown.model} on {task.shown.dataset}, "
            f"{task.shown.protocol} {condition}split {cell.split_index + 1}/{task.n_splits}"
        )

    @property
    def counts(self) -> str:
        """What became of the cells so far, for people."""
        shown = dict(self._ended) | ({"cached": self._n_cached} if self._n_cached else {})
        return ", ".join(f"{number} {status}" for status, number in shown.items())

    @property
    def time_left(self) -> timedelta | None:
        """How long the rest takes; None where it is not known, as when a fit outlasts the forecast.

        It follows the stored fits until a tenth of their time is done, and then the pace of the
        cells so far, since another machine has another one.
        """
        left = self._total_s - self._done_s
        if self._done_s and (not self._known or self._done_s >= self._total_s / 10):
            left *= (self._last_end - self._begun) / self._done_s
        elif self._known:
            left /= self._at_once
        else:
            return None
        seconds = round(left - (time.monotonic() - self._last_end))
        return timedelta(seconds=seconds) if seconds >= 0 else None


class _TimeLeft(TimeRemainingColumn):
    """The time that a display says is left; rich's own for the steps of a phase."""

    def render(self, task: Task) -> Text:
        """Return it as a cell of the bar's line."""
        display: Display | None = task.fields.get("display")
        if display is None or task.finished:
            return super().render(task)
        left = display.time_left  # rich's own would stand still while a fit runs
        return Text("-:--:--" if left is None else str(left), style="progress.remaining")


class BarDisplay(Display):
    """Two bars: cells, and the phase of the cell that reported last."""

    def __init__(self, bars: Bars) -> None:
        """Add the bars."""
        self._bars = bars
        self._cells = bars.add_task("fits", total=None, note="", visible=False, display=self)
        self._phase = bars.add_task("", total=None, visible=False, note="")
        self._shown: tuple[str, int] | None = None

    def start(self, task: CellTask) -> None:
        """Name the cell."""
        super().start(task)
        name = self.name_of(task)
        self._bars.update(self._cells, description=name, total=self._total, visible=True)
        self._bars.update(self._phase, visible=False)
        self._shown = None

    def step(self, progress: Progress) -> None:
        """Move the second bar; a new phase starts its clock again."""
        loss = "" if progress.loss is None else f"loss {progress.loss:.3g}"
        if self._shown != (progress.phase, progress.total):
            self._shown = (progress.phase, progress.total)
            name = f"  {progress.phase}"
            self._bars.reset(self._phase, description=name, total=progress.total, visible=True)
        self._bars.update(self._phase, completed=progress.step, note=loss)

    def end(self, result: CellResult) -> None:
        """Move the first bar."""
        super().end(result)
        self._bars.update(self._cells, advance=1, note=self.counts)

    def show(self, line: str) -> None:
        """Print it above the bars."""
        self._bars.console.print(one_line(line), markup=False, highlight=False)


class LineDisplay(Display):
    """A line for each cell and phase, and every few seconds in between.

    Cells that last less than a second share a line: a leave-one-out run has hundreds.
    """

    def __init__(self) -> None:
        """Start the clocks."""
        self._phase = self._unsaid = ""
        self._phase_start, self._last_line = time.monotonic(), -math.inf

    def start(self, task: CellTask) -> None:
        """Print the cell's name, not too often."""
        super().start(task)
        self._phase, self._unsaid = "", self.name_of(task)
        is_last = self._n_started == self._total
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
        self.show(f"  {progress.phase} {progress.step}/{progress.total}{loss}{left}")

    def show(self, line: str) -> None:
        """Print it, and remember when."""
        self._last_line = time.monotonic()
        super().show(line)

    def _say_name(self) -> None:
        if self._unsaid:
            left = "" if self.time_left is None else f"; {self.time_left} left"
            self.show(self._unsaid + (f" ({self.counts}{left})" if self.counts else ""))
            self._unsaid = ""


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
