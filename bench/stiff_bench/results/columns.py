"""Columns about models, and their tables.

A column has a heading, a unit, a format and the value of a row. Rows are those of
`scores.model_frame` and of the functions below. To add a column, add it here and to the list
of its table; docs/definitions.md explains columns and marks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from operator import attrgetter, itemgetter, methodcaller
from statistics import fmean
from typing import TYPE_CHECKING, Any

from stiff_bench.results.fit_values import bound_results, mean_over, metric_values
from stiff_bench.results.notes import (
    failure_lines,
    mark_of,
    number_notes,
    outcome_notes,
    size_notes,
)
from stiff_bench.results.scored_task import NOISE_FLOOR, ScoredTask
from stiff_bench.results.scores import Scores, control_rows
from stiff_bench.store.names import grouped
from stiff_bench.tables.published import MARK, NOTE, published_errors
from stiff_bench.tables.table import BEST_MARK, Column, Entry, Name, Quantity, Table
from stiff_bench.tables.table import text_columns as texts
from stiff_bench.tables.units import PRINTED, counted, duration, percent
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.record import FitResult, Presentation
from stiff_protocols.contract.types import AXES, BOUND_NAMES
from stiff_protocols.scoring.metrics import METRICS, WHOLE_VECTOR, Metric
from stiff_protocols.scoring.over_robots import MARGIN
from stiff_protocols.scoring.paired import LEVEL

if TYPE_CHECKING:
    from pandas import DataFrame

Row = Mapping[Any, Any]
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


def change(ratio: float | None) -> float | None:
    """Return a ratio as a change in %."""
    return None if ratio is None else 100.0 * (ratio - 1.0)


def ratio_column(
    name: str,
    key: Any = None,
    ends: tuple[Any, Any] = (None, None),
    *,
    verdict: Any = None,
    color: Any = None,
    is_chart: bool = False,
) -> Column:
    """Return a column of ratios to the VJM's error.

    Args:
        name: heading.
        key: key of the ratio in a row; None: the cell has only an interval.
        ends: keys of the interval's ends.
        verdict: key of the verdict that is printed next to the ratio.
        color: key of the ratio that colours the cell on a page; None: no colour.
        is_chart: True if a page shows the cells as a chart.
    """

    def value(row: Row) -> Entry:
        ratio, low, high = (number(row, of) for of in (key, *ends))
        if ratio is None and None in (low, high):
            return None
        status = VERDICT_TEXTS.get(row.get(verdict), "")
        return Quantity(ratio, low=low, high=high, status=status, ratio=number(row, color))

    return Column(name, format=RATIO_FORMAT, is_chart=is_chart, value=value)


def _won(row: Row) -> Quantity | None:
    """Return the number of robots with the smallest error; None without every score."""
    won = number(row, "won")
    return None if won is None else Quantity(share=(int(won), int(row["n robots"])))


def _worst(row: Row) -> Quantity | None:
    """Return the largest ratio of a robot, with its name; None for the VJM."""
    worst = number(row, "worst")
    return None if worst is None else Quantity(worst, mark=str(row["worst robot"]))


# columns of a model


MODEL = Column("model", "text", value=lambda row: Name(row["model"], row["mark"]))
MODEL_KEY = Column("model", "text")
RATIO = ratio_column("error / VJM's", "ratio")
RATIO_INTERVAL = ratio_column(INTERVAL, ends=("low", "high"), color="ratio", is_chart=True)
VERDICT = Column("verdict", "text", value=lambda row: row["verdict"] if row["complete"] else None)
WON = Column("won", value=_won)
WORST = Column("worst robot", format=lambda worst: worst.text(RATIO_FORMAT), value=_worst)
FIT = Column(
    "fit", unit="s", format=lambda fit: duration(fit.value), value=lambda row: number(row, "fit_s")
)
CHANGE = Column(
    *("vs VJM", "number", "%", "+.0f"),
    is_change=True,
    value=lambda row: change(number(row, "ratio")),
)
VERDICT_RIVAL = Column("against it", "text", value=itemgetter("verdict rival"))
LIKE_BEST_TEXT = Column(
    f"within {EQUAL_TEXT} of the best",
    "text",
    value=lambda row: {True: "yes", False: "no"}.get(row["like best"]),
)
WITHOUT_ONE = ratio_column(
    "without any one robot", ends=("without low", "without high"), color="ratio"
)


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
    complete = table[table["complete"]]
    rows = complete.to_dict("records")
    notes = [
        f"{INTERVAL} over robots (Student's t of the logarithms); one vote per robot.",
        "verdict against the VJM: significant over robots (sign flips, Holm), or open; won: "
        "robots with the smallest error, a tie counts for no model.",
        *([MEASURED_NOTE] if names_of_kind(table, "measured verdict") else []),
        *notes,
    ]
    title = f"Error over the VJM's, geometric mean over {scores.scope}"
    ratios = model_table(scores, complete, title, notes)
    rival = rows[0]["rival"]
    certainty = Table.of(
        f"How sure, over {scores.scope}; the best spring model is {rival}",
        [MODEL_KEY, VERDICT_RIVAL, LIKE_BEST_TEXT, WITHOUT_ONE],
        rows,
        [
            f"against it: verdict on a model and {rival}; sign flips over robots, Holm.",
            f"within {EQUAL_TEXT}: shown by two one-sided t tests.",
        ],
        about={"table": "certainty"},
    )
    board = replace(ratios, about={"table": "board"})
    tables = [board, *_world_tables(table, rows), _further_table(table, rows)]
    tables += [*_coverage_table(table, rows), certainty]
    if pairs := control_rows(scores, controls):
        tables.append(_control_table(pairs))
    return [part for part in tables if len(part.columns) > 1]


def _world_tables(table: DataFrame, rows: Sequence[Row]) -> Iterator[Table]:
    """Yield the table of ratios by world, with intervals and without verdicts."""

    def of_world(name: str) -> Column:
        key, ends = ("world", name), (("world low", name), ("world high", name))
        return ratio_column(name, key, ends, color=key)

    if names := names_of_kind(table, "world"):
        floors = {name: number(rows[0], ("oracle", name)) for name in names}
        oracle = ", ".join(f"{name} {floor:.2f}" for name, floor in floors.items() if floor)
        yield Table.of(
            "Error over the VJM's by world",
            [MODEL_KEY, *map(of_world, names)],
            rows,
            [
                f"in brackets: {INTERVAL} over robots; no test is made here.",
                "oracle, which knows all but noise and state of friction, against readings: "
                f"{oracle} times the VJM's error.",
            ],
            about={"table": "worlds"},
        )


def _coverage_table(table: DataFrame, rows: Sequence[Row]) -> Iterator[Table]:
    """Yield the table of the intervals' coverage by world, and with fewer poses in all worlds."""

    def of_name(name: str) -> Column:
        return Column(name, format=".0f", value=lambda row: number(row, ("coverage", name), 100.0))

    names = names_of_kind(table, "coverage")
    if with_intervals := [row for row in rows if any(number(row, ("coverage", n)) for n in names)]:
        yield Table.of(
            "Readings inside the models' own intervals [%], mean over robots",
            [MODEL_KEY, *map(of_name, names)],
            with_intervals,
            ["mean over the axes; 90 is best for 90 % intervals; fewer poses: mean of the worlds."],
            about={"table": "coverage"},
        )


def names_of_kind(table: DataFrame, kind: str) -> list[str]:
    """Return the names of a kind of columns of a `model_frame`, such as measured data sets."""
    return [key[1] for key in table if isinstance(key, tuple) and key[0] == kind]


def model_table(scores: Scores, table: DataFrame, title: str, notes: Sequence[str] = ()) -> Table:
    """Return a row per model of a `model_frame`: error over the VJM's, verdicts and fit time.

    With enough robots, interval and verdict are over robots; else there are the range over tasks
    and the numbers of tasks by verdict.
    """
    rows = table.to_dict("records")
    if "won" in table:
        columns = [RATIO_INTERVAL, VERDICT, WON, WORST]
        for name in names_of_kind(table, "measured"):
            key, verdict = ("measured", name), ("measured verdict", name)
            heading = f"{name} (measured)"
            columns.append(ratio_column(heading, key, verdict=verdict, color=key))
    else:
        span = f"range over {counted(len(scores.tasks), 'comparison')}"
        ends = "smallest", "largest"
        chart = ratio_column(span, ends=ends, color="ratio", is_chart=True)
        columns = [chart, *map(Column, ("better", "worse", "open"))]
        for row in rows:
            counts = scores.verdict_counts(row["model"])
            n_open = counts["open"] + counts["equivalent"]
            row |= {"better": counts["a"], "worse": counts["b"], "open": n_open}
    return Table.of(title, [MODEL, RATIO, *columns, FIT], rows, notes)


def _further_table(table: DataFrame, rows: Sequence[Row]) -> Table:
    single = {"p95": "95th percentile", "path": "tool paths"}
    single |= {name: name for name in ("readings", "noise", "without clean")}
    keys: dict[Any, str] = {
        **{key: name for key, name in single.items() if any(number(row, key) for row in rows)},
        **{("few", name): name for name in names_of_kind(table, "few")},
    }
    notes = {
        f"All numbers{' except noise' * ('noise' in keys)} are over the VJM's.": len(keys) > 1,
        "tool paths: error left after the correction.": "path" in keys,
        "noise: over the error of the instrument's noise.": "noise" in keys,
        "readings: the error against the tracker's readings, with their noise.": "readings" in keys,
    }
    return Table.of(
        "Other numbers of the same models, geometric means over robots",
        [
            MODEL_KEY,
            *(
                ratio_column(name, key, color=None if key == "noise" else key)
                for key, name in keys.items()
            ),
        ],
        rows,
        [note for note, is_shown in notes.items() if is_shown],
        about={"table": "more"},
    )


def _control_table(pairs: Sequence[Row]) -> Table:
    return Table.of(
        "Models against their physics model or teacher",
        [
            *(MODEL_KEY, Column("against", "text", value=itemgetter("control"))),
            *(ratio_column("error ratio", "ratio"), RATIO_INTERVAL),
            Column("equal", "text", value=lambda row: "yes" if row["equal"] else "no"),
        ],
        pairs,
        [f"equal: within {EQUAL_TEXT} (two one-sided t tests)."],
        about={"table": "controls"},
    )


# models in several tasks


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
    originals = errors.drop(index=[*scores.copies], errors="ignore")
    best = (key.sign * originals).fillna(math.inf).idxmin()
    has_ratios = REFERENCE_MODEL in errors.index and key.sign > 0.0
    vjm: Any = errors.loc[REFERENCE_MODEL] if has_ratios else {}
    of_models: dict[Any, Any] = errors.to_dict("index")

    def cell(error: float, heading: Any, model: str = "") -> Entry:
        if math.isnan(error):
            return None
        ratio = error / vjm[heading] if model and vjm.get(heading) else None
        mark = BEST_MARK if best[heading] == model else ""
        return Quantity(key.factor * error, mark=mark, ratio=ratio)

    columns = [
        Column(
            " ".join(filter(None, (protocol, condition))),
            unit=key.unit,
            format=SCREEN_FORMAT if key.unit == "mm" else number_format(key.metric),
            group=f"{family} (measured)" if tasks[0].kind == "measured" else family,
        )
        for (family, protocol, condition), tasks in scores.columns.items()
    ]
    rows: list[list[Entry]] = [
        [Name(model, scores.mark(model)), *(cell(row[of], of, model) for of in scores.columns)]
        for model, row in of_models.items()
    ]
    noise = dict(zip(scores.frame["task"], scores.frame["noise"], strict=True))
    floors = {of: fmean(noise[task] for task in tasks) for of, tasks in scores.columns.items()}
    if not all(map(math.isnan, floors.values())):
        rows.append([NOISE_FLOOR, *(cell(floor, of) for of, floor in floors.items())])
    title = f"{key.text}, mean over splits; {BEST_MARK}: best of the column"
    return Table(title, [*texts("model"), *columns], rows, unit=key.unit)


# models in one task


_TASK_METRICS = tuple(METRICS[key] for key in ("norm", "mae", "norm-p95", "norm-max", "removed"))


def task_table(task: ScoredTask, title: str = "") -> Table:
    """Return models by 3-D error: change against the VJM, axes and the largest error.

    The best model comes first. Models without a result and the noise floor come last.
    """
    has_paths = task.task.has_paths
    bounds = (NOISE_FLOOR, BOUND_NAMES["uncorrected"]) if has_paths else (NOISE_FLOOR,)
    results: dict[str, Sequence[FitResult]] = {
        **{name: task.results[name] for name in sorted(task.models, key=task.mean)},
        **dict.fromkeys(sorted(task.missing), ()),
        **{name: of_bound for name in bounds if (of_bound := task.bounds(name))},
    }
    rows = [
        {
            "model": name,
            "mark": task.mark(name) if name in task.scores else "",
            "status": task.status(name),
            "ratio": math.nan if name == REFERENCE_MODEL else task.ratio(name),
            **(metric_values(of_model, _TASK_METRICS) if of_model else {}),
        }
        for name, of_model in results.items()
    ]

    def error(row: Row) -> Entry:
        return Quantity(status=row["status"]) if row["status"] else row.get(("norm", ""))

    def ratio(row: Row) -> Entry:
        is_floor = row["model"] == NOISE_FLOOR
        return Quantity(status="floor") if is_floor else change(number(row, "ratio"))

    axes = [_mean_column(axis.upper(), "mae", axis) for axis in AXES]
    paths = [
        _mean_column("95 % below", "norm-p95"),
        replace(_mean_column("removed", "removed"), unit="%", format=".0f"),
    ]
    return Table.of(
        title,
        [
            MODEL,
            Column("3-D error", format=SCREEN_FORMAT, value=error),
            Column("vs VJM", format=signed_percent, is_change=True, value=ratio),
            *(paths if has_paths else axes),
            _mean_column("largest", "norm-max"),
        ],
        rows,
        unit="mm",
    )


def _mean_column(name: str, metric: str, axis: str = "") -> Column:
    """Return a column of the mean of a metric, without its deviation."""

    def value(row: Row) -> Entry:
        mean = row.get((metric, axis))
        return None if mean is None else replace(mean, spread=None)

    return Column(name, format=SCREEN_FORMAT, value=value)


def dataset_table(scores: Scores, notes: Sequence[str], *, has_verdicts: bool = True) -> Table:
    """Return the models in tasks that differ at most in their seed, best first, with intervals.

    Without verdicts there are no marks either.
    """
    key, first = scores.key, scores.tasks[0]
    rows = [
        row
        for task in scores.tasks
        for row in _dataset_rows(scores, task, has_verdicts=has_verdicts)
    ]
    number: dict[str, Any] = {"unit": key.unit, "format": number_format(key.metric)}
    about = {"metric": key.metric.key, "axis": key.axis}
    intervals = [
        Column(f"over {name}", group="difference from the VJM", value=itemgetter(name), **number)
        for name in ("splits", "poses")
        if any(row[name] is not None for row in rows)
    ]
    return Table.of(
        f"{first.name.text} ({first.kind}), {counted(len(first.splits), 'split')}",
        [
            *(MODEL, *(texts("seed") if len(scores.tasks) > 1 else [])),
            Column(key.text, value=itemgetter("score"), about=about, **number),
            *(CHANGE, *intervals, *(texts("verdict") if has_verdicts else [])),
        ],
        rows,
        notes,
        unit=key.unit,
        about={
            **{"table": "data set", "dataset": first.name.dataset, "kind": first.kind},
            **{"protocol": first.name.protocol, "condition": first.name.condition},
        },
    )


def _dataset_rows(scores: Scores, task: ScoredTask, *, has_verdicts: bool) -> Iterator[Row]:
    """Yield the models in a task, best first; models without a score come last."""
    key = scores.key
    best, like_best = (task.best(), task.like_best()) if has_verdicts else ("", set())
    ranked = sorted(task.models, key=lambda name: key.sign * task.mean(name))
    for name in (*ranked, *sorted({*scores.models, *scores.missing} - {*ranked})):
        score = Quantity(status=task.status(name))
        if name in task.scores:
            mark = BEST if name == best else LIKE_BEST if name in like_best else ""
            score = mean_over((key.factor * task.scores[name]).tolist(), mark)
        is_reference = name == REFERENCE_MODEL
        bounds = [
            Quantity(low=key.factor * estimate.low, high=key.factor * estimate.high)
            for estimate in ([] if is_reference else task.estimates(name))
        ]
        verdict = task.verdict(name) if has_verdicts else None
        over_splits = bool(bounds) and task.errors.of_splits is not None
        yield {
            "model": name,
            "mark": scores.mark(name),
            "seed": str(task.name.seed),
            "score": score,
            "ratio": task.ratio(name),
            "splits": bounds[0] if over_splits else None,
            "poses": bounds[-1] if len(bounds) > over_splits else None,
            "verdict": "baseline" if is_reference else VERDICT_TEXTS[verdict] or None,
        }


# metrics of one data set, like the paper's tables


USUAL_METRICS = ("mae", "stde", "me")
PATH_METRICS = ("norm", "norm-p95", "norm-max", "removed")


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
            value=methodcaller("get", (metric.key, axis)),
        )
        for axis in (*AXES, *WHOLE_VECTOR)
        for metric in metrics
        if axis in metric.axes
    ]


def metric_tables(results: Sequence[FitResult], metrics: Sequence[Metric]) -> list[Table]:
    """Return a table per data set, protocol, condition and seed, in the results' order.

    Models on different data, pre-training data, splits or coverage are in separate tables. Without
    `metrics` the tables show the usual metrics, or the metrics of tool paths.
    """
    groups = grouped(
        results,
        lambda result: (
            result.presentation.dataset,
            result.presentation.protocol,
            result.fit.condition,
            result.fit.seed,
        ),
    )
    return [
        _table(dict(models), tuple(metrics))
        for group in groups.values()
        for models in grouped(
            grouped(group, lambda result: result.presentation.model).items(),
            lambda model: _tested_on(model[1]),
        ).values()
    ]


def _tested_on(results: Sequence[FitResult]) -> frozenset[object]:
    """Return the set of data and split hashes that models in one table share."""
    identity = attrgetter("data_sha256", "source_sha256", "split_sha256", "coverage")
    return frozenset(identity(result.fit) for result in results)


def _table(by_model: dict[str, list[FitResult]], metrics: tuple[Metric, ...]) -> Table:
    group = list(chain.from_iterable(by_model.values()))
    fit, presentation = group[0].fit, group[0].presentation
    usual = PATH_METRICS if presentation.measured_sha256 else USUAL_METRICS
    metrics = metrics or tuple(METRICS[key] for key in usual)
    extra = {
        name: results
        for name in (REFERENCE_MODEL, *BOUND_NAMES.values())
        if name not in by_model and (results := bound_results(by_model.values(), name))
    }
    reference = {name: extra.pop(name) for name in [REFERENCE_MODEL] if name in extra}
    by_model = reference | by_model | extra  # known bounds of a simulation come last
    warned = presentation.selects_on_test or presentation.reports_training
    notes = [*presentation.caveats, *size_notes(group), *([presentation.warning] * warned)]
    for results in by_model.values():
        notes += outcome_notes(results)
    notes += failure_lines(group)
    published = {}
    if presentation.published and not fit.condition:
        keys = {metric.key for metric in metrics}
        published = {
            method: values
            for method, values in published_errors(presentation.published).items()
            if any(key in keys for key, _ in values)
        }
    notes += [f"[{MARK}]: {NOTE}."] if published else []
    n_splits = len({result.fit.split_index for result in group})
    facts: dict[str, Entry] = {
        **{"dataset": presentation.dataset, "kind": presentation.kind},
        **{"protocol": presentation.protocol, "condition": fit.condition},
        **{"splits": n_splits, "seed": fit.seed, "source": "ours"},
    }
    rows = [
        {"model": name, **facts, **values}
        for name, values in (_model_values(model, of, metrics) for model, of in by_model.items())
        if values or name.text not in extra  # bounds have no costs and intervals
    ]
    of_others = {**dict.fromkeys(facts), "source": MARK}
    rows += [
        {"model": Name(method, MARK), **of_others, **values} for method, values in published.items()
    ]
    return Table.of(
        _title(group[0], n_splits, metrics),
        [
            Column("model", "text"),
            *(Column(name, "text", hidden=True) for name in facts),
            *metric_columns(metrics),
        ],
        rows,
        notes=notes,
        details=[note for results in by_model.values() for note in number_notes(results)],
        unit=PRINTED["m"][0],
        about={} if fit.coverage is None else {"nominal_coverage": fit.coverage},
    )


def _model_values(
    model: str, results: Sequence[FitResult], metrics: Sequence[Metric]
) -> tuple[Name, dict[tuple[str, str], Quantity]]:
    """Return a model with its values; without values if a fit failed or was skipped."""
    statuses = [result.status for result in results]
    if failed := statuses.count("failed"):
        return Name(model, f"FAILED in {failed} of {len(results)} splits"), {}
    if "skipped" in statuses:
        return Name(model, "SKIPPED"), {}
    return Name(model, mark_of(results[0].presentation)), metric_values(results, metrics)


def setting(presentation: Presentation, condition: str, n_splits: int, seed: int) -> str:
    """Return data set, protocol, condition, splits and seed for a title."""
    data = f"{presentation.dataset} ({presentation.kind})"
    protocol = " | ".join(filter(None, (presentation.protocol, condition)))
    return f"{data} | {protocol}, {counted(n_splits, 'split')}, seed {seed}"


def _title(first: FitResult, n_splits: int, metrics: Sequence[Metric]) -> str:
    """Return the setting, unit and nominal coverage in one line."""
    fit, presentation = first.fit, first.presentation
    spread = ", mean ± standard deviation over splits" if n_splits > 1 else ""
    if presentation.pooled:
        spread = " over the predictions of all splits"
    units = " and ".join(filter(None, dict.fromkeys(PRINTED[metric.unit][0] for metric in metrics)))
    intervals = "" if fit.coverage is None else f" | {percent(fit.coverage)} intervals"
    of_fits = setting(presentation, fit.condition, n_splits, fit.seed)
    return f"{of_fits} | {units}{spread}{intervals}"
