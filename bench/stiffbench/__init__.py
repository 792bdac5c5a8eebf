"""stiffbench: fit, test and compare stiffness models of industrial robots.

>>> import stiffbench as sb
>>> data = sb.load_dataset("kr10-twin", specimen=3)
>>> model = sb.make_model("vjm").fit(data)
>>> model.predict(data.samples.q[:2], data.samples.wrench[:2]).shape
(2, 3)

Each name is imported at its first use, so that `import stiffbench` is fast.
"""

from __future__ import annotations

import functools
import importlib
import re
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from stiff_apply.example_path import example_path as example_path
    from stiff_apply.postures import rank_postures as rank_postures
    from stiff_apply.robot_programs import compensate_program as compensate_program
    from stiff_apply.stiffness_map import StiffnessMap as StiffnessMap
    from stiff_apply.stiffness_map import stiffness_map as stiffness_map
    from stiff_apply.tool_paths import compensate_path as compensate_path
    from stiff_bench.api.data_sets import Dataset as Dataset
    from stiff_bench.api.data_sets import drilled_holes as drilled_holes
    from stiff_bench.api.data_sets import load_dataset as load_dataset
    from stiff_bench.api.data_sets import read_samples as read_samples
    from stiff_bench.api.evaluation import evaluate as evaluate
    from stiff_bench.api.measuring import plan_poses as plan_poses
    from stiff_bench.api.measuring import simulate as simulate
    from stiff_bench.api.measuring import validate as validate
    from stiff_bench.api.model import Model as Model
    from stiff_bench.api.model import load_model as load_model
    from stiff_bench.api.model import make_model as make_model
    from stiff_bench.api.pictures import figure as figure
    from stiff_bench.api.pictures import paper_table as paper_table
    from stiff_bench.api.records import export_results as export_results
    from stiff_bench.api.registered import list_datasets as list_datasets
    from stiff_bench.api.registered import list_figures as list_figures
    from stiff_bench.api.registered import list_metrics as list_metrics
    from stiff_bench.api.registered import list_models as list_models
    from stiff_bench.api.registered import list_protocols as list_protocols
    from stiff_bench.api.registered import show as show
    from stiff_bench.api.robots import load_robot as load_robot
    from stiff_bench.api.robots import read_robot as read_robot
    from stiff_bench.model_tools.plugins import check as check
    from stiff_bench.page.report import report as report
    from stiff_bench.plan.registry import use_plugin as use_plugin
    from stiff_bench.results.results import Results as Results
    from stiff_bench.results.results import open_results as open_results
    from stiff_bench.results.selection import Selection as Selection
    from stiff_bench.store.merging import merge as merge
    from stiff_bench.tables.writers import Tables as Tables
    from stiff_protocols.contract.types import Robot as Robot
    from stiff_protocols.contract.types import Samples as Samples

_IMPORTS = re.findall(r"^    from (\S+) import (\w+) as", Path(__file__).read_text("utf-8"), re.M)
"""Module and name of the imports above, which are for type checkers."""
MODULE_OF = {name: module for module, name in _IMPORTS}
__all__ = [*MODULE_OF]
_ROBOT_EXAMPLE = (
    'with your tool, robot=load_robot("ur5", tcp=(0, 0, 0.1)) or read_robot(urdf, tcp=...)'
)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # slow import (20 ms), not needed for commands

        return version("stiffbench")
    if name not in MODULE_OF:
        raise AttributeError(f"module 'stiffbench' has no attribute {name!r}")
    member = getattr(importlib.import_module(MODULE_OF[name]), name)
    return _with_known_arguments(member) if isinstance(member, FunctionType) else member


@functools.cache
def _with_known_arguments(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function; called with an unknown argument, it names the right one."""
    import inspect  # slow, not needed by `import stiffbench`

    parameters = inspect.signature(function).parameters
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()):
        return function

    @functools.wraps(function)
    def called(*args: Any, **arguments: Any) -> Any:
        if unknown := next((name for name in arguments if name not in parameters), None):
            from stiff_protocols.contract.errors import unknown_name

            listed = ", ".join(sorted(parameters))
            listed += f"; {_ROBOT_EXAMPLE}" * (unknown in ("tcp", "tip", "urdf"))
            raise unknown_name(f"argument of {function.__name__}", unknown, parameters, listed)
        return function(*args, **arguments)

    return called


def __dir__() -> list[str]:
    return __all__
