"""Settings of a process, and its environment in a run's manifest."""

from __future__ import annotations

import hashlib
import re
import subprocess
from importlib.metadata import requires, version

import pytest

from stiff_bench.plan.registry import build_registry
from stiff_bench.run import machine
from stiff_bench.run.machine import environment, keep_libraries_in_our_cache


def test_every_dependency_is_named_with_its_version():
    facts = environment()
    assert all(isinstance(value, str) for value in facts.values())
    needed = {re.split(r"[^\w.-]", line)[0] for line in requires("stiffbench") if ";" not in line}
    assert {"numpy", "torch", "scikit-learn", "matplotlib"} <= needed <= facts.keys()
    assert all(facts[name] == version(name) for name in needed)
    assert facts["stiffbench"] == version("stiffbench")
    assert "ruff" not in facts and "pytest" not in facts


def test_variables_that_shape_numbers_are_there_and_others_are_not(monkeypatch):
    for name in ("MKL_CBWR", "OPENBLAS_CORETYPE", "CUBLAS_WORKSPACE_CONFIG", "STIFFBENCH_CACHE"):
        monkeypatch.setenv(name, f"value of {name}")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    facts = environment()
    assert facts["MKL_CBWR"] == "value of MKL_CBWR"
    assert facts["OPENBLAS_CORETYPE"] == "value of OPENBLAS_CORETYPE"
    assert "secret" not in str(facts)


def test_a_plugin_file_is_named_with_its_hash(plugin_file):
    path = plugin_file("mine")
    build_registry().add_file(path)
    expected = hashlib.sha256(path.read_bytes()).hexdigest()
    assert f"{path} sha256 {expected}" in environment()["plugins"]


@pytest.mark.parametrize("dirty", [False, True])
def test_commit_and_state_are_those_of_our_checkout(dirty, monkeypatch, tmp_path):
    def git(*words: str) -> str:
        about = ("-c", "user.name=n", "-c", "user.email=e@e", "-c", "commit.gpgsign=false")
        command = ["git", "-C", str(tmp_path), *about, *words]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    (tmp_path / "machine.py").write_text("")
    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    (tmp_path / "untracked").write_text("")
    if dirty:
        (tmp_path / "machine.py").write_text("changed")
    monkeypatch.setattr(machine, "__file__", str(tmp_path / "machine.py"))
    facts = environment()
    assert facts["commit"] == git("rev-parse", "HEAD")
    assert facts["dirty"] == str(dirty).lower()


@pytest.mark.parametrize("home_is_file", [True, False])
def test_libraries_use_our_cache_only_if_it_can_be_written(tmp_path, monkeypatch, home_is_file):
    """torch makes its folder on import, and its import fails without it."""
    home = tmp_path / "home"
    home.write_text("") if home_is_file else home.mkdir()
    monkeypatch.setenv("STIFFBENCH_CACHE", str(home / "cache"))
    variables: dict[str, str] = {}
    monkeypatch.setattr("stiff_bench.run.machine.os.environ", variables)
    monkeypatch.setattr("stiff_models.io.cache_folder.os.environ", variables)
    variables["STIFFBENCH_CACHE"] = str(home / "cache")
    keep_libraries_in_our_cache()
    assert ("TORCHINDUCTOR_CACHE_DIR" in variables) is not home_is_file
