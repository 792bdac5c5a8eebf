"""Compare models over robots if there are enough, else per data set; no ranks.

The main number of a model is its error over the VJM's: the geometric mean over robots, and for each
robot over its data sets with equal weights. Measured robots have separate columns and are never
averaged with simulated robots.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.results.load import StoredResults, Task, newest_tasks
from stiff_bench.results.notes import (
    SELECTION_MARK,
    TRAINING_MARK,
    left_out_notes,
    same_name_other_data,
    sources,
)
from stiff_bench.results.scored_task import SortKey
from stiff_bench.results.scores import Scores
from stiff_bench.results.selection import EVERYTHING, Selection
from stiff_bench.store.names import grouped, labels, without_options
from stiff_bench.tables.units import first_few
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import CellResult
from stiff_protocols.scoring.over_robots import (
    corrected_p_values,
    equivalence_p_value,
    mean_ratio,
    without_one,
)
from stiff_protocols.scoring.paired import LEVEL

if TYPE_CHECKING:
    from pandas import DataFrame, Series

SEED_OPTIONS = ("pretrain_seed",)
"""Options of models that only repeat a training with another seed."""
PLAN = ["robot", "family", "protocol"]
"""Columns of a vote: each data set and protocol of a robot has the same weight."""


def robot_logs(rows: DataFrame, value: str, *, partial: bool = False) -> DataFrame:
    """Return (robots, models) mean logarithms of a ratio, with one vote per plan of a robot.

    A model needs only one split of a data set: its error is divided by the VJM's on that split.

    Args:
        rows: rows of `Scores.frame`.
        value: column of the ratio.
        partial: True to average the plans that a model has; else its mean is then NaN.
    """
    logs = rows.assign(log=np.log(rows[value].where(rows[value] > 0.0)))
    votes = logs.groupby([*PLAN, "model"], sort=False)["log"]
    means = votes.agg(_mean)
    by_plan = means if partial else means.where(votes.count() == votes.size())
    plans = rows.set_index(PLAN).index.unique()
    table = by_plan.unstack("model").reindex(index=plans, columns=rows["model"].unique())
    robots = table.groupby("robot", sort=False)
    by_robot = robots.agg(_mean)
    return by_robot if partial else by_robot.where(robots.count().eq(robots.size(), axis="index"))


def _mean(values: Any) -> float:
    """Return the mean without NaN; its rounding does not depend on the version of pandas."""
    present = values.dropna().to_numpy()
    return float(np.mean(present)) if len(present) else math.nan


def model_frame(
    scores: Scores,
    few: Mapping[str, Scores] | None = None,
    groups: Mapping[str, Collection[str]] | None = None,
) -> DataFrame:
    """Return a row per model, best first; models with missing scores come last.

    Columns of all models: `model`, `mark`, `median` error in the metric's unit, `n tasks`,
    `complete`, `ratio` (geometric mean of error / VJM's error over robots), `smallest` and
    `largest` ratio of a task, `fit_s`. With enough robots of one kind also: `low` and `high` of the
    ratio's interval, `p` against the VJM, and of complete models `verdict`, `won` (robots with the
    smallest ratio), `n robots`, `worst`, `worst robot`, `p best`, `like best` (within 5 %),
    `without low` and `without high` (range without any one robot), `p95`, `noise` and `path`. Keys
    (`few`, heading), (`group`, name), (`measured`, data set) and (`measured verdict`, data set)
    hold further ratios.

    Args:
        scores: scores on the robots.
        few: scores with fewer poses on the same robots, by heading.
        groups: data sets with a separate column, by its name.
    """
    from pandas import DataFrame, Index  # slow, and a single task needs no frame

    rows = scores.rows
    by_model = scores.frame.groupby("model")
    table = DataFrame(index=Index(scores.models, name="model"))
    table["mark"] = [scores.mark(name) for name in table.index]
    table["median"], table["n tasks"] = by_model["error"].median(), by_model.size()
    ratios = by_model["error ratio"]
    table["smallest"], table["largest"] = ratios.min(), ratios.max()
    logs = robot_logs(rows, "error ratio", partial=True)
    table["ratio"] = logs.apply(_mean).map(math.exp)
    table["complete"] = table["n tasks"] == len(scores.tasks)
    tasks = rows["task"].unique()
    table["fit_s"] = [scores.fit_s(name, tasks) for name in table.index]
    if scores.claim is not None:
        table = _with_robots(table, scores, logs, few or {}, groups or {})
    order = table["ratio"].fillna(scores.key.sign * table["median"])
    table = table.assign(order=order, incomplete=~table["complete"]).reset_index()
    return table.sort_values(["incomplete", "order", "model"]).drop(columns=["order", "incomplete"])


def _with_robots(
    table: DataFrame,
    scores: Scores,
    partial_logs: DataFrame,
    few: Mapping[str, Scores],
    groups: Mapping[str, Collection[str]],
) -> DataFrame:
    """Add the columns over robots."""
    from pandas import Series  # slow, and a single task needs no frame

    rows = scores.rows
    for name, column in partial_logs.items():
        if column.count() >= 2:
            mean = mean_ratio(column.dropna())
            table.loc[name, ["low", "high"]] = mean.low, mean.high
    logs = complete_logs(scores)
    table["complete"] |= table.index.isin(logs.columns)
    if logs.empty:
        return table
    best = logs.mean().idxmin()
    table["n robots"] = len(logs)
    table["won"] = logs.idxmin(axis="columns").value_counts().reindex(logs.columns).fillna(0)
    table["worst"], table["worst robot"] = logs.max().map(math.exp), logs.idxmax()
    left_out = logs.apply(without_one)
    table["without low"], table["without high"] = left_out.min(), left_out.max()
    table["p"] = _p_values(logs, REFERENCE_MODEL)
    table["p best"] = _p_values(logs, best)
    table["like best"] = Series(
        {m: equivalence_p_value(logs[m] - logs[best]) < LEVEL for m in logs if m != best}
    )
    better = np.where(table["ratio"] < 1.0, "better", "worse")
    table["verdict"] = np.where(table["p"] < LEVEL, better, "open")
    further: dict[Any, DataFrame] = {
        name: robot_logs(rows, f"{name} ratio") for name in ("p95", "noise", "path")
    }
    for heading, of_few in few.items():
        further["few", heading] = robot_logs(of_few.rows, "error ratio")
    for group, datasets in groups.items():
        of_group = rows[rows["dataset"].isin(datasets)]
        further["group", group] = robot_logs(of_group, "error ratio")
    for key, of_robots in further.items():
        table[key] = of_robots.mean(skipna=False).map(math.exp)
    for dataset, tasks in scores.measured.items() if scores.claim != "measured" else ():
        of_data = scores.frame[scores.frame["task"].isin(tasks)]
        complete = of_data.groupby("model").size() == len(tasks)
        values = robot_logs(of_data, "error ratio").mean().map(math.exp)
        table["measured", dataset] = values.where(complete)
        verdicts = {name: {task.verdict(name) for task in tasks} for name in table.index}
        table["measured verdict", dataset] = Series(
            {name: of.pop() if len(of) == 1 else "open" for name, of in verdicts.items()}
        )
    return table


def _p_values(logs: DataFrame, rival: object) -> Series[float]:
    """Return sign-flip p-values against a model, corrected (Holm) for all models."""
    from pandas import Series  # slow, and a single task needs no frame

    differences = {str(name): logs[name] - logs[rival] for name in logs if name != rival}
    return Series(corrected_p_values(differences), dtype=float)


def complete_logs(scores: Scores) -> DataFrame:
    """Return (robots, models) logarithms of error / VJM's error, of models with every score."""
    return robot_logs(scores.rows, "error ratio").dropna(axis="columns")


def control_rows(scores: Scores, pairs: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return learned models against their physics model or teacher.

    Keys: `model`, `control`, `ratio`, `low`, `high`, `p` (corrected for all pairs), `equal` (within
    5 %). Pairs without every score are left out.
    """
    logs = complete_logs(scores)
    differences = {a: logs[a] - logs[b] for a, b in pairs.items() if a in logs and b in logs}
    p_values = corrected_p_values(differences)
    return [
        {
            **{"model": name, "control": pairs[name], "p": p_values[name]},
            **{"equal": equivalence_p_value(values) < LEVEL, **asdict(mean_ratio(values))},
        }
        for name, values in differences.items()
    ]


@dataclass(frozen=True)
class Leaderboard:
    """Scores of tasks that fit in one table.

    Attributes:
        scores: scores of the fairest protocols.
        notes: notes on results that do not count.
        provenance: versions of stiffbench that made the results.
    """

    scores: Scores
    notes: tuple[str, ...]
    provenance: str


def merge_training_seeds(stored: StoredResults) -> StoredResults:
    """Return results in which the repeats of a model's training have one name.

    The pre-training seed leaves the model's name, unless a task has several seeds of the model.
    """
    repeated = {
        base
        for task in stored.tasks
        for base, names in grouped(task.models, _without_seed).items()
        if len(names) > 1
    }

    def renamed(result: CellResult) -> CellResult:
        name = _without_seed(result.presentation.model)
        if name in repeated:
            return result
        return replace(result, presentation=replace(result.presentation, model=name))

    return StoredResults.of_results(stored.folder, [*map(renamed, stored.every)])


def _without_seed(model: str) -> str:
    return without_options(model, *SEED_OPTIONS)


def build_leaderboard(
    stored: StoredResults, key: SortKey, selection: Selection = EVERYTHING, *, seed: int = 0
) -> Leaderboard:
    """Score the selected models, and the VJM, in every task of at least two of them.

    Raises:
        ConfigError: a name has no results, no task has two models, or no model has a score.
        StoreError: samples are corrupt, or two models share no split.
    """
    stored = merge_training_seeds(stored)
    tasks = selection.tasks_of(stored.tasks)
    newest = newest_tasks(tasks)
    names = selection.models_of([t for t in newest if not t.presentation.reports_training])

    def reason(task: Task) -> str:
        if task.presentation.reports_training:
            return TRAINING_MARK
        n_models = sum(name in task.models for name in names)
        return "" if n_models > 1 else f"{('none', 'one')[n_models]} of the models was run there"

    by_reason = grouped(newest, reason)
    comparable = by_reason.pop("", [])
    outcome = "they are never compared; only the data of the newest run count"
    notes = [
        *same_name_other_data(tasks, stored.data_of, outcome),
        *left_out_notes(tasks),
        *(f"Left out ({why}): {_places(of_reason)}." for why, of_reason in by_reason.items()),
    ]
    if not comparable:
        reasons = "".join(f"; {note.removesuffix('.')}" for note in notes)
        raise ConfigError(
            "there is nothing to compare: no two models have results on the same data, "
            f"protocol and condition (models with results: {', '.join(names) or 'none'}){reasons}"
        )
    scores = Scores.of(stored, key, comparable, names, seed)
    scored = {task.name for task in scores.tasks}
    if without := [task for task in comparable if task.name not in scored]:
        notes.append(f"Left out ({SELECTION_MARK}, or no model has a score): {_places(without)}.")
    results = (of_model for task in scores.tasks for of_model in task.results.values())
    counts = Counter(result.run_id for of_model in results for result in of_model)
    return Leaderboard(scores, tuple(notes), sources(stored.folder, stored.runs, counts))


def _places(tasks: Sequence[Task]) -> str:
    return first_few([*labels(task.name for task in tasks).values()])
