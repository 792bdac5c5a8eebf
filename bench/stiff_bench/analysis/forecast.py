"""What a run would compute, and about how long that takes: `bench run --plan`."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import timedelta
from itertools import takewhile, zip_longest
from pathlib import Path

from stiff_bench.plan.cells import CellTask
from stiff_bench.run.cell import COUNTING, Execution, Rerun
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
    statuses, means = stored_statuses(output), mean_seconds(output)
    smallest: dict[tuple[str, str], CellTask] = {}
    for task in tasks:
        place = task.shown.model, task.shown.dataset
        is_cached = statuses.get(task.cell.key) in COUNTING[rerun]
        if is_cached or task.shown.model in means:
            continue
        if place not in smallest or len(task.split.train) < len(smallest[place].split.train):
            smallest[place] = task
    of_models = grouped(smallest.values(), lambda task: task.shown.model).values()
    return [task for row in zip_longest(*of_models) for task in row if task is not None]


def time_fits(tasks: Sequence[CellTask], execution: Execution) -> list[CellResult]:
    """Return what became of some fits, of as many as `LONGEST_S` allow; nothing is stored.

    Args:
        tasks: to be timed.
        execution: stops each after `LONGEST_FIT_S`.
    """
    end = time.monotonic() + LONGEST_S

    def started() -> Iterator[CellTask]:
        yield from takewhile(lambda _: time.monotonic() < end, tasks)

    with closing(execution.results(started(), "plan", Display())) as ended:
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
    statuses, means = stored_statuses(output), mean_seconds(output)
    cached = {key for key, status in statuses.items() if status in COUNTING[rerun]}
    is_cached: dict[str, dict[str, list[bool]]] = {}
    for task in tasks:
        of_model = is_cached.setdefault(task.shown.model, {})
        of_model.setdefault(task.shown.dataset, []).append(task.cell.key in cached)
    forecasts = [
        _of_model(
            model,
            of_datasets,
            means.get(model),
            [result for result in timed if result.shown.model == model],
        )
        for model, of_datasets in is_cached.items()
    ]
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


def _of_model(
    model: str,
    of_datasets: Mapping[str, Sequence[bool]],
    mean_s: float | None,
    timed: Sequence[CellResult],
) -> Forecast:
    """Return what is missing of one model on each data set, and how long that takes."""
    n_missing = {dataset: list(cached).count(False) for dataset, cached in of_datasets.items()}
    n_cells, total = sum(map(len, of_datasets.values())), sum(n_missing.values())
    counts = model, n_cells, n_cells - total
    if mean_s is not None:
        return Forecast(*counts, 0, total * mean_s)
    taken = {one.shown.dataset: s for one in timed if (s := _taken_s(one)) is not None}
    failure = next((one.why_none for one in timed if one.shown.dataset not in taken), "")
    if not taken:
        return Forecast(*counts, total, 0.0, failure=failure)
    usual_s = sum(taken.values()) / len(taken)
    seconds = sum(n * taken.get(dataset, usual_s) for dataset, n in n_missing.items())
    was_stopped = any(one.cause == TIMED_OUT for one in timed)
    return Forecast(*counts, 0, seconds, total, was_stopped, failure)


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
