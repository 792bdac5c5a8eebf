"""A quick study, and a plugin for it."""

from __future__ import annotations

from pathlib import Path

import pytest

STUDY = """
title = "small"
models = ["vjm", "mean"]
datasets = ["kr10-twin", "ur5-twin"]
protocols = ["holdout"]
metrics = ["norm"]
splits = 1
lite = ["kr10-twin", "ur5-twin"]
[[run]]
[[run]]
seed = 1
"""
BOARD_STUDY = """
title = "board"
models = ["vjm", "mean"]
datasets = ["one", "two"]
splits = 1
tables = ["leaderboard"]
[groups]
one = ["arm-family", "arm-family@robot=1", "arm-family@robot=2"]
two = ["arm-family@robot=3", "arm-family@robot=4"]
[board]
protocol = "holdout"
"""
PLUGIN = '''
"""Half of what springs predict."""

from stiff_models.physics.vjm import VirtualJointModel
from stiff_protocols.contract.plugin import ModelInfo


class HalfSprings(VirtualJointModel):
    def predict(self, q, wrench):
        return 0.5 * super().predict(q, wrench)


MODELS = [ModelInfo(key="half-springs", target=HalfSprings, summary="half of the springs")]
'''


@pytest.fixture(scope="session")
def study_file(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("study") / "small.toml"
    file.write_text(STUDY)
    return file


@pytest.fixture(scope="session")
def board_study(tmp_path_factory) -> Path:
    """Write a study of five robots."""
    file = tmp_path_factory.mktemp("study") / "board.toml"
    file.write_text(BOARD_STUDY)
    return file


@pytest.fixture(scope="session")
def half_springs(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("plugin") / "half_springs.py"
    file.write_text(PLUGIN)
    return file
