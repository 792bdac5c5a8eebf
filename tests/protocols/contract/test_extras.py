"""Check the messages of optional features whose package is not installed."""

from __future__ import annotations

import functools
import sys
import tomllib
from collections.abc import Mapping
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.extras import EXTRAS, missing, require

PROJECT = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text("utf-8"))
OPTIONAL = PROJECT["project"]["optional-dependencies"]


@functools.cache
def installed() -> Mapping[str, list[str]]:
    """Return the distributions of each importable name; reading all metadata takes seconds."""
    return packages_distributions()


@pytest.mark.slow
@pytest.mark.parametrize("package", EXTRAS)
def test_the_extra_that_a_message_names_installs_the_package(package):
    names = {name.lower().replace("_", "-") for name in installed().get(package, [package])}
    assert any(line.startswith(tuple(names)) for line in OPTIONAL[EXTRAS[package]])
    required = PROJECT["project"]["dependencies"]
    assert not any(line.startswith(tuple(names)) for line in required)


def test_the_message_names_what_is_missing_and_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert "package onnx: pip install 'stiffbench[onnx]'" in missing("onnx")
    with pytest.raises(ConfigError, match=r"^an export needs .*stiffbench\[onnx\]"):
        require("an export", "onnx")
    assert missing("pyarrow") == ""
    require("Parquet", "pyarrow")
