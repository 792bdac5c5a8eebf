"""Every built-in model, fitted once a session with its quick options for tests that need one."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.base import FittedModel
from stiff_models.catalog import FAMILIES, MODELS, model_info
from stiff_protocols.contract.types import BenchmarkData

KEYS = [*(info.key for info in MODELS), *(family.example for family in FAMILIES)]


@functools.cache
def twin_data() -> BenchmarkData:
    return Kr10Twin().load()


@functools.cache
def quick_model(key: str) -> FittedModel:
    """The model of a key on every fourth pose of the KR10 twin; skips where it cannot be used."""
    info = model_info(key)
    if info.missing():
        pytest.skip(info.missing())
    data = twin_data()
    cls = info.load()
    options = dict(info.quick)
    if "device" in cls(**options).get_params():
        options["device"] = "cpu"
    rows = np.arange(0, len(data.samples), 4)
    model: FittedModel = cls(**options).fit(data.samples.take(rows), robot=data.robot)
    return model
