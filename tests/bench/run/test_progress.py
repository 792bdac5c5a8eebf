"""What a run shows: how far it is."""

from __future__ import annotations

import io
from types import SimpleNamespace

from rich.console import Console
from rich.progress import Progress as Bars

from stiff_bench.run.progress import RunDisplay
from stiff_protocols.contract.progress import Progress


def cell(model):
    """What is needed of a cell, and of its result."""
    shown = SimpleNamespace(model=model, dataset="data", protocol="holdout")
    identity = SimpleNamespace(condition="", split_index=0)
    return SimpleNamespace(status="ok", shown=shown, cell=identity, n_splits=1)


def test_off_a_terminal_lines_name_cells_phases_and_what_became_of_them(capsys):
    display = RunDisplay(Bars(console=Console(file=io.StringIO(), force_terminal=False)))
    display.begin(2, 2)
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
