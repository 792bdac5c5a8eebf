"""The registry: ours, files, installed packages; what collides and what is broken."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from stiff_bench.registry import build_registry
from stiff_protocols.errors import ConfigError


def test_the_shipped_entries_are_all_there_and_can_be_imported():
    registry = build_registry()
    assert list(registry.models) == ["vjm", "mlp", "mlp-pretrained", "ft-mlp"]
    assert {"kr10-twin", "fanuc-r2000ic"} <= set(registry.datasets)
    assert {"holdout", "paper-holdout", "leave-one-out"} <= set(registry.protocols)
    for table in (registry.models, registry.datasets, registry.protocols):
        assert all(isinstance(info.load(), type) for info in table.values())


def test_a_plugin_file_adds_its_models(plugin_file):
    registry = build_registry([plugin_file("mean-deflection")])
    assert registry.models["mean-deflection"].load().__name__ == "MeanDeflection"


def test_a_key_that_is_taken_is_refused_naming_both_owners(plugin_file):
    with pytest.raises(ConfigError, match=r"my_model\.py: key 'vjm' is taken by stiffbench"):
        build_registry([plugin_file("vjm")])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = (", "SyntaxError"),
        ("import not_there", "ModuleNotFoundError: No module named 'not_there'"),
        ("x = 1", "defines nothing"),
        ("MODELS = [3]", "3 is no ModelInfo"),
    ],
)
def test_a_plugin_file_that_cannot_be_used_is_refused(tmp_path, text, message):
    path = tmp_path / "bad.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        build_registry([path])
    with pytest.raises(ConfigError, match="no such file"):
        build_registry([tmp_path / "absent.py"])


@pytest.fixture()
def installed(tmp_path, plugin_file) -> dict[str, str]:
    """Two third-party packages installed beside stiffbench: a working and a broken one."""
    package = tmp_path / "package"
    package.mkdir()
    plugin_file("tiny").rename(package / "tiny_stiffness.py")
    (package / "broken_stiffness.py").write_text("import not_there\n")
    (package / "pyproject.toml").write_text(
        """
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"
[project]
name = "tiny-stiffness"
version = "1"
[project.entry-points."stiffbench.models"]
tiny = "tiny_stiffness:MODELS"
broken = "broken_stiffness:MODELS"
[tool.setuptools]
py-modules = ["tiny_stiffness", "broken_stiffness"]
"""
    )
    site = tmp_path / "site"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", site, package],
        check=True,
    )
    return {**os.environ, "PYTHONPATH": str(site)}


def test_an_installed_package_adds_its_model_and_a_broken_one_is_reported(installed, tmp_path):
    words = ["run", "--model", "tiny", "--set", "tiny.factor=0", "--output", str(tmp_path / "out")]
    done = subprocess.run(
        [sys.executable, "-m", "stiff_bench.cli", *words],
        env=installed,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "| tiny " in done.stdout
    assert "plugin left out: tiny-stiffness (stiffbench.models: broken)" in done.stderr
    assert "No module named 'not_there'" in done.stderr
