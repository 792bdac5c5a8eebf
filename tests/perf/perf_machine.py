"""What the machine itself can do: the limits that the other benchmarks are read against."""

from __future__ import annotations

import pytest
import torch

from perf_case import figure, peer

ROWS, WIDTH = 1024, 380  # of a pre-training step
GFLOP = 2e-9 * ROWS * WIDTH * WIDTH
ENTRIES = 32_000_000  # 256 MB, far beyond every cache


@pytest.mark.benchmark(group="machine: matrix product, 1024 x 380 x 380")
@pytest.mark.parametrize("route", ["float32 (default)", "float32 (medium)", "bfloat16"])
def test_matrix_product(benchmark, route):
    precision = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium" if "medium" in route else precision)
    kind = torch.bfloat16 if route == "bfloat16" else torch.float32
    torch.manual_seed(0)
    left, right = torch.randn(ROWS, WIDTH, dtype=kind), torch.randn(WIDTH, WIDTH, dtype=kind)
    peer(benchmark, route, work=GFLOP, unit="GFLOP")
    result = benchmark(torch.mm, left, right)
    torch.set_float32_matmul_precision(precision)
    exact = left.double() @ right.double()
    error = ((result.double() - exact).norm() / exact.norm()).item()
    figure(benchmark, "relative error", error, "")


@pytest.mark.benchmark(group="machine: memory, 256 MB")
@pytest.mark.parametrize("way", ["read", "copy"])
def test_memory(benchmark, way):
    source, goal = (
        torch.ones(ENTRIES, dtype=torch.float64),
        torch.zeros(ENTRIES, dtype=torch.float64),
    )
    gigabytes = 1e-9 * source.nbytes * (1 if way == "read" else 2)
    peer(benchmark, way, work=gigabytes, unit="GB")
    if way == "read":
        benchmark(source.sum)
    else:
        benchmark(goal.copy_, source)
