"""Show the progress of a run, or of other long work, as a bar of tqdm; off a terminal as lines.

They are on standard error, or a widget in a notebook: only tables go to standard output.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from stiff_bench.console import one_line, text_width
from stiff_bench.plan.fits import FitTask
from stiff_protocols.contract.progress import Progress, listening
from stiff_protocols.contract.record import FitResult

with warnings.catch_warnings(action="ignore"):  # of a notebook without ipywidgets, which gets text
    from tqdm.autonotebook import tqdm  # tqdm.auto imports asyncio, too

SHOWN_LOG_LINES = 6
SECONDS_BETWEEN_LINES = 5.0
"""Period off a terminal, such as in the log of a cluster's job."""
LINE = "{desc}: {n_fmt}/{total_fmt} [{elapsed}<{remaining}{postfix}]"
FITS = "fits"


class _Lines:
    """Write each state of a bar as a line on standard error."""

    def write(self, text: str) -> None:
        if line := text.strip():
            print(line, file=sys.stderr, flush=True)


class Display:
    """Show one bar: of the fits of a run with the phase of the newest, or of a phase of other work.

    Off a terminal, its state is a line every few seconds.
    """

    def __init__(self) -> None:
        """Show nothing yet."""
        self._bar: Any = tqdm(disable=True)
        self._shown_phase = ("", 0)
        self._ended = Counter[str]()

    def begin(self, n_fits: int, n_cached: int) -> None:
        """Show the number of fits."""
        self._ended = Counter({"cached": n_cached} if n_cached else {})
        self._show_bar(FITS, n_fits)

    def start(self, task: FitTask) -> None:
        """Show the name of the fit."""
        fit, labels = task.fit, task.presentation
        condition = f"({fit.condition}) " if fit.condition else ""
        name = (
            f"{labels.model} on {labels.dataset}, {labels.protocol} {condition}"
            f"split {fit.split_index + 1}/{task.n_splits}"
        )
        self._bar.set_description_str(one_line(name), refresh=False)
        self._move(0)

    def step(self, progress: Progress) -> None:
        """Show the phase of a fit behind the counts; other work has a bar for each phase."""
        loss = "" if progress.loss is None else f"loss {progress.loss:.3g}"
        if self._shown_phase[0] == FITS:
            self._move(0, f"{progress.phase} {progress.step}/{progress.total}", loss)
            return
        if self._shown_phase != (progress.phase, progress.total):
            self._show_bar(progress.phase, progress.total)
        self._move(progress.step - self._bar.n, loss)

    def end(self, result: FitResult) -> None:
        """Move the bar; for a failed fit, show the reason and the last log lines."""
        self._ended[result.status] += 1
        self._move(1)
        if result.status == "failed":
            log = [f"    | {line}" for line in result.log[-SHOWN_LOG_LINES:]]
            for line in (f"  {result.presentation.model}: FAILED: {result.failure}", *log):
                self.note(line)

    def note(self, line: str) -> None:
        """Print a line above the bar."""
        tqdm.write(one_line(line), file=sys.stderr)

    def close(self) -> None:
        """End the bar; off a terminal, its last state is a line."""
        self._bar.close()

    def _show_bar(self, name: str, total: int) -> None:
        """Show a new bar."""
        self.close()
        self._shown_phase = name, total
        how = {"file": _Lines(), "mininterval": SECONDS_BETWEEN_LINES, "bar_format": LINE}
        if sys.stderr.isatty():
            how = {"leave": False, "ncols": text_width()}
        # smoothing: fits are long, so the speed is their mean
        self._bar = tqdm(desc=name, total=total, smoothing=0.0, miniters=0, **how)
        self._move(0)

    def _move(self, steps: int, *notes: str) -> None:
        """Move the bar, with the numbers of fits by status so far and notes behind it."""
        counts = ", ".join(f"{number} {status}" for status, number in self._ended.items())
        self._bar.set_postfix_str("; ".join(filter(None, (counts, *notes))), refresh=False)
        self._bar.update(steps)


@contextmanager
def display() -> Iterator[Display]:
    """Show the progress of fits or other work inside the block."""
    run_display = Display()
    try:
        with listening(run_display.step):
            yield run_display
    finally:
        run_display.close()
