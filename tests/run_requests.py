"""Requests of `bench run`, as tests that need no command line make them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stiff_bench.plan.registry import Registry, build_registry
from stiff_bench.plan.request import RunPlan, RunRequest, plan_run
from stiff_bench.plan.robots import RobotWords


def planned(registry: Registry | None = None, **changes: Any) -> RunPlan:
    """The checked plan of `bench run --model vjm`, changed as said."""
    words: dict[str, Any] = {
        "models": ("vjm",),
        "datasets": ("kr10-twin",),
        "protocols": ("holdout",),
        "metrics": ("mae",),
        "splits": None,
        "seed": 0,
        "settings": (),
        "device": "cpu",
        "output": Path("unused"),
        "data": None,
        "robot": RobotWords(None, None, ""),
        "command": "bench run",
    }
    return plan_run(RunRequest(**(words | changes)), registry or build_registry())
