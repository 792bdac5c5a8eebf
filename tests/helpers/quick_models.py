"""Every built-in model, fitted once per session with its quick options."""

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
    """Return a key's model with its quick options; skip the test if it is not available."""
    info = model_info(key)
    if info.missing():
        pytest.skip(info.missing())
    return fitted(key, info.quick)


def fitted(key: str, options: Mapping[str, Any], *, chosen: bool = False, **seed: int) -> Any:
    """Fit a model to every fourth pose of the KR10 twin; `chosen`: with validation rows."""
    info, data = model_info(key), twin_data()
    model = info.load()(**options)
    if "device" in model.get_params():
        model.set_params(device="cpu")
    rows = np.arange(0, len(data.samples), 4)
    held_out = data.samples.take(rows + 1) if chosen and info.uses_validation else None
    return model.fit(data.samples.take(rows), robot=data.robot, validation=held_out, **seed)
