"""How cells are computed: side by side or not, within which limits, and which again."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from stiff_bench.cell_process import Limits
from stiff_bench.config import RunPlan
from stiff_bench.executor import Executor, InProcess, LocalProcesses
from stiff_bench.registry import OURS, Registry
from stiff_protocols.errors import ConfigError

Rerun = Literal["missing", "failed", "all"]
COUNTING: Mapping[Rerun, Set[str]] = {
    "missing": {"ok", "failed"},
    "failed": {"ok"},
    "all": frozenset(),
}
"""Statuses of the stored results that stand; what was skipped is always looked at again."""


@dataclass(frozen=True)
class Execution:
    """How the cells of a run are computed.

    Attributes:
        executor: what computes them.
        rerun: which cells are computed though their results are there.
        facts: what a manifest says of it.
    """

    executor: Executor
    rerun: Rerun = "missing"
    facts: Mapping[str, str] = field(default_factory=dict)


IN_THIS_PROCESS = Execution(InProcess())
"""One cell after another, none isolated."""


def chosen_execution(
    plan: RunPlan,
    registry: Registry,
    *,
    jobs: int,
    isolate: bool | None,
    limits: Limits,
    dask: str,
    rerun: Rerun,
) -> Execution:
    """Return how a plan is executed.

    Cells are isolated where several run at once, where a limit is to hold, and where a stranger's
    model takes part.

    Raises:
        ConfigError: two options contradict each other, or there is no such cluster.
    """
    reasons = {
        f"--jobs {jobs}": jobs > 1,
        f"--dask {dask}": bool(dask),
        "--timeout": limits.timeout_s is not None,
        "--memory": limits.memory_bytes is not None,
    }
    needed = [reason for reason, holds in reasons.items() if holds]
    if isolate is False and needed:
        raise ConfigError(f"--no-isolate: {needed[0]} needs a process for every cell")
    if dask and jobs > 1:
        raise ConfigError(f"--jobs {jobs}: the cluster of --dask says how many run at once")
    strange = any(registry.origins.get(one.info.key, OURS) != OURS for one in plan.models)
    isolated = bool(needed) or (strange if isolate is None else isolate)
    executor: Executor = LocalProcesses(jobs, limits) if isolated else InProcess()
    if dask:
        executor = _on_cluster(dask, limits, plan.output)
    return Execution(
        executor=executor,
        rerun=rerun,
        facts={
            "jobs": str(jobs),
            "isolated": str(isolated).lower(),
            "threads": str(limits.threads),
            "dask": dask,
        },
    )


def _on_cluster(words: str, limits: Limits, output: Path) -> Executor:
    if find_spec("distributed") is None:
        raise ConfigError(f"--dask {words}: needs Dask: pip install 'stiffbench[cluster]'")
    from stiff_bench.dask_executor import DaskExecutor

    return DaskExecutor(words, limits, output)
