"""`bench new model` writes both of its files, or none."""

from __future__ import annotations

from pathlib import Path

import pytest

from stiff_bench.model_tools.plugins import new_model
from stiff_bench.plan.registry import build_registry
from stiff_protocols.contract.errors import StoreError


def test_when_the_second_file_cannot_be_put_in_place_the_first_is_taken_away(tmp_path, monkeypatch):
    put = Path.replace

    def refuse(self, target):
        if not target.name.startswith("test_"):
            raise OSError(28, "No space left on device")
        return put(self, target)

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(StoreError, match="No space left"):
        new_model("spring", tmp_path, build_registry())
    assert list(tmp_path.iterdir()) == []
