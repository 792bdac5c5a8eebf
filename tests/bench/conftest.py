"""Provide a fitted model and its file."""

from __future__ import annotations

from pathlib import Path

import pytest

import stiffbench as sb
from stiff_protocols.contract.types import BenchmarkData


@pytest.fixture(scope="module")
def vjm(twin: BenchmarkData) -> sb.Model:
    """Return a VJM of the KR10's twin, one a file of tests: it warns once."""
    return sb.make_model("vjm").fit(twin)


@pytest.fixture(scope="module")
def vjm_file(vjm: sb.Model, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("model") / "vjm.stiff"
    vjm.save(path)
    return path
