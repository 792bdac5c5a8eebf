"""What the machine's memory can do: a limit that the other benchmarks are read against."""

from __future__ import annotations

import pytest
import torch

from helpers.perf_case import ours_or_peer


@pytest.mark.benchmark(group="machine: memory, 256 MB")
@pytest.mark.parametrize("way", ["read", "copy"])
def test_memory(benchmark, way):
    source = torch.ones(32_000_000, dtype=torch.float64)  # far beyond every cache
    goal = torch.zeros_like(source)
    ours_or_peer(benchmark, way, work=1e-9 * source.nbytes * (1 if way == "read" else 2), unit="GB")
    benchmark(source.sum if way == "read" else lambda: goal.copy_(source))
