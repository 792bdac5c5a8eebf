"""Requests of `bench run` without a command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from stiff_bench.plan.cells import CellTask, RunPlan, plan_run
from stiff_bench.plan.registry import Registry, build_registry
from stiff_bench.run.cell import compute_cell
from stiff_protocols.contract.record import CellResult


def planned(registry: Registry | None = None, **changes: Any) -> RunPlan:
    """Return the checked plan of `bench run --model vjm` with these changes."""
    words: dict[str, Any] = {"models": ("vjm",), "datasets": ("kr10-twin",)}
    words |= {"protocols": ("holdout",), "metrics": ("mae",), "device": "cpu"}
    words |= {"output": Path("unused"), "command": "bench run"} | changes
    return plan_run(registry or build_registry(), **words)


def with_model(task: CellTask, cls: type, **params: Any) -> CellTask:
    """Return the same cell with another model class."""
    return replace(task, model=replace(task.model, cls=cls, params=params, context={}))


def computed(task: CellTask) -> CellResult:
    """Compute a cell, which must succeed, and return its result."""
    result = compute_cell(task, "r")
    assert result.status == "ok", result.failure
    return result
