"""Progress of a run on a terminal and in a notebook."""

from __future__ import annotations

import io
from types import SimpleNamespace

from rich.console import Console
from rich.progress import Progress as Bars

from stiff_bench.run.progress import Display, NotebookDisplay
from stiff_protocols.contract.progress import Progress


def cell(model):
    """Return a stub of a cell and its result."""
    presentation = SimpleNamespace(model=model, dataset="data", protocol="holdout")
    identity = SimpleNamespace(condition="", split_index=0)
    return SimpleNamespace(status="ok", presentation=presentation, cell=identity, n_splits=1)


def test_off_a_terminal_lines_name_cells_phases_and_what_became_of_them(capsys):
    display = Display(Bars(console=Console(file=io.StringIO(), force_terminal=False)))
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

    def __call__(self, content, raw, display_id):
        assert raw and display_id and not self.displays  # one output, which changes
        self.update(content, raw)
        return self

    def update(self, content, raw):
        self.displays.append(content["text/plain"])


def test_in_a_notebook_one_output_has_the_newest_line_and_failures_stay(monkeypatch, capsys):
    output = Output()
    monkeypatch.setattr("IPython.display.display", output)
    display = NotebookDisplay(Bars(console=Console(file=io.StringIO()), disable=True))
    display.begin(1, 0)
    display.start(cell("broken"))
    display.step(Progress("training", 1, 2, 0.5))
    failed = {**vars(cell("broken")), "status": "failed", "failure": "why", "log": ()}
    display.end(SimpleNamespace(**failed))
    display.close(3.2)
    assert output.displays == [
        "[1/1] broken on data, holdout split 1/1",
        "  training 1/2, loss 0.5",
        "1 failed in 3 s",
    ]
    assert capsys.readouterr().out == "  broken: FAILED: why\n"
