"""The time that a run says is left."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from rich.console import Console
from rich.progress import Progress as Bars

from stiff_bench.run import progress
from stiff_bench.run.progress import BarDisplay, Display, _TimeLeft


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still until it is moved."""
    time = SimpleNamespace(now=0.0)
    monkeypatch.setattr(progress.time, "monotonic", lambda: time.now)
    return time


def cell(model):
    """What is needed of a cell, and of its result."""
    return SimpleNamespace(status="ok", shown=SimpleNamespace(model=model))


def begun(*models, at_once=1, display=None):
    """A display of a run of these models."""
    display = display or Display()
    display.begin([cell(model) for model in models], 0, {"quick": 10.0, "long": 90.0}, at_once)
    return display


def left(display):
    return display.time_left.total_seconds()


def test_a_long_cell_that_is_to_come_counts_for_more_than_the_quick_one_that_is_done(clock):
    weighed, plain = begun("quick", "long"), begun("quick", "new")
    assert plain.time_left is None  # a model has no stored fit
    clock.now = 10.0
    for display in (weighed, plain):
        display.end(cell("quick"))
    assert (left(weighed), left(plain)) == (90.0, 10.0)


def test_a_machine_that_is_slower_than_the_forecast_corrects_it(clock):
    display = begun("quick", "long")
    clock.now = 30.0  # for what was to take 10
    display.end(cell("quick"))
    assert left(display) == 270.0


def test_the_time_left_falls_while_a_long_cell_runs_and_is_unknown_once_it_outlasts_that(clock):
    display = begun("quick", "long")
    assert left(begun("quick", "long", at_once=2)) == 50.0
    seconds = []
    for clock.now in (0.0, 30.0, 60.0, 89.0):
        seconds.append(left(display))
    assert seconds == [100.0, 70.0, 40.0, 11.0]
    clock.now = 200.0
    assert display.time_left is None
    for model in ("quick", "long"):
        display.end(cell(model))
    assert left(display) == 0.0


def test_the_bar_says_how_long_a_run_takes_before_its_first_cell_has_ended(clock):
    with Bars(_TimeLeft(), console=Console(file=io.StringIO()), auto_refresh=False) as bars:
        begun("quick", "long", display=BarDisplay(bars))
        assert str(_TimeLeft().render(bars.tasks[0])) == "0:01:40"
        clock.now = 200.0
        assert str(_TimeLeft().render(bars.tasks[0])) == "-:--:--"
