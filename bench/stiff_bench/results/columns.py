"""Columns about models, and their tables.

A column has a heading, a unit, a format and the value of a row. Rows are those of
`leaderboard.model_frame` and of the functions below. To add a column, add it here and to the list
of its table; docs/definitions.md explains columns and marks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, fields, replace
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.results.fit_values import metric_values
from stiff_bench.results.leaderboard import control_frame, with_verdict_counts
from stiff_bench.results.notes import SELECTION_MARK, mark_of
from stiff_bench.results.scored_task import NOISE_FLOOR, ScoredTask
from stiff_bench.results.scores import Scores
from stiff_bench.store.names import TaskName
from stiff_bench.tables.table import BEST_MARK, WRITTEN, Column, Entry, Name, Quantity, Table
from stiff_bench.tables.table import text_columns as texts
from stiff_bench.tables.units import PRINTED, counted, duration, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.record import CellResult, Cost
from stiff_protocols.contract.types import AXES, BOUND_NAMES
from stiff_protocols.scoring.metrics import METRICS, WHOLE_VECTOR, Metric
from stiff_protocols.scoring.over_robots import MARGIN
from stiff_protocols.scoring.paired import LEVEL

if TYPE_CHECKING:
    from pandas import DataFrame

Row = Mapping[Any, Any]
Value = Callable[[Any], Entry]
DECIMALS = {"mm": 4, "%": 1, "": 3, "ms": 3, "MiB": 1, "1/s": 0}
"""Decimals by unit; mm as in the source paper's Table 10."""
SCREEN_FORMAT = ".3f"
"""Format of errors in mm on a terminal: 0.001 mm is below the noise of every instrument."""
RATIO_FORMAT = ".2f"
INTERVAL = f"{percent(1.0 - LEVEL)} interval"
EQUAL_TEXT = percent(math.exp(MARGIN) - 1.0)
VERDICT_TEXTS = {"a": "better", "b": "worse", "equivalent": "same", "open": "open", None: ""}
BEST, LIKE_BEST = "*", "≈"


def number_format(metric: Metric) -> str:
    """Return the format of a metric's values in printed units."""
    return f".{DECIMALS[PRINTED[metric.unit][0]]}f"


def signed_percent(change: Quantity) -> str:
    """Return a change in % with its sign and unit."""
    return f"{change.value:+.0f} %".replace("-", "\u2212")


def number(row: Row, key: Any, factor: float = 1.0) -> float | None:
    """Return a number of a row; None if it is missing."""
    value = row.get(key)
    return None if value is None or math.isnan(value) else factor * value


def interval(row: Row, low: str = "low", high: str = "high") -> Quantity | None:
    """Return two numbers of a row as an interval about its ratio; None if they are missing."""
    bounds = number(row, low), number(row, high)
    ratio = number(row, "ratio")
    return None if None in bounds else Quantity(low=bounds[0], high=bounds[1], ratio=ratio)


def change(ratio: float | None) -> float | None:
    """Return a ratio as a change in %."""
    return None if ratio is None else 100.0 * (ratio - 1.0)


def _number_column(name: str, key: Any, spec: str = RATIO_FORMAT) -> Column:
    return Column(name, format=spec, value=lambda row: number(row, key))


def _ratio_column(name: str, key: Any) -> Column:
    """Return a column of ratios to the VJM's error, in colours on a page; noise has none."""

    def value(row: Row) -> Entry:
        ratio = number(row, key)
        return None if ratio is None else Quantity(ratio, ratio=None if key == "noise" else ratio)

    return Column(name, format=RATIO_FORMAT, value=value)


def _interval_column(name: str = INTERVAL, low: str = "low", high: str = "high") -> Column:
    return Column(name, format=RATIO_FORMAT, value=lambda row: interval(row, low, high))


# columns of a model


MODEL = Column("model", "text", value=lambda row: Name(row["model"], row["mark"]))
MODEL_KEY = Column("model", "text", value=lambda row: row["model"])
RATIO = _number_column("error / VJM's", "ratio")
RATIO_INTERVAL = replace(_interval_column(), is_chart=True)
VERDICT = Column(
    "verdict",
    "text",
    value=lambda row: "baseline" if row["model"] == REFERENCE_MODEL else row["verdict"],
)
WON = Column("won", value=lambda row: Quantity(share=(int(row["won"]), int(row["n robots"]))))
WORST = Column(
    "worst robot",
    format=lambda worst: worst.text(RATIO_FORMAT),
    value=lambda row: (
        None
        if row["model"] == REFERENCE_MODEL
        else Quantity(row["worst"], mark=str(row["worst robot"]))
    ),
)
FIT = Column(
    "fit", unit="s", format=lambda fit: duration(fit.value), value=lambda row: number(row, "fit_s")
)
CHANGE = Column(
    *("vs VJM", "number", "%", "+.0f"),
    is_change=True,
    value=lambda row: change(number(row, "ratio")),
)
P_REFERENCE = _number_column("p against the VJM", "p", ".2g")
P_BEST = _number_column("p against the best", "p best", ".2g")
LIKE_BEST_TEXT = Column(
    f"within {EQUAL_TEXT} of the best",
    "text",
    value=lambda row: {True: "yes", False: "no"}.get(row["like best"]),
)
WITHOUT_ONE = _interval_column("without any one robot", "without low", "without high")


def measured_column(dataset: str) -> Column:
    """Return the column of a measured data set: error over the VJM's, and the verdict."""

    def value(row: Row) -> Entry:
        ratio = number(row, ("measured", dataset))
        verdict = VERDICT_TEXTS.get(row["measured verdict", dataset], "")
        return None if ratio is None else Quantity(ratio, status=verdict, ratio=ratio)

    return Column(f"{dataset} (measured)", format=RATIO_FORMAT, value=value)


def metric_columns(metrics: Sequence[Metric]) -> list[Column]:
    """Return columns of metrics, grouped by axis; metrics without axes come last.

    A row has its values under (metric key, axis).
    """
    return [
        Column(
            f"{axis.upper()} {metric.label}".strip(),
            unit=PRINTED[metric.unit][0],
            format=number_format(metric),
            about={"axis": axis, "metric": metric.key},
            value=partial(_metric_value, (metric.key, axis)),
        )
        for axis in (*AXES, *WHOLE_VECTOR)
        for metric in metrics
        if axis in metric.axes
    ]


def _metric_value(key: tuple[str, str], row: Row) -> Entry:
    entry: Entry = row.get(key)
    return entry


# models over robots


MEASURED_NOTE = (
    "measured: p is corrected (Holm) for all pairs of models, so a verdict can be open although an "
    "interval excludes zero; same: equivalent."
)


def board_tables(
    scores: Scores, table: DataFrame, controls: Mapping[str, str], notes: Sequence[str] = ()
) -> list[Table]:
    """Return the tables over robots: ratios, further numbers, certainty, and controls.

    `table` is a `model_frame`; only its complete models are shown. `notes` are added to the
    first table.
    """
    if "won" not in table:
        return []
    rows = table[table["complete"]].sort_values("ratio", kind="stable").to_dict("records")
    measured = [key[1] for key in table if isinstance(key, tuple) and key[0] == "measured"]
    ratios = Table.of(
        f"Error over the VJM's, geometric mean over {scores.scope}",
        [
            *(MODEL, RATIO, RATIO_INTERVAL, VERDICT, WON, WORST),
            *map(measured_column, measured),
            FIT,
        ],
        rows,
        [
            f"{INTERVAL} over robots (Student's t of the logarithms); one vote per robot.",
            "verdict against the VJM: significant over robots (sign flips, Holm), or open; won: "
            "robots with the smallest error.",
            *([MEASURED_NOTE] if measured else []),
            *notes,
        ],
        about={"table": "board"},
    )
    certainty = Table.of(
        f"How sure, over {scores.scope}",
        [MODEL_KEY, P_REFERENCE, P_BEST, LIKE_BEST_TEXT, WITHOUT_ONE],
        rows,
        [
            "p: all choices of signs of the robots' differences, corrected (Holm) for all models.",
            f"within {EQUAL_TEXT}: shown by two one-sided t tests.",
        ],
        about={"table": "certainty"},
    )
    tables = [ratios, _further_table(table, rows), certainty]
    if controls and len(pairs := control_frame(scores, controls)):
        tables.append(_control_table(pairs))
    return [part for part in tables if len(part.columns) > 1]


def _further_table(table: DataFrame, rows: Sequence[Row]) -> Table:
    single = {"p95": "95th percentile", "path": "tool paths", "noise": "noise"}
    known_names = {key: name for key, name in single.items() if any(number(r, key) for r in rows)}
    keys: dict[Any, str] = {**known_names}
    for kind in ("few", "group"):
        keys |= {key: key[1] for key in table if isinstance(key, tuple) and key[0] == kind}
    notes = []
    if len(keys) > 1:
        notes.append(f"All numbers{' except noise' * ('noise' in keys)} are over the VJM's.")
    if "path" in keys:
        notes.append("tool paths: error left after the correction.")
    if "noise" in keys:
        notes.append("noise: over the error of the instrument's noise.")
    return Table.of(
        "Other numbers of the same models, geometric means over robots",
        [MODEL_KEY, *(_ratio_column(name, key) for key, name in keys.items())],
        rows,
        notes,
        about={"table": "more"},
    )


def _control_table(pairs: DataFrame) -> Table:
    return Table.of(
        "Models against their physics model or teacher",
        [
            *(MODEL_KEY, Column("against", "text", value=lambda row: row["control"])),
            *(
                _number_column("error ratio", "ratio"),
                RATIO_INTERVAL,
                _number_column("p", "p", ".2g"),
            ),
            Column("equal", "text", value=lambda row: "yes" if row["equal"] else "no"),
        ],
        pairs.to_dict("records"),
        [f"equal: within {EQUAL_TEXT} (two one-sided t tests); p: sign flips over robots, Holm."],
        about={"table": "controls"},
    )


# models in several tasks


def model_table(scores: Scores, table: DataFrame, title: str, notes: Sequence[str]) -> Table:
    """Return a row per model of a `model_frame`: median error, change, verdicts and fit time."""
    ends = ("low", "high") if scores.claim else ("smallest", "largest")
    kind = INTERVAL if scores.claim else "range"
    over = scores.scope or counted(len(scores.tasks), "comparison")
    chart = Column(
        f"error / VJM's: {kind} over {over}",
        format=RATIO_FORMAT,
        is_chart=True,
        value=lambda row: interval(row, *ends),
    )
    return Table.of(
        title,
        [
            MODEL,
            Column(
                "median error",
                unit=scores.key.unit,
                format=number_format(scores.key.metric),
                value=lambda row: number(row, "median", scores.key.factor),
            ),
            *(CHANGE, chart),
            *(Column(name, value=itemgetter(name)) for name in _COUNTS),
            FIT,
        ],
        with_verdict_counts(table, scores).to_dict("records"),
        notes,
    )


_COUNTS = ("better", "worse", "open")


def error_matrix(scores: Scores, models: Sequence[str]) -> DataFrame:
    """Return (models, headings) mean errors in the metric's unit; NaN: a score is missing.

    A heading is data set, protocol and condition: specimens and seeds together.
    """
    heading = ["family", "protocol", "condition"]
    groups = scores.frame.groupby([*heading, "model"], sort=False)["error"]
    n_tasks = scores.frame.groupby(heading, sort=False)["task"].nunique()
    means, counts = groups.mean().unstack("model"), groups.size().unstack("model")
    complete = means.where(counts.eq(n_tasks, axis="index"))
    return complete.reindex(index=[*scores.columns], columns=[*models]).T


def matrix_table(scores: Scores, models: Sequence[str]) -> Table:
    """Return mean scores by model, data set and protocol; the best ones are marked."""
    key, errors = scores.key, error_matrix(scores, models)
    best = (key.sign * errors).idxmin().to_dict()
    written = SCREEN_FORMAT if key.unit == "mm" else number_format(key.metric)

    has_ratios = REFERENCE_MODEL in errors.index and key.sign > 0.0
    vjm = errors.loc[REFERENCE_MODEL].to_dict() if has_ratios else {}

    def cell(error: float, heading: object, is_best: bool = False) -> Entry:
        if math.isnan(error):
            return None
        ratio = error / vjm[heading] if vjm.get(heading) else None
        return Quantity(key.factor * error, mark=BEST_MARK * is_best, ratio=ratio)

    columns = [
        Column(
            " ".join(filter(None, (protocol, condition))),
            unit=key.unit,
            format=written,
            group=f"{family} (measured)" if tasks[0].kind == "measured" else family,
        )
        for (family, protocol, condition), tasks in scores.columns.items()
    ]
    rows: list[list[Entry]] = [
        [
            Name(str(model), scores.mark(str(model))),
            *(cell(error, heading, best[heading] == model) for heading, error in row.items()),
        ]
        for model, row in errors.to_dict("index").items()
    ]
    floors = [scores.noise(tasks) for tasks in scores.columns.values()]
    if not all(map(math.isnan, floors)):
        rows.append([NOISE_FLOOR, *(cell(floor, None) for floor in floors)])
    title = f"{key.text}, mean over splits; {BEST_MARK}: best of the column"
    return Table(title, [*texts("model"), *columns], rows, unit=key.unit)


# models in one task


_TASK_METRICS = tuple(METRICS[key] for key in ("norm", "mae", "norm-p95", "norm-max", "removed"))


def task_table(task: ScoredTask, title: str = "") -> Table:
    """Return models by 3-D error: change against the VJM, axes and the largest error.

    The best model comes first. Models without a result and the noise floor come last.
    """

    def row(name: str, mark: str = "", results: Sequence[CellResult] = ()) -> dict[Any, Any]:
        values = metric_values(results, _TASK_METRICS) if results else {}
        return {"model": name, "mark": mark, **values}

    ratios = {of["model"]: of["error ratio"] for of in task.rows()}
    models = sorted(task.models, key=task.mean)
    rows = [
        {
            **row(name, mark_of(task.task.models[name].presentation), task.results[name]),
            "ratio": math.nan if name == REFERENCE_MODEL else ratios[name],
        }
        for name in models
    ]
    rows += [
        {**row(name), "status": task.missing[name].partition(":")[0]}
        for name in sorted(task.missing)
    ]
    has_paths = task.task.has_paths
    bounds = (NOISE_FLOOR, BOUND_NAMES["uncorrected"]) if has_paths else (NOISE_FLOOR,)
    rows += [row(name, results=results) for name in bounds if (results := task.bounds(name))]

    def error(row: Row) -> Entry:
        status = row.get("status")
        return Quantity(status=status) if status else row.get(("norm", ""))

    def ratio(row: Row) -> Entry:
        if row["model"] == NOISE_FLOOR:
            return Quantity(status="floor")
        return change(number(row, "ratio"))

    axes = [
        Column(axis.upper(), format=SCREEN_FORMAT, value=_mean_of("mae", axis)) for axis in AXES
    ]
    paths = [
        Column("95 % below", format=SCREEN_FORMAT, value=_mean_of("norm-p95")),
        Column("removed", unit="%", format=".0f", value=_mean_of("removed")),
    ]
    return Table.of(
        title,
        [
            MODEL,
            Column("3-D error", format=SCREEN_FORMAT, value=error),
            Column("vs VJM", format=signed_percent, is_change=True, value=ratio),
            *(paths if has_paths else axes),
            Column("largest", format=SCREEN_FORMAT, value=_mean_of("norm-max")),
        ],
        rows,
        unit="mm",
    )


def _mean_of(metric: str, axis: str = "") -> Value:
    """Return a function of a row: the mean of a metric, without its deviation."""

    def value(row: Row) -> Entry:
        mean = row.get((metric, axis))
        return None if mean is None else Quantity(mean.value, n=mean.n)

    return value


def dataset_table(scores: Scores, models: Sequence[str], notes: Sequence[str]) -> Table:
    """Return the models on a data set, best first, with intervals.

    Args:
        scores: scores in tasks that differ at most in their seed.
        models: models to show.
        notes: notes below the table.
    """
    key, first = scores.key, scores.tasks[0]
    rows = [row for task in scores.tasks for row in _dataset_rows(scores, task, models)]
    has_seeds = len(scores.tasks) > 1
    intervals = [
        Column(
            f"over {name}",
            *("number", key.unit, number_format(key.metric), "difference from the VJM"),
            value=itemgetter(name),
        )
        for name in ("splits", "poses")
        if any(row[name] is not None for row in rows)
    ]
    apart = f" | {SELECTION_MARK}s: not a fair comparison" if scores.selects_on_test else ""
    return Table.of(
        f"{first.name.text} ({first.kind}), {counted(len(first.splits), 'split')}{apart}",
        [
            MODEL,
            *([Column("seed", "text", value=lambda row: row["seed"])] if has_seeds else []),
            Column(
                key.text,
                unit=key.unit,
                format=number_format(key.metric),
                about={"metric": key.metric.key, "axis": key.axis},
                value=lambda row: row["score"],
            ),
            *(CHANGE, *intervals, Column("verdict", "text", value=lambda row: row["verdict"])),
        ],
        rows,
        notes,
        unit=key.unit,
        about={
            **{"table": "data set", "dataset": first.name.dataset, "kind": first.kind},
            **{"protocol": first.name.protocol, "condition": first.name.condition},
        },
    )


def _dataset_rows(scores: Scores, task: ScoredTask, models: Sequence[str]) -> Iterator[Row]:
    """Yield the models in a task, best first; models without a score come last."""
    key = scores.key
    like_best = task.like_best() if task.scores and not key.is_cost else set()
    best = task.best() if task.scores else ""
    ratios = {row["model"]: row["error ratio"] for row in task.rows()}

    def order(name: str) -> tuple[bool, float, str]:
        there = name in task.scores
        return not there, key.sign * task.mean(name) if there else math.inf, name

    for name in sorted(models, key=order):
        score = Quantity(status=task.failed(name))
        if name in task.scores:
            values = key.factor * task.scores[name]
            spread = float(values.std(ddof=1)) if len(values) > 1 else None
            mark = BEST if name == best else LIKE_BEST if name in like_best else ""
            score = Quantity(float(values.mean()), spread, n=len(values), mark=mark)
        is_reference = name == REFERENCE_MODEL
        bounds = [
            Quantity(low=key.factor * estimate.low, high=key.factor * estimate.high)
            for estimate in ([] if is_reference else task.estimates(name))
        ]
        over_splits = bool(bounds) and task.errors.of_splits is not None
        yield {
            "model": name,
            "mark": scores.mark(name, task.name.protocol),
            "seed": str(task.name.seed),
            "score": score,
            "ratio": ratios.get(name),
            "splits": bounds[0] if over_splits else None,
            "poses": bounds[-1] if len(bounds) > over_splits else None,
            "verdict": "baseline" if is_reference else VERDICT_TEXTS[task.verdict(name)] or None,
        }


def score_list(scores: Scores, models: Sequence[str], notes: Sequence[str]) -> Table:
    """Return the scores of all models in all tasks, or the reasons for missing ones; for json."""
    key = scores.key
    rows: list[list[Entry]] = [
        [
            Name(model, scores.mark(model, task.name.protocol)),
            *(*astuple(task.name), len(task.splits), task.left_out),
            key.factor * task.mean(model)
            if model in task.scores
            else Quantity(status=task.missing.get(model, "")),
        ]
        for task in scores.tasks
        for model in models
    ]
    names = [field.name for field in fields(TaskName)]
    return Table(
        f"Scores | {key.text}",
        [
            *texts("model", *names, "splits", "splits left out"),
            Column(key.text, unit=key.unit, format=number_format(key.metric)),
        ],
        rows,
        notes,
        about={"table": "scores", "selects_on_test": scores.selects_on_test},
        formats=("json",),
    )


# costs


def cost_table(scores: Scores, models: Sequence[str]) -> Table:
    """Return the costs of models; models without recorded costs are omitted."""
    rows = [
        {"model": name, "mark": scores.mark(name), "costs": costs}
        for name in models
        if (costs := scores.costs(name))
    ]
    return Table.of(
        f"Costs of {counted(sum(len(row['costs']) for row in rows), 'fit')} | median (lowest to "
        "highest)",
        COSTS,
        rows,
        ["wall times depend on the machine; a cached pre-training costs nothing."],
        about={"table": "costs", "selects_on_test": scores.selects_on_test},
        formats=WRITTEN,
    )


def _cost_spread(key: str, row: Row) -> Quantity | None:
    """Return median and range of a cost over the fits that recorded it."""
    metric, costs = METRICS[key], row["costs"]
    _, factor = PRINTED[metric.unit]
    of_cost: Callable[[Cost], float | None] = metric.of_cost  # type: ignore[assignment]
    values = [factor * value for value in map(of_cost, costs) if value is not None]
    return Quantity(float(np.median(values)), low=min(values), high=max(values)) if values else None


def _cost_text(cost: Quantity, unit: str, text: Callable[[float], str]) -> str:
    """Return "2 ms (1 to 3)", or "2 ms" if all are equal."""
    median, low, high = (text(value or 0.0) for value in (cost.value, cost.low, cost.high))
    median_text = f"{median} {unit}".rstrip()
    return median_text if low == high else f"{median_text} ({low} to {high})"


def _time_text(cost: Quantity) -> str:
    """Return a time [ms] in a suitable unit."""
    units = (("us", 1e3), ("ms", 1.0), ("s", 1e-3))
    median = cost.value or 0.0
    unit, factor = next((size for size in units if median * size[1] < 999.5), units[-1])
    return _cost_text(cost, unit, lambda value: _three_digits(value * factor))


def _three_digits(value: float) -> str:
    """Format a positive number with three significant digits: 0.0123, 1.23, 12,300."""
    decimals = 2 - math.floor(math.log10(value)) if value > 0.0 else 0
    return f"{round(value, decimals):,.15g}"


def _cost_column(key: str, name: str, text: Callable[[Quantity], str]) -> Column:
    unit, _ = PRINTED[METRICS[key].unit]
    return Column(
        name, unit=unit, format=text, about={"metric": key}, value=partial(_cost_spread, key)
    )


COSTS = (
    MODEL,
    _cost_column("fit-time", "fit time", _time_text),
    _cost_column("throughput", "predictions/s", lambda cost: _cost_text(cost, "", _three_digits)),
    _cost_column("latency", "latency of one", _time_text),
    _cost_column("memory", "memory [MiB]", lambda cost: _cost_text(cost, "", "{:.1f}".format)),
    Column("fits", value=lambda row: len(row["costs"])),
)
"""Columns of the costs."""
