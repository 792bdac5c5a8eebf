"""What a run would compute, and about how long that takes: `bench run --plan`.

Nothing is computed or written. Times are means of the stored fits of the same models.
"""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from datetime import timedelta
from pathlib import Path

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.execution import COUNTING, Rerun
from stiff_bench.store.database import mean_seconds, stored_statuses
from stiff_bench.tables.render import TextTable, csv_cells, render_texts
from stiff_bench.tables.units import counted


@dataclass(frozen=True)
class ModelForecast:
    """The cells of one model.

    Attributes:
        model: key with the options that differ from their defaults.
        n_cells: in all.
        n_cached: whose results are there.
        cell_s: mean time of a stored fit and its predictions, s; None: none is stored.
    """

    model: str
    n_cells: int
    n_cached: int
    cell_s: float | None

    @property
    def n_missing(self) -> int:
        """How many would be computed."""
        return self.n_cells - self.n_cached

    @property
    def seconds(self) -> float | None:
        """Expected time of the missing cells, one after another, s; None: not known."""
        if not self.n_missing:
            return 0.0
        return None if self.cell_s is None else self.n_missing * self.cell_s


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
        return sum(part.n_missing for part in self.parts if part.seconds is None)

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
    parts = (ModelForecast(name, n, n_cached[name], means.get(name)) for name, n in n_cells.items())
    return Forecast(tuple(parts), jobs)


def render_forecast(found: Forecast, fmt: str, command: str) -> str:
    """Return a forecast as "github", "latex" or "html"; as "csv" or "json" with all its parts."""
    if fmt == "json":
        sums = {"cells": found.n_cells, "cached": found.n_cached, "unknown": found.n_unknown}
        content = {"command": command, **sums, "seconds": found.seconds, **asdict(found)}
        return json.dumps(content, indent=2)
    if fmt == "csv":
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(item.name for item in fields(ModelForecast))
        writer.writerows(csv_cells(asdict(part).values()) for part in found.parts)
        return out.getvalue().rstrip("\n")
    return render_texts([_table(found)], fmt, command)


def _table(found: Forecast) -> TextTable:
    """Return the numbers of cells by model."""
    known = None if found.n_unknown else found.seconds * found.jobs
    total = ("all", found.n_cells, found.n_cached, known)
    rows = [(part.model, part.n_cells, part.n_cached, part.seconds) for part in found.parts]
    return TextTable(
        title="What the run would compute",
        header=("model", "cells", "cached", "to compute", "time"),
        rows=[
            [name, str(n), str(cached), str(n - cached), _clock(seconds)]
            for name, n, cached, seconds in [*rows, total]
        ],
        notes=(
            "times in h:min:s, one cell after another, are means of the model's stored fits; a "
            "pre-training that the cache held is not in them",
        ),
    )


def forecast_line(found: Forecast) -> str:
    """Return e.g. "40 cells, 10 cached, 30 to compute; about 0:02:30 with 2 jobs"."""
    n_missing = found.n_cells - found.n_cached
    cells = f"{counted(found.n_cells, 'cell')}, {found.n_cached} cached, {n_missing} to compute"
    time = f"about {_clock(found.seconds)} with {counted(found.jobs, 'job')}"
    if not found.n_unknown:
        return f"{cells}; {time}"
    unknown = f"{counted(found.n_unknown, 'cell')} of models without a stored fit"
    return f"{cells}; " + (
        f"{time}, and {unknown}" if found.seconds else f"time unknown: {unknown}"
    )


def _clock(seconds: float | None) -> str:
    return "unknown" if seconds is None else str(timedelta(seconds=round(seconds)))
