"""Fixtures of stored results that a test makes."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.made_results import MadeResults


@pytest.fixture()
def made(tmp_path: Path) -> MadeResults:
    return MadeResults(tmp_path)
