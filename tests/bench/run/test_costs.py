"""What a run measures of a fitted model: latency of single rows, memory of a fit."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from stiff_bench.run.costs import (
    MOST_SINGLE_PREDICTIONS,
    MemoryMeter,
    latency,
    peak_memory_bytes,
)

MIB = 2**20
Q, WRENCH = np.arange(12.0).reshape(2, 6), np.arange(12.0, 24.0).reshape(2, 6)


def test_the_latency_of_a_model_is_that_of_one_row_after_another():
    asked = []
    model = SimpleNamespace(predict=lambda q, wrench: asked.append((q, wrench)))
    assert latency(model, Q, WRENCH) > 0.0
    assert len(asked) == MOST_SINGLE_PREDICTIONS
    for i, rows in enumerate(asked):
        np.testing.assert_array_equal(rows, [Q[i % 2 : i % 2 + 1], WRENCH[i % 2 : i % 2 + 1]])


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux forgets a peak on request")
def test_a_meter_sees_its_own_rise_alone_and_the_runs_peak_is_not_forgotten():
    large = np.ones(100 * MIB // 8)
    peak = peak_memory_bytes()
    del large
    meter = MemoryMeter()
    small = np.ones(40 * MIB // 8)
    assert 35 * MIB < meter.rise() < 60 * MIB
    del small
    assert MemoryMeter().rise() < 20 * MIB
    assert peak_memory_bytes() >= peak
