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


CARD = """
name = "Half springs"
model = "{model}"
plugin = "{plugin}"
kind = "physics"
authors = ["A. Author"]
year = 2026
url = "https://example.org"
reference = "none"
licence = "MIT"
summary = "Half of what springs predict."
tuned_on = "none"
hardware = "one core"
"""


@pytest.fixture
def submission_of(tmp_path):
    """A function that writes a submission with a plugin's text and further files."""

    def write(text: str, *, model: str = "mine", **files: str) -> Path:
        folder = tmp_path / "submission"
        (folder / "code").mkdir(parents=True)
        (folder / "card.toml").write_text(CARD.format(model=model, plugin="mine.py"))
        (folder / "code" / "mine.py").write_text(text)
        for name, content in files.items():
            (folder / "code" / name.replace("__", ".")).write_text(content)
        return folder

    return write
