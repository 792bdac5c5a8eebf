"""Benchmarks are collected by `pytest --benchmark-only` and `bench perf` alone."""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    if collection_path.name.startswith("perf_") and not config.getoption("benchmark_only"):
        return True
    return None
