"""Settings of a process before libraries are loaded."""

from __future__ import annotations

import pytest

from stiff_bench.run.machine import keep_libraries_in_our_cache


@pytest.mark.parametrize("home_is_file", [True, False])
def test_libraries_use_our_cache_only_if_it_can_be_written(tmp_path, monkeypatch, home_is_file):
    """torch makes its folder on import, and its import fails without it."""
    home = tmp_path / "home"
    home.write_text("") if home_is_file else home.mkdir()
    monkeypatch.setenv("STIFFBENCH_CACHE", str(home / "cache"))
    environment: dict[str, str] = {}
    monkeypatch.setattr("stiff_bench.run.machine.os.environ", environment)
    monkeypatch.setattr("stiff_models.io.cache_folder.os.environ", environment)
    environment["STIFFBENCH_CACHE"] = str(home / "cache")
    keep_libraries_in_our_cache()
    assert ("TORCHINDUCTOR_CACHE_DIR" in environment) is not home_is_file
