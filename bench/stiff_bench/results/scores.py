"""Scores of models in several tasks, and models over robots.

The main number of a model is its error over the VJM's: the geometric mean over robots, and for each
robot over its data sets with equal weights. Measured robots have separate columns and are never
averaged with simulated robots.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import chain, product
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.results.load import StoredResults, Task, model_names, newest_tasks
from stiff_bench.results.notes import mark_of
from stiff_bench.results.scored_task import READINGS, ScoredTask, SortKey, family_of, score_task
from stiff_bench.store.names import grouped
from stiff_models.model_catalog import REFERENCE_MODEL, is_spring_model
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.scoring.over_robots import (
    MeanRatio,
    corrected_p_values,
    equivalence_p_value,
    mean_ratio,
    without_one,
)
from stiff_protocols.scoring.paired import LEVEL

if TYPE_CHECKING:
    from pandas import DataFrame

FEWEST_ROBOTS = 5
"""Smallest number of robots with an interval over them."""
VOTE = ["robot", "vote"]
"""Columns of a vote: each world of a simulated robot has the same weight, and so has each data set
and protocol without a world."""
PLAN = [*VOTE, "family", "protocol"]
"""Columns of a data set and protocol, which have the same weight in a world."""
RATIO_ENDS = ("ratio", "low", "high")
"""Fields of a `MeanRatio` in a frame."""
NO_RATIO = MeanRatio(math.nan, math.nan, math.nan, 0)
CLEAN = "clean"
"""World of simulated robots in which no real robot lives; a further score leaves it out."""


@dataclass(frozen=True, eq=False, repr=False)
class Scores(BriefFields):
    """Scores of models in several tasks, each next to the VJM's.

    Attributes:
        key: metric of the scores.
        tasks: tasks, measured data first.
    """

    key: SortKey
    tasks: tuple[ScoredTask, ...]

    @classmethod
    def of(
        cls,
        stored: StoredResults,
        key: SortKey,
        tasks: Sequence[Task],
        models: Collection[str] | None = None,
        seed: int = 0,
    ) -> Scores:
        """Score models in the fairest tasks; measured data come first, then the order of requests.

        Results that select on the test part or report training errors count only without
        other results, and tasks only if a model has a score.

        Only tasks on a data set's newest data count. `models` has exact names to score, in
        addition to the VJM; None: all. `seed` is for the draws of poses.

        Raises:
            ConfigError: no model has a score.
            StoreError: samples are corrupt, or two models share no split.
        """
        newest = sorted(newest_tasks(tasks), key=lambda task: (task.first_requested, task.name))
        by_fairness = grouped(
            newest, lambda t: (t.presentation.reports_training, t.presentation.selects_on_test)
        )
        fairest = by_fairness[min(by_fairness)] if by_fairness else []
        names = model_names(fairest)
        if models is not None:
            names = [name for name in names if name in {*models, REFERENCE_MODEL}]
        scored = [
            score_task(task, names, key, stored.data_of(task.name.data_sha256), seed)
            for task in fairest
        ]
        with_scores = [task for task in scored if task.scores]
        if not with_scores:
            raise ConfigError(f"no model has a score of {key.text}")
        return cls(key, tuple(sorted(with_scores, key=lambda task: task.kind != "measured")))

    def over(self, tasks: Sequence[ScoredTask]) -> Scores:
        """Return the scores in some of the tasks."""
        return replace(self, tasks=tuple(tasks))

    @cached_property
    def models(self) -> tuple[str, ...]:
        """Return the models with a score."""
        return tuple(dict.fromkeys(name for task in self.tasks for name in task.scores))

    @property
    def missing(self) -> dict[str, list[str]]:
        """Return reasons for missing scores, one per task, of models that were run."""
        reasons = {
            name: [task.missing[name] for task in self.tasks if name in task.missing]
            for name in model_names(task.task for task in self.tasks)
        }
        return {name: of_model for name, of_model in reasons.items() if of_model}

    @cached_property
    def frame(self) -> DataFrame:
        """Return a row per task and ranked model, with ratios to the VJM's numbers.

        Columns of `ScoredTask.rows`, `vote`, and `p95 ratio`, `path ratio`, `readings ratio` and
        `noise ratio` (error over noise) and `oracle ratio` (the oracle's error over the VJM's, both
        against readings); NaN: a number is missing.
        """
        from pandas import DataFrame  # slow, and a single task needs no frame

        frame = DataFrame([row for task in self.tasks for row in task.rows()])
        of_vjm = frame[frame["model"] == REFERENCE_MODEL].set_index("task")
        for name in ("p95", "path", "readings"):
            reference = frame["task"].map(of_vjm[name])
            frame[f"{name} ratio"] = frame[name] / reference.where(reference > 0.0)
        frame["oracle ratio"] = frame["oracle"] / frame["task"].map(of_vjm["readings"])
        frame["noise ratio"] = frame["error"] / frame["noise"].where(frame["noise"] > 0.0)
        of_data = frame["family"] + " " + frame["protocol"]
        frame["vote"] = frame["world"].astype(object).fillna(of_data)
        return frame

    @cached_property
    def datasets(self) -> dict[str, list[ScoredTask]]:
        """Return tasks by data set without its specimen."""
        return grouped(self.tasks, lambda task: family_of(task.name))

    @cached_property
    def columns(self) -> dict[tuple[str, str, str], list[ScoredTask]]:
        """Return tasks by data set, protocol and condition: specimens and seeds together."""
        by_dataset = chain.from_iterable(self.datasets.values())
        return grouped(
            by_dataset, lambda task: (family_of(task.name), task.name.protocol, task.name.condition)
        )

    @property
    def measured(self) -> dict[str, list[ScoredTask]]:
        """Return tasks by measured data set."""
        return {name: of for name, of in self.datasets.items() if of[0].kind == "measured"}

    @cached_property
    def claim(self) -> str | None:
        """Return the kind of the robots of a claim: the measured ones if there are enough.

        Measured and simulated robots are never averaged. None: fewer than `FEWEST_ROBOTS` of each
        kind.
        """
        n_robots: dict[Any, int] = self.frame.groupby("kind")["robot"].nunique().to_dict()
        kinds = dict.fromkeys(["measured", "simulated", *n_robots])
        return next((kind for kind in kinds if n_robots.get(kind, 0) >= FEWEST_ROBOTS), None)

    @cached_property
    def rows(self) -> DataFrame:
        """Return the rows of `frame` on the robots of the claim; all if there is none."""
        return self.frame if self.claim is None else self.frame[self.frame["kind"] == self.claim]

    @property
    def scope(self) -> str:
        """Return number and kind of the robots of a claim, such as "12 simulated robots"."""
        return f"{self.rows['robot'].nunique()} {self.claim} robots" if self.claim else ""

    def verdict_counts(self, model: str) -> Counter[str]:
        """Return the numbers of tasks by verdict on a model ("a") and the VJM ("b")."""
        return Counter(verdict for task in self.tasks if (verdict := task.verdict(model)))

    @cached_property
    def copies(self) -> dict[str, str]:
        """Return the models that add nothing to a spring model in any task; see `ScoredTask`."""
        marks = {
            model: {task.copies.get(model, "") for task in self.tasks if model in task.scores}
            for model in dict.fromkeys(name for task in self.tasks for name in task.copies)
        }
        return {
            model: of_model.pop() if len(of_model) == 1 else "= its teacher"
            for model, of_model in marks.items()
            if "" not in of_model
        }

    def mark(self, model: str) -> str:
        """Return the text printed next to a model's name."""
        models = (task.task.models.get(model) for task in self.tasks)
        marks = [mark_of(stored.presentation) for stored in models if stored is not None]
        return ", ".join(filter(None, dict.fromkeys([*marks, self.copies.get(model, "")])))


# models over robots


def robot_logs(rows: DataFrame, value: str, *, partial: bool = False) -> DataFrame:
    """Return (robots, models) mean logarithms of a ratio, with one vote per world of a robot.

    An error and the VJM's are means over the same splits: those that all models of a task have.
    `rows` are of `Scores.frame`, `value` is the ratio's column. With `partial` the plans that a
    model has are averaged; else its mean is NaN if one is missing.
    """
    logs = rows.assign(log=np.log(rows[value].where(rows[value] > 0.0)))
    votes = logs.groupby([*PLAN, "model"], sort=False)["log"]
    means = _group_means(logs.set_index([*PLAN, "model"])[["log"]], [*PLAN, "model"])["log"]
    by_plan = means if partial else means.where(votes.count() == votes.size())
    plans = rows.set_index(PLAN).index.unique()
    table = by_plan.unstack("model").reindex(index=plans, columns=rows["model"].unique())
    robots = table.groupby("robot", sort=False)
    by_robot = _group_means(_group_means(table, VOTE), "robot")
    return by_robot if partial else by_robot.where(robots.count().eq(robots.size(), axis="index"))


def _group_means(table: DataFrame, levels: str | list[str]) -> DataFrame:
    """Return the `_mean` of each column over the rows with the same levels of the index."""
    from pandas import DataFrame  # slow, and a single task needs no frame

    groups, values = table.groupby(levels, sort=False), table.to_numpy()
    index = groups.size().index  # `groups.agg(_mean)` takes 50 times longer
    means = [[_mean(column) for column in values[groups.indices[key]].T] for key in index]
    return DataFrame(means, index=index, columns=table.columns, dtype=float)


def _mean(values: Any) -> float:
    """Return the mean without NaN; its rounding does not depend on the version of pandas."""
    present = np.asarray(values)[~np.isnan(values)]
    return float(np.mean(present)) if len(present) else math.nan


def ratio_frame(parts: Mapping[str, DataFrame]) -> DataFrame:
    """Return mean ratios over robots with their 95 % intervals, a row per model.

    Columns: (part, "ratio"), (part, "low"), (part, "high"); NaN: a score is missing.

    Args:
        parts: name -> (robots, models) logarithms of a ratio.
    """
    from pandas import DataFrame  # slow, and a single task needs no frame

    models = dict.fromkeys(str(model) for logs in parts.values() for model in logs)
    columns = dict[Any, dict[str, float]]()
    for name, logs in parts.items():
        complete = logs.dropna(axis="columns") if len(logs) > 1 else logs.iloc[:, :0]
        means = {m: mean_ratio(complete[m]) if m in complete else NO_RATIO for m in models}
        for key in RATIO_ENDS:
            columns[name, key] = {model: getattr(mean, key) for model, mean in means.items()}
    frame = DataFrame(columns, index=[*models])
    frame.columns = frame.columns.to_flat_index()
    return frame


def model_frame(
    scores: Scores,
    few: Mapping[str, Scores] = MappingProxyType({}),
    measured: Scores | None = None,
) -> DataFrame:
    """Return a row per model, best first; models with missing scores come last.

    Columns of all models: `model`, `mark`, `median` error in the metric's unit, `n tasks`,
    `complete`, `ratio` (geometric mean of error / VJM's error over robots), `smallest` and
    `largest` ratio of a task, `fit_s`. With enough robots of one kind also: `low` and `high` of the
    ratio's interval, `p` against the VJM, and of complete models `verdict`, `won` (robots with the
    smallest ratio; ties count for none), `n robots`, `worst`, `worst robot`, `rival` (the best
    spring model), `p rival` and `verdict rival` against it, `like best` (within 5 % of the best),
    `without low` and `without high` (range without any one robot), `p95`, `noise`, `path` and, if
    the error is another one, `readings`. Further ratios have the keys (`few`, heading), (`world`,
    name) with (`world low`, name) and (`world high`, name), (`oracle`, world), (`coverage`, world
    or heading) of the model's intervals, `without clean`, (`measured`, data set) and (`measured
    verdict`, data set). `few` has scores with fewer poses on the same robots, by heading;
    `measured` has the scores on exploratory measured data, without verdicts; None: `scores` has
    measured data.
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
    fits = {
        name: [fit for task in tasks for fit in task.results.get(name, ())] for name in table.index
    }
    times = [[fit.cost.fit_s for fit in of_model if fit.cost] for of_model in fits.values()]
    table["fit_s"] = [float(np.median(of_model)) if of_model else math.nan for of_model in times]
    if scores.claim is not None:
        table = _with_robots(table, scores, logs, few)
        if scores.claim != "measured":
            table = _with_measured(table, measured or scores, has_verdicts=measured is None)
    order = table["ratio"].fillna(scores.key.sign * table["median"])
    table = table.assign(order=order, incomplete=~table["complete"]).reset_index()
    return table.sort_values(["incomplete", "order", "model"]).drop(columns=["order", "incomplete"])


def _with_robots(
    table: DataFrame,
    scores: Scores,
    partial_logs: DataFrame,
    few: Mapping[str, Scores],
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
    means = {str(name): float(column.mean()) for name, column in logs.items()}
    best = min(means, key=means.__getitem__)
    rival = min(filter(is_spring_model, means), key=means.__getitem__)
    table["n robots"], table["rival"] = len(logs), rival
    originals = logs.drop(columns=[*scores.copies], errors="ignore")
    smallest = originals.sub(originals.min(axis="columns"), axis="index") < 1e-9  # of equal size
    alone = smallest[smallest.sum(axis="columns") == 1]
    table["won"] = alone.sum().reindex(logs.columns).fillna(0)
    table["worst"], table["worst robot"] = logs.max().map(math.exp), logs.idxmax()
    table.loc[REFERENCE_MODEL, "worst"] = math.nan
    left_out = logs.apply(without_one)
    table["without low"], table["without high"] = left_out.min(), left_out.max()
    table["like best"] = Series(
        {m: equivalence_p_value(logs[m] - logs[best]) < LEVEL for m in means if m != best}
    )
    for reference, suffix in ((REFERENCE_MODEL, ""), (rival, " rival")):
        differences = {m: logs[m] - logs[reference] for m in means if m != reference}
        p_values = corrected_p_values(differences)
        verdicts = {reference: "baseline"}
        for name, p_value in p_values.items():
            better = "better" if means[name] < means[reference] else "worse"
            verdicts[name] = better if p_value < LEVEL else "open"
        table[f"p{suffix}"], table[f"verdict{suffix}"] = Series(p_values), Series(verdicts)
    names = ["p95", "noise", "path"] + ["readings"] * (scores.key != READINGS)
    further: dict[Any, DataFrame] = {name: robot_logs(rows, f"{name} ratio") for name in names}
    for heading, of_few in few.items():
        further["few", heading] = robot_logs(of_few.rows, "error ratio")
    worlds = [*rows["world"].dropna().unique()]
    if len(worlds) < 2:
        worlds = []
    for world in worlds:
        of_world = rows[rows["world"] == world]
        further["world", world] = robot_logs(of_world, "error ratio")
        further["oracle", world] = robot_logs(of_world, "oracle ratio")
    intervals = ratio_frame({world: further["world", world] for world in worlds})
    for world, end in product(worlds, ("low", "high")):
        table[f"world {end}", world] = intervals[world, end]
    if worlds:
        coverage = rows.groupby(["model", "world"], sort=False)["coverage"].mean().unstack()
        for name, of_few in few.items():
            by_world = of_few.rows.groupby(["model", "world"])["coverage"].mean().unstack()
            coverage[name] = by_world.mean(axis="columns", skipna=False)
        for name, column in coverage.items():
            table["coverage", name] = column
    if CLEAN in worlds:
        further["without clean"] = robot_logs(rows[rows["world"] != CLEAN], "error ratio")
    for key, of_robots in further.items():
        table[key] = of_robots.mean(skipna=False).map(math.exp)
    return table


def _with_measured(table: DataFrame, scores: Scores, *, has_verdicts: bool) -> DataFrame:
    """Add ratios and, unless the data are exploratory, verdicts on each measured data set."""
    from pandas import Series  # slow, and a single task needs no frame

    for dataset, tasks in scores.measured.items():
        of_data = scores.frame[scores.frame["task"].isin(tasks)]
        complete = of_data.groupby("model").size() == len(tasks)
        values = robot_logs(of_data, "error ratio").mean().map(math.exp)
        table["measured", dataset] = values.where(complete)
        if not has_verdicts:
            continue
        verdicts = {name: {task.verdict(name) for task in tasks} for name in table.index}
        table["measured verdict", dataset] = Series(
            {name: of.pop() if len(of) == 1 else "open" for name, of in verdicts.items()}
        )
    return table


def complete_logs(scores: Scores) -> DataFrame:
    """Return (robots, models) logarithms of error / VJM's error, of models with every score."""
    return robot_logs(scores.rows, "error ratio").dropna(axis="columns")


def control_rows(scores: Scores, pairs: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return learned models against their physics model or teacher.

    Keys: `model`, `control`, `ratio`, `low`, `high`, `equal` (within 5 %). Pairs without every
    score are left out.
    """
    logs = complete_logs(scores)
    differences = {a: logs[a] - logs[b] for a, b in pairs.items() if a in logs and b in logs}
    return [
        {
            **{"model": name, "control": pairs[name], **asdict(mean_ratio(values))},
            "equal": equivalence_p_value(values) < LEVEL,
        }
        for name, values in differences.items()
    ]
