"""How cells are computed: side by side or not, within which limits, and which again."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping, Set
from dataclasses import dataclass, field
from typing import Literal, Protocol

from stiff_bench.plan.cells import CellTask
from stiff_bench.plan.registry import OURS, Registry
from stiff_bench.plan.request import RunPlan
from stiff_bench.run.cell import compute_cell
from stiff_bench.run.cell_process import Limits
from stiff_bench.run.isolate import LocalProcesses
from stiff_bench.run.progress import Display
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.extras import require
from stiff_protocols.contract.record import CellResult

Rerun = Literal["missing", "failed", "all"]
COUNTING: Mapping[Rerun, Set[str]] = {
    "missing": {"ok", "failed"},
    "failed": {"ok"},
    "all": frozenset(),
}
"""Statuses of the stored results that stand; what was skipped is always looked at again."""


class Executor(Protocol):
    """Computes cells."""

    at_once: int
    """How many cells are computed side by side, as far as that is known."""

    machines: Mapping[str, Mapping[str, str]]
    """Environments of other machines that took part, by their addresses."""

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends, in any order.

        A task is taken from `tasks` when its turn comes. Closing the generator ends what runs.
        """


class InProcess:
    """Computes one cell after another in this process."""

    at_once = 1
    machines: Mapping[str, Mapping[str, str]] = {}

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield every cell's result, in order."""
        for task in tasks:
            display.start(task)
            yield compute_cell(task, run_id)


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
    threads: int,
    jobs: int | None = None,
    isolate: bool | None = None,
    timeout: float | None = None,
    memory: int | None = None,
    dask: str = "",
    rerun: Rerun = "missing",
) -> Execution:
    """Return how a plan is executed, from the options of the command line.

    Cells are isolated where several run at once, where a limit is to hold, and where a stranger's
    model takes part.

    Raises:
        ConfigError: two options contradict each other, or there is no such cluster.
    """
    jobs = jobs or 1
    reasons = {
        f"--jobs {jobs}": jobs > 1,
        f"--dask {dask}": bool(dask),
        "--timeout": timeout is not None,
        "--memory": memory is not None,
    }
    needed = [reason for reason, holds in reasons.items() if holds]
    if isolate is False and needed:
        raise ConfigError(f"--no-isolate: {needed[0]} needs a process for each fit")
    if dask and jobs > 1:
        raise ConfigError(f"--jobs {jobs}: the cluster of --dask says how many run at once")
    keys = {one.info.key for one in plan.models}
    strangers = {key for key in keys if registry.origins.get(key, OURS) != OURS}
    isolated = bool(needed) or (bool(strangers) if isolate is None else isolate)
    limits = Limits(threads, timeout, memory)
    executor: Executor = LocalProcesses(jobs, limits, strangers) if isolated else InProcess()
    if dask:
        require(f"--dask {dask}", "distributed")
        from stiff_bench.run.dask_cluster import DaskCluster

        executor = DaskCluster(dask, limits, plan.output)
    facts = {"jobs": jobs, "isolated": str(isolated).lower(), "threads": threads, "dask": dask}
    return Execution(executor, rerun, {name: str(fact) for name, fact in facts.items()})
