"""Count the missing fits of a run, with the time that stored fits took: `bench run --plan`."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import timedelta
from pathlib import Path

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.cell import REUSED_STATUSES, Rerun
from stiff_bench.store.database import mean_seconds, stored_statuses
from stiff_bench.store.names import grouped
from stiff_bench.tables.table import Column, Entry, Quantity, Table
from stiff_bench.tables.units import counted


def forecast(
    tasks: Iterable[CellTask], output: Path, *, rerun: Rerun, jobs: int
) -> tuple[Table, str]:
    """Return a table with the numbers of fits by model and of all, and a line on all.

    Nothing is computed or written; the results folder need not exist. Times are means of the
    model's stored fits.

    Raises:
        StiffBenchError: a data set cannot be loaded or split, or stored results cannot be read.
    """
    statuses, means = stored_statuses(output), mean_seconds(output)
    rows: list[list[Entry]] = []
    n_all = n_missing = n_unknown = 0
    seconds = 0.0
    for model, of_model in grouped(tasks, lambda task: task.presentation.model).items():
        missing = sum(
            statuses.get(task.cell.key) not in REUSED_STATUSES[rerun] for task in of_model
        )
        known_s = missing * means.get(model, 0.0)
        is_known = model in means or not missing
        rows.append(_row(model, len(of_model), missing, known_s if is_known else None))
        n_all, n_missing, seconds = n_all + len(of_model), n_missing + missing, seconds + known_s
        n_unknown += 0 if is_known else missing
    rows.append(_row("all", n_all, n_missing, None if n_unknown else seconds))
    columns = [
        Column("model", "text"),
        *(Column(name) for name in ("fits", "cached", "to compute")),
        Column("time", unit="s", format=lambda time: _clock(time.value or 0.0)),
    ]
    notes = ["time: h:min:s in sequence, from the mean of the model's stored fits"]
    about = f"about {_clock(seconds / jobs)} with {counted(jobs, 'job')}"
    if n_unknown:
        about = f"time unknown: {counted(n_unknown, 'fit')} of models without a stored fit"
    counts = f"{counted(n_all, 'fit')}, {n_all - n_missing} cached, {n_missing} to compute"
    table = Table("Fits to compute", columns, rows, notes, about={"jobs": jobs})
    return table, f"{counts}; {about}"


def _row(model: str, n_fits: int, n_missing: int, seconds: float | None) -> list[Entry]:
    time = Quantity(status="unknown") if seconds is None else Quantity(seconds)
    return [model, n_fits, n_fits - n_missing, n_missing, time]


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
