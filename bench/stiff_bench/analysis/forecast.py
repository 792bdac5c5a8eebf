"""What a run would compute, and about how long that takes: `bench run --plan`."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import timedelta
from itertools import takewhile, zip_longest
from pathlib import Path

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.cell import REUSED_STATUSES, Execution, Rerun
from stiff_bench.run.isolate import TIMED_OUT
from stiff_bench.run.progress import Display
from stiff_bench.store.database import mean_seconds, stored_statuses
from stiff_bench.store.names import grouped
from stiff_bench.tables.table import Column, Quantity, Table
from stiff_bench.tables.units import counted, first_few
from stiff_protocols.contract.record import CellResult

LONGEST_FIT_S, LONGEST_S = 10.0, 30.0
"""Seconds after which the timing of one fit is stopped, and after which no other is started."""


@dataclass(frozen=True)
class Forecast:
    """What a run would compute of one model, or of all.

    Attributes:
        model: key with the options that differ from their defaults.
        n_cells: in all.
        n_cached: whose results are there.
        n_unknown: how many of the others take a time that is not known.
        seconds: expected time of the others whose time is known, one after another, s.
        n_timed: how many of the others have the time of a fit that was timed for the plan.
        is_lower_bound: a timing was stopped, so that they take longer than `seconds`.
        failure: why a fit that was timed gave no result; "" where it did.
    """

    model: str
    n_cells: int
    n_cached: int
    n_unknown: int
    seconds: float
    n_timed: int = 0
    is_lower_bound: bool = False
    failure: str = ""


def untimed_fits(tasks: Iterable[CellTask], output: Path, *, rerun: Rerun) -> list[CellTask]:
    """Return a fit to time for each model and data set whose model has no stored fit.

    It is the missing one that learns from the fewest rows. Each model comes once before any comes
    with its second data set.
    """
    means = mean_seconds(output)
    untimed = [task for task in _missing(tasks, output, rerun) if task.shown.model not in means]
    of_places = grouped(untimed, lambda task: (task.shown.model, task.shown.dataset)).values()
    smallest = [min(place, key=lambda task: len(task.split.train)) for place in of_places]
    of_models = grouped(smallest, lambda task: task.shown.model).values()
    return [task for row in zip_longest(*of_models) for task in row if task is not None]


def _missing(tasks: Iterable[CellTask], output: Path, rerun: Rerun) -> list[CellTask]:
    statuses = stored_statuses(output)
    return [task for task in tasks if statuses.get(task.cell.key) not in REUSED_STATUSES[rerun]]


def time_fits(tasks: Sequence[CellTask], execution: Execution) -> list[CellResult]:
    """Return what became of some fits, of as many as `LONGEST_S` allow; nothing is stored.

    The execution stops each after `LONGEST_FIT_S`.
    """
    end = time.monotonic() + LONGEST_S
    started = takewhile(lambda _: time.monotonic() < end, tasks)
    with closing(execution.results(started, "plan", Display())) as ended:
        return list(ended)


def _taken_s(timed: CellResult) -> float | None:
    """Return how long a fit and its predictions took, until it was stopped; None: it failed."""
    if timed.cost is not None:
        return timed.cost.fit_s + timed.cost.predict_s
    return LONGEST_FIT_S if timed.cause == TIMED_OUT else None


def forecast(
    tasks: Iterable[CellTask], output: Path, *, rerun: Rerun, timed: Sequence[CellResult] = ()
) -> list[Forecast]:
    """Return what a run would compute of each model, in the order of the tasks, and "all" last.

    Nothing is computed or written; the folder of the results need not be there. Times are means of
    the stored fits of the same models, else times of fits measured now on the same data set, or on
    another one.

    Raises:
        StiffBenchError: a data set cannot be loaded or divided, or the stored results not read.
    """
    tasks, means = list(tasks), mean_seconds(output)
    missing = grouped(_missing(tasks, output, rerun), lambda task: task.shown.model)
    found = []
    for model, of_model in grouped(tasks, lambda task: task.shown.model).items():
        to_compute = missing.get(model, [])
        of_fits = {one.shown.dataset: one for one in timed if one.shown.model == model}
        taken = {data: s for data, one in of_fits.items() if (s := _taken_s(one)) is not None}
        is_known, usual_s = model in means or bool(taken), 0.0
        if is_known:
            usual_s = means[model] if model in means else sum(taken.values()) / len(taken)
        found.append(
            Forecast(
                model,
                n_cells=len(of_model),
                n_cached=len(of_model) - len(to_compute),
                n_unknown=0 if is_known else len(to_compute),
                seconds=sum(taken.get(task.shown.dataset, usual_s) for task in to_compute),
                n_timed=len(to_compute) if taken else 0,
                is_lower_bound=any(one.cause == TIMED_OUT for one in of_fits.values()),
                failure=next((one.why_none for d, one in of_fits.items() if d not in taken), ""),
            )
        )
    total = Forecast(
        "all",
        n_cells=sum(model.n_cells for model in found),
        n_cached=sum(model.n_cached for model in found),
        n_unknown=sum(model.n_unknown for model in found),
        seconds=sum(model.seconds for model in found),
        n_timed=sum(model.n_timed for model in found),
        is_lower_bound=any(model.is_lower_bound for model in found),
    )
    return [*found, total]


def forecast_table(found: Sequence[Forecast], jobs: int) -> Table:
    """Return the numbers of cells by model, and of all together."""
    *models, _ = found
    timed = [model.model for model in models if model.n_timed]
    stopped = [model.model for model in models if model.is_lower_bound]
    notes = ["time: h:min:s in sequence, from the mean of the model's stored fits"]
    if timed:
        notes.append(
            f"timed now, one fit on the smallest split, not stored: {first_few(timed)}; larger "
            "splits take longer"
        )
    if stopped:
        which = first_few(stopped)
        notes.append(f"more than: a fit was stopped after {LONGEST_FIT_S:g} s: {which}")
    notes += [
        f"{model.model}: the timed fit gave no result: {model.failure}"
        for model in models
        if model.failure
    ]
    return Table.of(
        "Fits to compute",
        [
            Column("model", "text", value=lambda one: one.model),
            Column("fits", value=lambda one: one.n_cells),
            Column("cached", value=lambda one: one.n_cached),
            Column("to compute", value=lambda one: one.n_cells - one.n_cached),
            Column("time", unit="s", format=_time_text, value=_time_left),
        ],
        found,
        notes,
        about={"jobs": jobs},
    )


def _time_left(model: Forecast) -> Quantity:
    if model.n_unknown:
        return Quantity(status="unknown")
    return Quantity(model.seconds, status="more than" * model.is_lower_bound)


def _time_text(duration: Quantity) -> str:
    return f"{duration.status} {_clock(duration.value or 0.0)}".strip()


def forecast_line(total: Forecast, jobs: int) -> str:
    """Return e.g. "40 fits, 10 cached, 30 to compute; about 0:02:30 with 2 jobs"."""
    n_missing = total.n_cells - total.n_cached
    cells = f"{counted(total.n_cells, 'fit')}, {total.n_cached} cached, {n_missing} to compute"
    about = "more than" if total.is_lower_bound else "about"
    duration = f"{about} {_clock(total.seconds / jobs)} with {counted(jobs, 'job')}"
    if not total.n_unknown:
        return f"{cells}; {duration}"
    unknown = f"{counted(total.n_unknown, 'fit')} of models without a stored fit"
    return f"{cells}; {f'{duration}, and' if total.seconds else 'time unknown:'} {unknown}"


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
