"""How cells are computed, and which are computed again."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping, Set
from dataclasses import dataclass, field
from typing import Literal

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.cell import compute_cell
from stiff_bench.run.progress import Display
from stiff_protocols.contract.record import CellResult

Rerun = Literal["missing", "failed", "all"]
COUNTING: Mapping[Rerun, Set[str]] = {
    "missing": {"ok", "failed"},
    "failed": {"ok"},
    "all": frozenset(),
}
"""Statuses of the stored results that stand; what was skipped is always looked at again."""


@dataclass(eq=False, kw_only=True)
class Execution:
    """How the cells of a run are computed: here, one after another, unless a subclass does more.

    Attributes:
        rerun: which cells are computed though their results are there.
        facts: what a manifest says of it.
        at_once: how many cells are computed side by side, as far as that is known.
        machines: environments of other machines that took part, by their addresses.
    """

    rerun: Rerun = "missing"
    facts: Mapping[str, str] = field(default_factory=dict)
    at_once: int = 1
    machines: dict[str, Mapping[str, str]] = field(default_factory=dict)

    def results(
        self, tasks: Iterable[CellTask], run_id: str, display: Display
    ) -> Generator[CellResult, None, None]:
        """Yield the result of every cell as it ends, in any order.

        A task is taken from `tasks` when its turn comes. Closing the generator ends what runs.

        Raises:
            ConfigError: there is no cluster of this address, or it has gone.
        """
        for task in tasks:
            display.start(task)
            yield compute_cell(task, run_id)
