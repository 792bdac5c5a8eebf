"""The time that a run says is left."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from rich.console import Console
from rich.progress import Progress as Bars

from stiff_bench.run import progress
from stiff_bench.run.progress import BarDisplay, Count, Expected, _TimeLeft


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still until it is moved."""
    time = SimpleNamespace(now=0.0)
    monkeypatch.setattr(progress.time, "monotonic", lambda: time.now)
    return time


def ended(model):
    """What is needed of a cell's result."""
    return SimpleNamespace(status="ok", shown=SimpleNamespace(model=model))


def expected(*models, at_once=1):
    tasks = [SimpleNamespace(shown=SimpleNamespace(model=model)) for model in models]
    return Expected.of(tasks, {"quick": 10.0, "long": 90.0}, at_once)


COSTS = expected("quick", "long")


def test_a_model_without_a_stored_fit_leaves_nothing_to_expect():
    assert expected("quick", "new") is None and expected("quick") is not None


def test_a_long_cell_that_is_to_come_counts_for_more_than_the_quick_one_that_is_done(clock):
    count, plain = Count(2, 0, COSTS), Count(2, 0, None)
    clock.now = 10.0
    for one in (count, plain):
        one.end(ended("quick"))
    assert count.seconds_left() == pytest.approx(90.0)
    assert plain.seconds_left() == pytest.approx(10.0)


def test_a_machine_that_is_slower_than_the_forecast_corrects_it(clock):
    count = Count(2, 0, COSTS)
    clock.now = 30.0  # for what was to take 10
    count.end(ended("quick"))
    assert count.seconds_left() == pytest.approx(270.0)


def test_the_time_left_falls_while_a_long_cell_runs(clock):
    count, by_two = Count(2, 0, COSTS), Count(2, 0, expected("quick", "long", at_once=2))
    assert by_two.seconds_left() == pytest.approx(50.0)
    left = []
    for clock.now in (0.0, 30.0, 60.0, 89.0, 200.0):
        left.append(count.seconds_left())
    assert left == pytest.approx([100.0, 70.0, 40.0, 11.0, 0.0])


def test_the_bar_says_how_long_a_run_takes_before_its_first_cell_has_ended(clock):
    with Bars(_TimeLeft(), console=Console(file=io.StringIO()), auto_refresh=False) as bars:
        BarDisplay(bars).begin(2, 0, COSTS)
        shown = _TimeLeft().render(bars.tasks[0])
        assert str(shown) == "0:01:40"


def test_nothing_is_left_when_all_cells_have_ended_and_nothing_is_said_where_nobody_knows(clock):
    count, unknown = Count(1, 0, expected("quick")), Count(1, 0, None)
    assert unknown.seconds_left() is None
    clock.now = 25.0
    count.end(ended("quick"))
    assert count.seconds_left() == 0.0
