"""The functions of `import stiffbench` and of the commands."""

import importlib
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from stiff_datasets.measured.file_options import LARGEST_POSE_TOLERANCE as LARGEST_POSE_TOLERANCE
from stiff_datasets.measured.file_options import POSE_TOLERANCE as POSE_TOLERANCE

if TYPE_CHECKING:
    from stiff_bench.api import data_files as data_files
    from stiff_bench.api import data_sets as data_sets
    from stiff_bench.api import evaluation as evaluation
    from stiff_bench.api import measuring as measuring
    from stiff_bench.api import model as model
    from stiff_bench.api import pictures as pictures
    from stiff_bench.api import records as records
    from stiff_bench.api import registered as registered
    from stiff_bench.api import robots as robots
    from stiff_bench.api import submissions as submissions

RESULTS = Path("results/runs")
"""Default folder of results for `bench run` and for the commands that read results."""


def __getattr__(name: str) -> ModuleType:
    """Import a module of this package at its first use, so that help is fast."""
    try:
        return importlib.import_module(f"stiff_bench.api.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"stiff_bench.api.{name}":
            raise
        raise AttributeError(f"module 'stiff_bench.api' has no attribute {name!r}") from None
