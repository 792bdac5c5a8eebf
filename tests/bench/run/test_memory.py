"""Memory of a run and of a fit inside it."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from stiff_bench.run.costs import MemoryMeter, peak_memory_bytes

MIB = 2**20


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
