"""What a run shows: how far it is, and how long it still takes."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from rich.console import Console
from rich.progress import Progress as Bars

from stiff_bench.run.progress import RunDisplay
from stiff_protocols.contract.progress import Progress


def cell(model):
    """What is needed of a cell, and of its result."""
    shown = SimpleNamespace(model=model, dataset="data", protocol="holdout")
    identity = SimpleNamespace(condition="", split_index=0)
    return SimpleNamespace(status="ok", shown=shown, cell=identity, n_splits=1)


def begun(models, *, terminal, seconds):
    clock = SimpleNamespace(now=0.0)
    console = Console(file=io.StringIO(), force_terminal=terminal)
    bars = Bars(console=console, get_time=lambda: clock.now, auto_refresh=False)
    display = RunDisplay(bars)
    display.begin([cell(model) for model in models], 2, seconds)
    return display, bars.tasks[0], clock


@pytest.mark.parametrize(
    ("models", "left"), [(("quick", "long"), 90.0), (("quick", "never stored"), 10.0)]
)
def test_a_fit_counts_for_as_long_as_its_models_stored_fits_took(models, left):
    display, bar, clock = begun(models, terminal=True, seconds={"quick": 10.0, "long": 90.0})
    display.start(cell(models[0]))
    bar.start_time = 0.0
    display._bars.update(bar.id, completed=0.0)
    assert bar.time_remaining is None
    clock.now = 10.0
    display.end(cell(models[0]))
    assert bar.remaining / bar.total == left / (left + 10.0)


def test_off_a_terminal_lines_name_cells_phases_and_what_became_of_them(capsys):
    display, _, _ = begun(("quick",) * 2, terminal=False, seconds={})
    display.start(cell("quick"))
    display.step(Progress("training", 1, 2, 0.5))
    display.end(cell("quick"))
    display.start(cell("quick"))
    assert capsys.readouterr().err.splitlines() == [
        "2 of 4 fits are stored; 2 to compute",
        "[1/2] quick on data, holdout split 1/1 (2 cached)",
        "  training 1/2, loss 0.5",
        "[2/2] quick on data, holdout split 1/1 (2 cached, 1 ok)",
    ]
