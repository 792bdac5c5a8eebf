"""Requests of `bench run` without a command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from stiff_bench.plan.fits import FitTask, RunPlan, plan_run
from stiff_bench.plan.registry import Registry, build_registry
from stiff_bench.run.execution import compute_fit
from stiff_protocols.contract.record import FitResult


def planned(registry: Registry | None = None, **changes: Any) -> RunPlan:
    """Return the checked plan of `bench run --model vjm` with these changes."""
    words: dict[str, Any] = {"models": ("vjm",), "datasets": ("kr10-twin",)}
    words |= {"protocols": ("holdout",), "metrics": ("mae",), "device": "cpu"}
    words |= {"output": Path("unused"), "command": "bench run"} | changes
    return plan_run(registry or build_registry(), **words)


def with_model(task: FitTask, cls: type, **params: Any) -> FitTask:
    """Return the same fit with another model class."""
    return replace(task, model=replace(task.model, cls=cls, params=params, context={}))


def computed(task: FitTask) -> FitResult:
    """Compute a fit, which must succeed, and return its result."""
    result = compute_fit(task, "r")
    assert result.status == "ok", result.failure
    return result
