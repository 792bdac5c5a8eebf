"""stiffbench: fit, test and compare stiffness models of industrial robots.

>>> import stiffbench as sb
>>> data = sb.load_dataset("kr10-twin", specimen=3)
>>> model = sb.make_model("vjm").fit(data)
>>> model.predict(data.samples.q[:2], data.samples.wrench[:2]).shape
(2, 3)

What is named here is imported when it is first used, so that `import stiffbench` takes no time.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stiff_bench.api.data import Dataset, load_dataset, read_samples, use_plugin
    from stiff_bench.api.evaluation import evaluate
    from stiff_bench.api.model import Model, load_model, make_model
    from stiff_bench.api.results import Results, Tables, open_results
    from stiff_bench.api.robot import Robot
    from stiff_protocols.contract.types import Samples

_PLACES = {
    "stiff_bench.api.data": ("Dataset", "load_dataset", "read_samples", "use_plugin"),
    "stiff_bench.api.evaluation": ("evaluate",),
    "stiff_bench.api.model": ("Model", "load_model", "make_model"),
    "stiff_bench.api.results": ("Results", "Tables", "open_results"),
    "stiff_bench.api.robot": ("Robot",),
    "stiff_protocols.contract.types": ("Samples",),
}
_PLACE_OF = {name: module for module, names in _PLACES.items() for name in names}

__all__ = [
    "Dataset",
    "Model",
    "Results",
    "Robot",
    "Samples",
    "Tables",
    "evaluate",
    "load_dataset",
    "load_model",
    "make_model",
    "open_results",
    "read_samples",
    "use_plugin",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACE_OF:
        raise AttributeError(f"module 'stiffbench' has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACE_OF[name]), name)


def __dir__() -> list[str]:
    return __all__
