"""Show the progress of a run: bars on terminals, one changing line in notebooks, else lines.

Bars and lines of a command go to standard error: only tables go to standard output.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from stiff_bench.console import one_line
from stiff_bench.plan.cells import CellTask
from stiff_protocols.contract.progress import Progress, listening
from stiff_protocols.contract.record import CellResult

SHOWN_LOG_LINES = 6
SECONDS_BETWEEN_LINES, SECONDS_BETWEEN_CELLS = 5.0, 1.0


class Display:
    """Show two bars: one for the cells, one for the phase of a cell.

    Without a terminal, lines show the same: one per cell and phase, and every few seconds between.
    """

    def __init__(self, bars: Bars) -> None:
        """Add the bars, which stay hidden until the first cell."""
        self._bars, self._is_live = bars, bars.console.is_terminal
        self._cells = bars.add_task("fits", total=None, note="", visible=False)
        self._phase = bars.add_task("", total=None, note="", visible=False)
        self._begun: tuple[str, int] | None = None
        self._last_line = -math.inf
        self._ended = Counter[str]()

    def begin(self, n_cells: int, n_cached: int) -> None:
        """Show the number of cells."""
        self._bars.update(self._cells, total=n_cells)
        self._n_cells, self._n_started = n_cells, 0
        self._ended = Counter({"cached": n_cached} if n_cached else {})
        if n_cached:
            n_all = n_cells + n_cached
            self._show(f"{n_cached} of {n_all} fits are stored; {n_cells} to compute")

    def start(self, task: CellTask) -> None:
        """Show the cell; without a terminal not too often, as a run may have hundreds."""
        self._n_started += 1
        cell, labels, self._begun = task.cell, task.presentation, None
        condition = f"({cell.condition}) " if cell.condition else ""
        name = (
            f"[{self._n_started}/{self._n_cells}] {labels.model} on {labels.dataset}, "
            f"{labels.protocol} {condition}split {cell.split_index + 1}/{task.n_splits}"
        )
        self._bars.update(self._cells, description=name, visible=True)
        self._bars.update(self._phase, visible=False)
        is_last = self._n_started == self._n_cells
        if is_last or time.monotonic() - self._last_line >= SECONDS_BETWEEN_CELLS:
            self._show_line(f"{name} ({self._counts})" if self._counts else name)

    def step(self, progress: Progress) -> None:
        """Move the second bar; a new phase restarts its clock."""
        loss = "" if progress.loss is None else f", loss {progress.loss:.3g}"
        note = f"{progress.step}/{progress.total}{loss}"
        if is_new := self._begun != (progress.phase, progress.total):
            self._begun = (progress.phase, progress.total)
            name = f"  {progress.phase}"
            self._bars.reset(self._phase, description=name, total=progress.total, visible=True)
        self._bars.update(self._phase, completed=progress.step, note=note)
        waited = time.monotonic() - self._last_line
        if is_new or waited >= SECONDS_BETWEEN_LINES or progress.step >= progress.total:
            self._show_line(f"  {progress.phase} {note}")

    def end(self, result: CellResult) -> None:
        """Move the first bar; for a failed cell, show the reason and the last log lines."""
        self._ended[result.status] += 1
        self._bars.update(self._cells, advance=1, note=self._counts)
        if result.status == "failed":
            self._show(f"  {result.presentation.model}: FAILED: {result.failure}")
            for line in result.log[-SHOWN_LOG_LINES:]:
                self._show(f"    | {line}")

    @property
    def _counts(self) -> str:
        """Return the numbers of cells by status so far, as text."""
        return ", ".join(f"{number} {status}" for status, number in self._ended.items())

    def _show_line(self, line: str) -> None:
        if not self._is_live:
            self._last_line = time.monotonic()
            self._show(line)

    def _show(self, line: str) -> None:
        """Show a permanent line above the bars."""
        if self._is_live:
            self._bars.console.print(one_line(line), markup=False, highlight=False)
        else:
            print(one_line(line), file=sys.stderr, flush=True)


class NotebookDisplay(Display):
    """Show the newest line as one output of a notebook's cell, which changes in place."""

    _output: Any = None

    def close(self, seconds: float) -> None:
        """Replace the line with the counts, and the seconds that the work took."""
        if self._output is not None:
            self._show_line(f"{self._counts or 'done'} in {seconds:.0f} s")

    def _show_line(self, line: str) -> None:
        from IPython.display import display as show_output  # a notebook has it

        self._last_line = time.monotonic()
        content = {"text/plain": one_line(line)}
        if self._output is None:
            self._output = show_output(content, raw=True, display_id=True)  # type: ignore[no-untyped-call]
        else:
            self._output.update(content, raw=True)

    def _show(self, line: str) -> None:
        print(one_line(line), flush=True)


@contextmanager
def display() -> Iterator[Display]:
    """Show the progress of cells or other work inside the block.

    It is shown in the output of a notebook's cell, else on standard error.
    """
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        TextColumn("{task.fields[note]}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    # the default period of 30 s gives no speed for long fits
    bars = Bars(
        *columns,
        console=console,
        transient=True,
        disable=not console.is_terminal,
        speed_estimate_period=math.inf,
    )
    if console.is_jupyter:  # rich's own live display needs ipywidgets there
        notebook, started = NotebookDisplay(bars), time.monotonic()
        try:
            with listening(notebook.step):
                yield notebook
        finally:
            notebook.close(time.monotonic() - started)
        return
    with bars:
        run_display = Display(bars)
        with listening(run_display.step):
            yield run_display
