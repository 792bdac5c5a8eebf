"""Forecast the fits of a run and their time: `bench run --plan`."""

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
"""Seconds after which the timing of a fit is stopped, and after which no new fit is started."""


@dataclass(frozen=True)
class Forecast:
    """Forecast of a run for one model, or for all.

    Attributes:
        model: key with the options that differ from their defaults.
        n_cells: number of fits.
        n_cached: number of fits with a stored result.
        n_unknown: number of missing fits with unknown time.
        seconds: expected time of the missing fits with known time, in sequence, s.
        n_timed: number of missing fits whose time comes from a fit timed for the plan.
        is_lower_bound: True if a timing was stopped: the fits take longer than `seconds`.
        failure: reason why a timed fit gave no result; "" if it did.
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
    """Return a fit to time per data set of each model without stored fits.

    It is the missing fit with the fewest training rows. The first data sets of all models come
    before the second ones.
    """
    means = mean_seconds(output)
    untimed = [
        task for task in _missing(tasks, output, rerun) if task.presentation.model not in means
    ]
    of_places = grouped(
        untimed, lambda task: (task.presentation.model, task.presentation.dataset)
    ).values()
    smallest = [min(place, key=lambda task: len(task.split.train)) for place in of_places]
    of_models = grouped(smallest, lambda task: task.presentation.model).values()
    return [task for row in zip_longest(*of_models) for task in row if task is not None]


def _missing(tasks: Iterable[CellTask], output: Path, rerun: Rerun) -> list[CellTask]:
    statuses = stored_statuses(output)
    return [task for task in tasks if statuses.get(task.cell.key) not in REUSED_STATUSES[rerun]]


def time_fits(tasks: Sequence[CellTask], execution: Execution) -> list[CellResult]:
    """Run some fits for up to `LONGEST_S` and return their results; nothing is stored.

    The execution stops each fit after `LONGEST_FIT_S`.
    """
    end = time.monotonic() + LONGEST_S
    started = takewhile(lambda _: time.monotonic() < end, tasks)
    with closing(execution.results(started, "plan", Display())) as ended:
        return list(ended)


def _taken_s(timed: CellResult) -> float | None:
    """Return the seconds of a fit and its predictions; None: it failed."""
    if timed.cost is not None:
        return timed.cost.fit_s + timed.cost.predict_s
    return LONGEST_FIT_S if timed.cause == TIMED_OUT else None


def forecast(
    tasks: Iterable[CellTask], output: Path, *, rerun: Rerun, timed: Sequence[CellResult] = ()
) -> list[Forecast]:
    """Return the forecast of each model in the order of the tasks, then of "all".

    Nothing is computed or written; the results folder need not exist. Times are means of the
    model's stored fits. Without stored fits they are times of fits measured now, on the same or
    another data set.

    Raises:
        StiffBenchError: a data set cannot be loaded or split, or stored results cannot be read.
    """
    tasks, means = list(tasks), mean_seconds(output)
    missing = grouped(_missing(tasks, output, rerun), lambda task: task.presentation.model)
    forecasts = []
    for model, of_model in grouped(tasks, lambda task: task.presentation.model).items():
        to_compute = missing.get(model, [])
        of_fits = {
            fit.presentation.dataset: fit for fit in timed if fit.presentation.model == model
        }
        taken = {data: s for data, fit in of_fits.items() if (s := _taken_s(fit)) is not None}
        is_known, usual_s = model in means or bool(taken), 0.0
        if is_known:
            usual_s = means[model] if model in means else sum(taken.values()) / len(taken)
        forecasts.append(
            Forecast(
                model,
                n_cells=len(of_model),
                n_cached=len(of_model) - len(to_compute),
                n_unknown=0 if is_known else len(to_compute),
                seconds=sum(taken.get(task.presentation.dataset, usual_s) for task in to_compute),
                n_timed=len(to_compute) if taken else 0,
                is_lower_bound=any(fit.cause == TIMED_OUT for fit in of_fits.values()),
                failure=next((fit.why_none for d, fit in of_fits.items() if d not in taken), ""),
            )
        )
    total = Forecast(
        "all",
        n_cells=sum(model.n_cells for model in forecasts),
        n_cached=sum(model.n_cached for model in forecasts),
        n_unknown=sum(model.n_unknown for model in forecasts),
        seconds=sum(model.seconds for model in forecasts),
        n_timed=sum(model.n_timed for model in forecasts),
        is_lower_bound=any(model.is_lower_bound for model in forecasts),
    )
    return [*forecasts, total]


def forecast_table(forecasts: Sequence[Forecast], jobs: int) -> Table:
    """Return a table of the numbers of fits by model, and of all."""
    *models, _ = forecasts
    timed = [model.model for model in models if model.n_timed]
    stopped = [model.model for model in models if model.is_lower_bound]
    notes = ["time: h:min:s in sequence, from the mean of the model's stored fits"]
    if timed:
        notes.append(
            f"timed now, one fit on the smallest split, not stored: {first_few(timed)}; larger "
            "splits take longer"
        )
    if stopped:
        model_names = first_few(stopped)
        notes.append(f"more than: a fit was stopped after {LONGEST_FIT_S:g} s: {model_names}")
    notes += [
        f"{model.model}: the timed fit gave no result: {model.failure}"
        for model in models
        if model.failure
    ]
    return Table.of(
        "Fits to compute",
        [
            Column("model", "text", value=lambda row: row.model),
            Column("fits", value=lambda row: row.n_cells),
            Column("cached", value=lambda row: row.n_cached),
            Column("to compute", value=lambda row: row.n_cells - row.n_cached),
            Column("time", unit="s", format=_time_text, value=_time_left),
        ],
        forecasts,
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
    """Return a line: "40 fits, 10 cached, 30 to compute; about 0:02:30 with 2 jobs"."""
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
