"""Progress of a run on a terminal and in a notebook."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from rich.console import Console
from rich.progress import Progress as Bars

from stiff_bench.run import progress
from stiff_bench.run.progress import NotebookDisplay, RunDisplay
from stiff_protocols.contract.progress import Progress


def cell(model):
    """Return a stub of a cell and its result."""
    presentation = SimpleNamespace(model=model, dataset="data", protocol="holdout")
    identity = SimpleNamespace(condition="", split_index=0)
    return SimpleNamespace(status="ok", presentation=presentation, cell=identity, n_splits=1)


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


class Output:
    """The output of a notebook cell, as a list of what it displayed."""

    def __init__(self):
        self.displays = []

    def __call__(self, thing, display_id=None):
        assert display_id and not self.displays  # one output, which changes
        self.update(thing)
        return self

    def update(self, thing, raw=False):
        self.displays.append(thing if raw else thing._repr_mimebundle_((), ()))


@pytest.fixture()
def output(monkeypatch):
    made = Output()
    monkeypatch.setattr("IPython.display.display", made)
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_BARS", 0.0)
    return made


def notebook_display(delay, monkeypatch):
    monkeypatch.setattr(progress, "SECONDS_BEFORE_BARS", delay)
    return NotebookDisplay(Bars(console=Console(file=io.StringIO()), disable=True))


def test_in_a_notebook_one_output_holds_the_bars_and_then_one_line(output, monkeypatch, capsys):
    display = notebook_display(0.0, monkeypatch)
    display.begin(2, 0)
    display.start(cell("quick"))
    display.step(Progress("training", 1, 2, 0.5))
    bars = output.displays[-1]["text/html"]
    assert "quick on data" in bars and "training" in bars and "━" in bars
    display.end(cell("quick"))
    display.close()
    assert output.displays[-1]["text/plain"].startswith("1 ok in ")
    assert "text/html" not in output.displays[-1]
    assert not any(capsys.readouterr())


def test_in_a_notebook_quick_work_shows_no_bars(output, monkeypatch):
    display = notebook_display(60.0, monkeypatch)
    display.begin(1, 0)
    display.start(cell("quick"))
    display.end(cell("quick"))
    display.close()
    assert output.displays == []


def test_a_failure_stays_in_a_notebook_with_its_reason(output, monkeypatch, capsys):
    display = notebook_display(0.0, monkeypatch)
    display.begin(1, 0)
    display.start(cell("broken"))
    failed = {**vars(cell("broken")), "status": "failed", "failure": "why", "log": ()}
    display.end(SimpleNamespace(**failed))
    display.close()
    assert "broken: FAILED: why" in capsys.readouterr().out
    assert output.displays[-1]["text/plain"].startswith("1 failed in ")
