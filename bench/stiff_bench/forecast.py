"""What a run would compute, how long that would take and in how much memory: `bench run --plan`.

Nothing is computed or written. Cells are counted one by one as they would come, so that any number
of them takes no memory; times are those of stored cells of the same models.
"""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from stiff_bench.costs import MOST_SINGLE_PREDICTIONS, SECONDS
from stiff_bench.execution import COUNTING, Execution, Rerun
from stiff_bench.memory import peak_memory_bytes
from stiff_bench.store import Report, stored_keys, stored_results
from stiff_bench.tasks import CellTask
from stiff_protocols.cost import Cost
from stiff_protocols.errors import StoreError
from stiff_protocols.record import CellResult

OVERHEAD_S = 0.02
"""What a cell takes beside its fit and its predictions; tests/perf/perf_engine.py measures it."""
CELLS_OF_PAIR, NEWEST_CELLS = 5, 1000
"""How many stored cells are asked for their costs: of a model on a data set, and of all."""


@dataclass(frozen=True)
class Part:
    """The cells of one model on one data set under one protocol.

    Attributes:
        model, dataset, protocol: keys with the options that differ from their defaults.
        n_cells: in all.
        n_cached: whose results are there.
        cell_s: expected time of one of them, s; None: not known.
    """

    model: str
    dataset: str
    protocol: str
    n_cells: int
    n_cached: int
    cell_s: float | None

    @property
    def n_missing(self) -> int:
        """How many would be computed."""
        return self.n_cells - self.n_cached


@dataclass(frozen=True)
class Forecast:
    """What a run would compute.

    Attributes:
        parts: in the plan's order.
        jobs: how many cells are computed at once.
        memory_bytes: expected peak of a process that computes a cell; None: not known.
    """

    parts: tuple[Part, ...]
    jobs: int
    memory_bytes: int | None

    @property
    def n_cells(self) -> int:
        """How many cells there are."""
        return sum(part.n_cells for part in self.parts)

    @property
    def n_cached(self) -> int:
        """How many results are there."""
        return sum(part.n_cached for part in self.parts)

    @property
    def n_unknown(self) -> int:
        """How many cells would be computed of which nobody knows how long they take."""
        return sum(part.n_missing for part in self.parts if part.cell_s is None)

    @property
    def seconds(self) -> float:
        """Expected time of the run, s, without the cells of which it is not known."""
        return computing_s(self.parts) / self.jobs


def computing_s(parts: Iterable[Part]) -> float:
    """Return the expected time of all missing cells one after another, s, as far as it is known."""
    return sum(part.n_missing * part.cell_s for part in parts if part.cell_s is not None)


def forecast(
    tasks: Iterable[CellTask],
    output: Path,
    execution: Execution,
    report: Report,
    prior: Callable[[str], float | None] = lambda model: None,
) -> Forecast:
    """Return what a run would compute.

    Args:
        tasks: what is asked for.
        output: folder of the results; it need not be there.
        execution: how.
        report: is told of damaged packs, whose cells would be computed again. A damaged file of
            one cell is found by the run alone.
        prior: a model's name -> time of a cell, s, where no stored cell tells; None: not known.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided.
    """
    stored = stored_keys(output, report)
    cached = _cached(output, stored, execution.rerun)
    counts: dict[tuple[str, str, str], list[int]] = defaultdict(lambda: [0, 0])
    of_pair: dict[tuple[str, str], list[str]] = defaultdict(list)
    for task in tasks:
        shown, key = task.shown, task.cell.key
        count = counts[shown.model, shown.dataset, shown.protocol]
        count[0] += 1
        count[1] += key in cached
        if stored.get(key) and len(of_pair[shown.model, shown.dataset]) < CELLS_OF_PAIR:
            of_pair[shown.model, shown.dataset].append(key)
    newest = islice((key for key, ok in stored.items() if ok), NEWEST_CELLS)
    some = {*newest, *(key for keys in of_pair.values() for key in keys)}
    expected, memory = _expected(stored_results(output, some, _ignore), counts, prior)
    return Forecast(
        parts=tuple(
            Part(*names, n_cells, n_cached, expected(*names[:2]))
            for names, (n_cells, n_cached) in counts.items()
        ),
        jobs=execution.executor.at_once,
        memory_bytes=memory,
    )


def _cached(output: Path, stored: Mapping[str, bool], rerun: Rerun) -> Set[str]:
    """Return the keys of the stored cells that are not computed again."""
    counting = COUNTING[rerun]
    done = {key for key, ok in stored.items() if ok and "ok" in counting}
    if not counting - {"ok"}:
        return done
    others = stored_results(output, stored.keys() - done, _ignore)
    return done | {one.cell.key for one in others if one.status in counting}


def _ignore(_: StoreError) -> None:
    """Say nothing of a damaged file: there are others to learn from."""


def _expected(
    results: Iterable[CellResult],
    names: Iterable[tuple[str, str, str]],
    prior: Callable[[str], float | None],
) -> tuple[Callable[[str, str], float | None], int | None]:
    """Return what a model's cell takes on a data set, and the memory of the largest one.

    Args:
        results: stored ones.
        names: model, data set and protocol of the plan's parts.
        prior: for a model of which none is stored.
    """
    models = {model for model, _, _ in names}
    of_pair: dict[tuple[str, str], list[float]] = defaultdict(list)
    of_model: dict[str, list[float]] = defaultdict(list)
    rises = []
    for result in results:
        if result.cost is not None and result.shown.model in models:
            seconds = _cell_seconds(result.cost, n_fits=2 if result.calibration_samples else 1)
            of_pair[result.shown.model, result.shown.dataset].append(seconds)
            of_model[result.shown.model].append(seconds)
            rises += [] if result.cost.memory_bytes is None else [result.cost.memory_bytes]

    def of_cell(model: str, dataset: str) -> float | None:
        known = of_pair.get((model, dataset)) or of_model.get(model)
        return statistics.median(known) if known else prior(model)

    return of_cell, peak_memory_bytes() + max(rises) if rises else None


def _cell_seconds(cost: Cost, n_fits: int) -> float:
    """Return about how long a stored cell took, with a second fit for its intervals and all."""
    fits = n_fits * (cost.fit_s + cost.predict_s)
    measuring = cost.latency_s + min(MOST_SINGLE_PREDICTIONS * cost.latency_s, SECONDS)
    return fits + measuring + OVERHEAD_S
