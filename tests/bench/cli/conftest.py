"""Fixtures of the command's tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from stiff_bench.figures.prepared_figure import Prepared


@pytest.fixture()
def empty_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write pictures as empty files: drawing takes seconds, and other tests draw them."""

    def save(self: Prepared, path: Path | str) -> None:
        Path(path).touch(exist_ok=False)

    monkeypatch.setattr(Prepared, "save", save)
