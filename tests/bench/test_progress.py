"""The time that a run says is left."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from stiff_bench import progress
from stiff_bench.progress import Count, Expected


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still until it is moved."""
    time = SimpleNamespace(now=0.0)
    monkeypatch.setattr(progress.time, "monotonic", lambda: time.now)
    return time


def ended(model):
    return SimpleNamespace(status="ok", shown=SimpleNamespace(model=model))


COSTS = Expected(100.0, lambda shown: {"quick": 10.0, "long": 90.0}[shown.model])


def test_before_the_first_cell_the_forecast_is_what_is_left(clock):
    count = Count()
    count.begin(2, 0, COSTS)
    assert count.seconds_left() == pytest.approx(100.0)


def test_a_long_cell_that_is_to_come_counts_for_more_than_the_quick_one_that_is_done(clock):
    count, plain = Count(), Count()
    count.begin(2, 0, COSTS)
    plain.begin(2, 0, None)
    clock.now = 10.0
    for one in (count, plain):
        one.end(ended("quick"))
    assert count.seconds_left() == pytest.approx(90.0)
    assert plain.seconds_left() == pytest.approx(10.0)


def test_a_machine_that_is_slower_than_the_forecast_corrects_it(clock):
    count = Count()
    count.begin(2, 0, COSTS)
    clock.now = 30.0  # for what was to take 10
    count.end(ended("quick"))
    assert 150.0 < count.seconds_left() < 270.0


def test_nothing_is_left_when_all_cells_have_ended_and_nothing_is_said_where_nobody_knows(clock):
    count, unknown = Count(), Count()
    count.begin(1, 0, Expected(10.0, lambda shown: 10.0))
    unknown.begin(1, 0, None)
    assert unknown.seconds_left() is None
    clock.now = 25.0
    count.end(ended("any"))
    assert count.seconds_left() == 0.0
