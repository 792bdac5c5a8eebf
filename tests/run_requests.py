"""Requests of `bench run`, as tests that need no command line make them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stiff_bench.plan.registry import Registry, build_registry
from stiff_bench.plan.request import RunPlan, plan_run
from stiff_bench.plan.words import choices

CHOOSING = ("models", "datasets", "protocols", "settings", "data", "robot")


def planned(registry: Registry | None = None, **changes: Any) -> RunPlan:
    """The checked plan of `bench run --model vjm`, changed as said."""
    words: dict[str, Any] = {"models": ("vjm",), "datasets": ("kr10-twin",)}
    words |= {"protocols": ("holdout",), "metrics": ("mae",), "device": "cpu"}
    words |= {"output": Path("unused"), "command": "bench run"} | changes
    chosen = {name: words.pop(name) for name in CHOOSING if name in words}
    registry = registry or build_registry()
    return plan_run(choices(registry, **chosen), registry, **words)
