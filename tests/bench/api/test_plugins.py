"""`bench check` and `bench new model`: what they print, write and refuse."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from helpers.command_line import bench_here
from stiff_bench.model_tools.plugins import check, new_model
from stiff_bench.plan.registry import registry
from stiff_models.model_catalog import model_info
from stiff_protocols.contract.errors import ConfigError, StiffBenchError, StoreError
from stiff_protocols.contract.plugin import ModelInfo


@pytest.mark.slow
def test_a_new_model_passes_its_own_test_and_the_suite_and_can_be_run_as_it_stands(tmp_path):
    made = bench_here("new", "model", "My-Spring", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my_spring.py", "test_my_spring.py"]
    head, first, *commands = made.stdout.splitlines()
    assert "key is my-spring" in head and first == "  python -m pytest test_my_spring.py"
    tested = subprocess.run(
        [sys.executable, *first.split()[1:], "-W", "error", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert "2 passed" in tested.stdout, tested.stdout
    for line in commands:  # the printed commands
        done = bench_here(*line.split()[1:], cwd=tmp_path)
        assert done.returncode == 0, done.stderr + done.stdout
        assert "my-spring" in done.stdout


def test_an_invalid_name_is_refused_and_nothing_is_written(tmp_path):
    reasons = {"../up": "not a valid model name", "class": "keyword", "FT-MLP": "taken"}
    for name, reason in (reasons | {"_x": "a letter", "numpy": "already has a module"}).items():
        with pytest.raises(ConfigError, match=reason):
            new_model(name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_exists_is_left_as_it_is_and_no_other_is_written(tmp_path):
    test = tmp_path / "test_spring.py"
    test.write_text("mine")
    with pytest.raises(StoreError, match=r"test_spring\.py: exists"):
        new_model("spring", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["test_spring.py"]
    assert test.read_text() == "mine"


def test_a_check_of_a_bad_plugin_prints_failures_reasons_and_fixes_with_status_1(
    plugin_file, tmp_path
):
    words = ("check", "own", "--plugin", plugin_file("own"))
    good = bench_here(*words, cwd=tmp_path)
    assert good.returncode == 0 and "✗" not in good.stdout
    done = bench_here(*words, "--set", "own.factor=1000", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("own (factor=1000") and " on fanuc-r2000ic" in lines[0]
    assert "✓ the constructor takes keywords and only stores them" in lines
    (metres,) = (i for i, line in enumerate(lines) if line[:1] == "✗" and "in metres" in line)
    assert lines[metres + 1].startswith("    to ") and "1 failed" in lines[-1]
    assert {path.name for path in tmp_path.iterdir()} <= {"my_model.py", "__pycache__"}


def missing_reason() -> str:
    return "no weights"


def test_a_model_that_cannot_be_used_is_refused_with_its_reason():
    reason = f"{__name__}:missing_reason"
    extra = ModelInfo(key="extra", target=dict, summary="", missing_because=reason)
    registry.cache_clear()
    registry().add([extra], "test")
    with pytest.raises(StiffBenchError, match="'extra' cannot be checked here: no weights"):
        check("extra")
    registry.cache_clear()


def test_show_gives_every_option_with_its_default_and_valid_values(tmp_path):
    lines = bench_here("show", "vjm-gp", cwd=tmp_path).stdout.splitlines()
    options = model_info("vjm-gp").load()().get_params()
    for name, default in options.items():
        (line,) = (line for line in lines if re.match(rf"  {name} +default: ", line))
        assert f"default: {default}".lower() in line.lower() and "valid: " in line
