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
    from stiff_bench.api.data_sets import Dataset, load_dataset, read_samples
    from stiff_bench.api.evaluation import evaluate
    from stiff_bench.api.measuring import plan_poses, simulate, validate
    from stiff_bench.api.model import Model, coverage_of_each_axis, load_model, make_model
    from stiff_bench.api.registered import (
        check,
        list_datasets,
        list_figures,
        list_metrics,
        list_models,
        list_protocols,
        show,
        use_plugin,
    )
    from stiff_bench.api.robots import load_robot, read_robot
    from stiff_bench.api.stored_results import Results, figure, merge, open_results, paper_table
    from stiff_bench.api.tables import Tables
    from stiff_bench.api.tool_paths import compensate_path, example_path
    from stiff_protocols.contract.types import Robot, Samples

_PLACES = {
    "stiff_bench.api.registered": (
        *("check", "list_datasets", "list_figures", "list_metrics"),
        *("list_models", "list_protocols"),
        *("show", "use_plugin"),
    ),
    "stiff_bench.api.data_sets": ("Dataset", "load_dataset", "read_samples"),
    "stiff_bench.api.evaluation": ("evaluate",),
    "stiff_bench.api.measuring": ("plan_poses", "simulate", "validate"),
    "stiff_bench.api.model": ("Model", "coverage_of_each_axis", "load_model", "make_model"),
    "stiff_bench.api.tool_paths": ("compensate_path", "example_path"),
    "stiff_bench.api.stored_results": ("Results", "figure", "merge", "open_results", "paper_table"),
    "stiff_bench.api.robots": ("load_robot", "read_robot"),
    "stiff_bench.api.tables": ("Tables",),
    "stiff_protocols.contract.types": ("Robot", "Samples"),
}
_PLACE_OF = {name: module for module, names in _PLACES.items() for name in names}

__all__ = [
    "Dataset",
    "Model",
    "Results",
    "Robot",
    "Samples",
    "Tables",
    "check",
    "compensate_path",
    "coverage_of_each_axis",
    "evaluate",
    "example_path",
    "figure",
    "list_datasets",
    "list_figures",
    "list_metrics",
    "list_models",
    "list_protocols",
    "load_dataset",
    "load_model",
    "load_robot",
    "make_model",
    "merge",
    "open_results",
    "paper_table",
    "plan_poses",
    "read_robot",
    "read_samples",
    "show",
    "simulate",
    "use_plugin",
    "validate",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACE_OF:
        raise AttributeError(f"module 'stiffbench' has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACE_OF[name]), name)


def __dir__() -> list[str]:
    return __all__
