"""What several test files need."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stiff_datasets.robots.robot import ChainModel, shipped_chain, shipped_robot
from stiff_protocols.types import Robot

KR10_TCP = (0.06, 0.0, 0.08)


@pytest.fixture(scope="session")
def kr10() -> Robot:
    return shipped_robot("kr10_r1100_2", tcp=KR10_TCP)


@pytest.fixture(scope="session")
def kr10_chain() -> ChainModel:
    return shipped_chain("kr10_r1100_2", tcp=KR10_TCP)


@pytest.fixture()
def rng() -> np.random.Generator:
    return np.random.default_rng(20261121)


PLUGIN = '''"""A model in ten lines."""
import numpy as np
from sklearn.base import BaseEstimator
from stiff_protocols.plugin import ModelInfo


class MeanDeflection(BaseEstimator):
    def __init__(self, *, factor: float = 1.0):
        self.factor = factor

    def fit(self, train, *, robot, validation=None, seed=0):
        self.mean_ = self.factor * train.deflection.mean(axis=0)
        return self

    def predict(self, q, wrench):
        return np.tile(self.mean_, (len(q), 1))


MODELS = [ModelInfo(key="KEY", target=MeanDeflection, summary="mean of the training part")]
'''


@pytest.fixture()
def plugin_file(tmp_path: Path) -> Callable[[str], Path]:
    """A function that writes the ten-line model under a key and returns its file."""

    def write(key: str) -> Path:
        path = tmp_path / "my_model.py"
        path.write_text(PLUGIN.replace("KEY", key))
        return path

    return write
