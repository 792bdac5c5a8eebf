"""What a run would compute, and about how long that takes: `bench run --plan`.

Nothing is computed or written. Times are means of the stored fits of the same models.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.execution import COUNTING, Rerun
from stiff_bench.store.database import mean_seconds, stored_statuses
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import counted


@dataclass(frozen=True)
class ModelForecast:
    """The cells of one model.

    Attributes:
        model: key with the options that differ from their defaults.
        n_cells: in all.
        n_cached: whose results are there.
        seconds: expected time of the others, one after another, s; None: not known.
    """

    model: str
    n_cells: int
    n_cached: int
    seconds: float | None


@dataclass(frozen=True)
class Forecast:
    """What a run would compute.

    Attributes:
        parts: of each model, in the plan's order.
        jobs: how many cells are computed at once.
    """

    parts: tuple[ModelForecast, ...]
    jobs: int

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
        return sum(one.n_cells - one.n_cached for one in self.parts if one.seconds is None)

    @property
    def seconds(self) -> float:
        """Expected time of the run, s, without the cells of which it is not known."""
        return sum(part.seconds or 0.0 for part in self.parts) / self.jobs


def forecast(tasks: Iterable[CellTask], output: Path, *, jobs: int, rerun: Rerun) -> Forecast:
    """Return what a run would compute.

    Args:
        tasks: what is asked for.
        output: folder of the results; it need not be there.
        jobs: how many cells are computed at once.
        rerun: which of the stored cells are computed again.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided, or the stored results not read.
    """
    statuses = stored_statuses(output)
    cached = {key for key, status in statuses.items() if status in COUNTING[rerun]}
    n_cells: Counter[str] = Counter()
    n_cached: Counter[str] = Counter()
    for task in tasks:
        n_cells[task.shown.model] += 1
        n_cached[task.shown.model] += task.cell.key in cached
    means = mean_seconds(output)
    parts = []
    for name, n_all in n_cells.items():
        n_missing, mean = n_all - n_cached[name], means.get(name)
        seconds = n_missing * mean if mean is not None else None if n_missing else 0.0
        parts.append(ModelForecast(name, n_all, n_cached[name], seconds))
    return Forecast(tuple(parts), jobs)


def forecast_table(found: Forecast) -> Table:
    """Return the numbers of cells by model, and of all together."""
    known = None if found.n_unknown else found.seconds * found.jobs
    total = ("all", found.n_cells, found.n_cached, known)
    rows = [(part.model, part.n_cells, part.n_cached, part.seconds) for part in found.parts]
    return Table(
        title="Fits to compute",
        columns=[
            Column("model", "text"),
            *(Column(name) for name in ("fits", "cached", "to compute")),
            Column("time", unit="s", format=lambda time: _clock(time.value)),
        ],
        rows=[
            [*(name, n, cached, n - cached), Quantity(status="unknown") if s is None else s]
            for name, n, cached, s in [*rows, total]
        ],
        notes=("time: h:min:s in sequence, from the mean of the model's stored fits",),
        about={"jobs": found.jobs},
    )


def forecast_line(found: Forecast) -> str:
    """Return e.g. "40 fits, 10 cached, 30 to compute; about 0:02:30 with 2 jobs"."""
    n_missing = found.n_cells - found.n_cached
    cells = f"{counted(found.n_cells, 'fit')}, {found.n_cached} cached, {n_missing} to compute"
    time = f"about {_clock(found.seconds)} with {counted(found.jobs, 'job')}"
    if not found.n_unknown:
        return f"{cells}; {time}"
    unknown = f"{counted(found.n_unknown, 'fit')} of models without a stored fit"
    return f"{cells}; {f'{time}, and' if found.seconds else 'time unknown:'} {unknown}"


def _clock(seconds: float | None) -> str:
    return "unknown" if seconds is None else str(timedelta(seconds=round(seconds)))
