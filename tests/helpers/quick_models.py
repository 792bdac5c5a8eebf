"""Every built-in model, fitted once a session with its quick options for tests that need one."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from stiff_datasets.twin.kr10_twin import Kr10Twin
from stiff_models.model_catalog import FAMILIES, MODELS, model_info
from stiff_protocols.contract.types import BenchmarkData

KEYS = [*(info.key for info in MODELS), *(family.example for family in FAMILIES)]


@functools.cache
def twin_data() -> BenchmarkData:
    return Kr10Twin().load()


@functools.cache
def quick_model(key: str) -> Any:
    """The model of a key with its quick options; skips where it cannot be used."""
    info = model_info(key)
    if info.missing():
        pytest.skip(info.missing())
    return fitted(key, info.quick)


def fitted(key: str, options: Mapping[str, Any], *, chosen: bool = False, **seed: int) -> Any:
    """A model on every fourth pose of the KR10 twin; `chosen`: by validation rows, if it can."""
    info, data = model_info(key), twin_data()
    model = info.load()(**options)
    if "device" in model.get_params():
        model.set_params(device="cpu")
    rows = np.arange(0, len(data.samples), 4)
    held_out = data.samples.take(rows + 1) if chosen and info.uses_validation else None
    return model.fit(data.samples.take(rows), robot=data.robot, validation=held_out, **seed)
