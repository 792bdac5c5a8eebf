"""What several test files need."""

from __future__ import annotations

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
