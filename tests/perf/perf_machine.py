"""What the machine itself can do: the limits that the other benchmarks are read against."""

from __future__ import annotations

import pytest
import torch

from perf_case import figure, peer


@pytest.mark.benchmark(group="machine: matrix product, 1024 x 380 x 380")  # of a pre-training step
@pytest.mark.parametrize("route", ["float32 (default)", "float32 (medium)", "bfloat16"])
def test_matrix_product(benchmark, route):
    precision = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium" if "medium" in route else precision)
    kind = torch.bfloat16 if route == "bfloat16" else torch.float32
    torch.manual_seed(0)
    left, right = torch.randn(1024, 380, dtype=kind), torch.randn(380, 380, dtype=kind)
    peer(benchmark, route, work=2e-9 * 1024 * 380**2, unit="GFLOP")
    result = benchmark(torch.mm, left, right)
    torch.set_float32_matmul_precision(precision)
    exact = left.double() @ right.double()
    figure(benchmark, "relative error", ((result - exact).norm() / exact.norm()).item(), "")


@pytest.mark.benchmark(group="machine: memory, 256 MB")
@pytest.mark.parametrize("way", ["read", "copy"])
def test_memory(benchmark, way):
    source = torch.ones(32_000_000, dtype=torch.float64)  # far beyond every cache
    goal = torch.zeros_like(source)
    peer(benchmark, way, work=1e-9 * source.nbytes * (1 if way == "read" else 2), unit="GB")
    benchmark(source.sum if way == "read" else lambda: goal.copy_(source))
