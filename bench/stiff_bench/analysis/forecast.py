"""What a run would compute, and about how long that takes: `bench run --plan`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.execution import COUNTING, Rerun
from stiff_bench.store.database import mean_seconds, stored_statuses
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import counted


@dataclass(frozen=True)
class Forecast:
    """What a run would compute of one model, or of all.

    Attributes:
        model: key with the options that differ from their defaults.
        n_cells: in all.
        n_cached: whose results are there.
        n_unknown: how many of the others take a time that nobody knows.
        seconds: expected time of the others whose time is known, one after another, s.
    """

    model: str
    n_cells: int
    n_cached: int
    n_unknown: int
    seconds: float


def forecast(tasks: Iterable[CellTask], output: Path, *, rerun: Rerun) -> list[Forecast]:
    """Return what a run would compute of each model, in the order of the tasks, and "all" last.

    Nothing is computed or written; the folder of the results need not be there. Times are means of
    the stored fits of the same models.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided, or the stored results not read.
    """
    statuses, means = stored_statuses(output), mean_seconds(output)
    cached = {key for key, status in statuses.items() if status in COUNTING[rerun]}
    is_cached: dict[str, list[bool]] = {}
    for task in tasks:
        is_cached.setdefault(task.shown.model, []).append(task.cell.key in cached)
    found = []
    for name, of_model in is_cached.items():
        n_missing = of_model.count(False)
        n_unknown = 0 if name in means else n_missing
        seconds = n_missing * means.get(name, 0.0)
        found.append(Forecast(name, len(of_model), sum(of_model), n_unknown, seconds))
    totals = (
        sum(getattr(one, number) for one in found)
        for number in ("n_cells", "n_cached", "n_unknown", "seconds")
    )
    return [*found, Forecast("all", *totals)]


def forecast_table(found: Sequence[Forecast], jobs: int) -> Table:
    """Return the numbers of cells by model, and of all together."""
    return Table(
        title="Fits to compute",
        columns=[
            Column("model", "text"),
            *(Column(name) for name in ("fits", "cached", "to compute")),
            Column("time", unit="s", format=lambda time: _clock(time.value or 0.0)),
        ],
        rows=[
            [
                *(one.model, one.n_cells, one.n_cached, one.n_cells - one.n_cached),
                Quantity(status="unknown") if one.n_unknown else one.seconds,
            ]
            for one in found
        ],
        notes=("time: h:min:s in sequence, from the mean of the model's stored fits",),
        about={"jobs": jobs},
    )


def forecast_line(total: Forecast, jobs: int) -> str:
    """Return e.g. "40 fits, 10 cached, 30 to compute; about 0:02:30 with 2 jobs"."""
    n_missing = total.n_cells - total.n_cached
    cells = f"{counted(total.n_cells, 'fit')}, {total.n_cached} cached, {n_missing} to compute"
    time = f"about {_clock(total.seconds / jobs)} with {counted(jobs, 'job')}"
    if not total.n_unknown:
        return f"{cells}; {time}"
    unknown = f"{counted(total.n_unknown, 'fit')} of models without a stored fit"
    return f"{cells}; {f'{time}, and' if total.seconds else 'time unknown:'} {unknown}"


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
