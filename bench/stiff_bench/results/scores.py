"""Frames of results: a row per fit, and a row per task and model."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.results.fit_values import metric_lines
from stiff_bench.results.load import StoredResults, Task, newest_tasks
from stiff_bench.results.notes import mark_of
from stiff_bench.results.scored_task import ScoredTask, SortKey, family_of, score_task
from stiff_bench.store.names import TaskName, grouped
from stiff_bench.tables.units import MM, PRINTED
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import CellResult, Cost
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.metrics import METRICS

if TYPE_CHECKING:
    from pandas import DataFrame

FEWEST_ROBOTS = 5
"""Smallest number of robots with an interval over them."""


def identity_of(result: CellResult) -> dict[str, Any]:
    """Return the columns that identify a fit in a frame."""
    cell, texts = result.cell, result.presentation
    return {
        "model": texts.model,
        "dataset": texts.dataset,
        "kind": texts.kind,
        "protocol": texts.protocol,
        "condition": cell.condition,
        "seed": cell.seed,
        "split": cell.split_index,
        "model_version": cell.model_version,
        "data_sha256": cell.data_sha256,
        "run": result.run_id,
    }


def fit_frame(results: Iterable[CellResult], robot_of: Callable[[str], str]) -> DataFrame:
    """Return a row per fit: identity, status, all metrics and costs in printed units.

    The unit ends the name of a column: `norm_mm`, `mae_x_mm`, `removed_percent`, `fit_time_ms`.

    Args:
        results: fits; a failed one has its reason and no values.
        robot_of: function that returns the robot's name for the hash of a data set.
    """
    from pandas import DataFrame  # slow, and a single task needs no frame

    columns = {
        (item.key, axis): "_".join(filter(None, (item.key.replace("-", "_"), axis, unit)))
        for item in METRICS.values()
        for unit in [_UNIT_WORDS.get(PRINTED[item.unit][0], PRINTED[item.unit][0])]
        for axis in item.axes
    }
    rows = []
    for result in results:
        lines = [] if result.prediction is None else metric_lines(result.prediction, result.cost)
        values = {columns[str(line["metric"]), str(line["axis"])]: line["value"] for line in lines}
        row = identity_of(result) | {"robot": robot_of(result.cell.data_sha256)}
        rows.append({**row, "status": result.status, "failure": result.failure, **values})
    return DataFrame(rows)


_UNIT_WORDS = {"%": "percent", "1/s": "per_s"}
"""Units as parts of a column's name."""


def prediction_frame(results: Iterable[CellResult]) -> DataFrame:
    """Return a row per test sample: identity, row, measured and predicted deflection, mm."""
    from pandas import DataFrame, concat  # slow, and a single task needs no frame

    parts = []
    for result in results:
        if (prediction := result.prediction) is None:
            continue
        arrays = {"": prediction.measured, "_predicted": prediction.predicted}
        columns = {
            f"d{axis}{name}_mm": MM * array[:, number]
            for name, array in arrays.items()
            for number, axis in enumerate(AXES)
        }
        parts.append(DataFrame({**identity_of(result), "row": prediction.rows, **columns}))
    return concat(parts, ignore_index=True) if parts else DataFrame()


@dataclass(frozen=True, eq=False, repr=False)
class Scores(BriefFields):
    """Scores of models in several tasks, each next to the VJM's.

    Attributes:
        key: metric of the scores.
        tasks: tasks, measured data first, then in the order in which runs requested them.
        left_out: reasons why tasks do not count, by their name.
        seed: seed of the draws of poses.
    """

    key: SortKey
    tasks: tuple[ScoredTask, ...]
    left_out: Mapping[str, str]
    seed: int = 0

    @classmethod
    def of(
        cls,
        stored: StoredResults,
        key: SortKey,
        tasks: Sequence[Task] | None = None,
        models: Collection[str] | None = None,
        *,
        seed: int = 0,
    ) -> Scores:
        """Score models in stored results.

        Results that select on the test part or report training errors count only without
        other results.

        Args:
            stored: results with their samples.
            key: metric to score by.
            tasks: tasks to score; None: all of `stored`.
            models: exact names of models to score; None: all.
            seed: seed of the draws of poses.

        Raises:
            ConfigError: no model has a score.
            StoreError: samples are corrupt, or two models share no split.
        """
        newest = newest_tasks(stored.tasks if tasks is None else tasks)
        fair = [task for task in newest if not task.presentation.reports_training]
        fair = [task for task in fair if not task.presentation.selects_on_test] or fair or newest
        left_out = {
            task.name.text: "selects on the test part or reports training samples"
            for task in newest
            if task not in fair
        }
        request_order = {id(task): number for number, task in enumerate(stored.tasks)}
        fair.sort(key=lambda task: (task.presentation.kind != "measured", request_order[id(task)]))
        chosen = None if models is None else {*models, REFERENCE_MODEL}
        scored = [
            score_task(
                task,
                [name for name in task.models if chosen is None or name in chosen],
                *(key, stored.data_of(task.name.data_sha256), seed),
            )
            for task in fair
        ]
        with_scores = tuple(task for task in scored if task.scores)
        if not with_scores:
            raise ConfigError(f"no model has a score of {key.text}")
        return cls(key, with_scores, left_out, seed)

    def over(self, tasks: Sequence[ScoredTask]) -> Scores:
        """Return the scores in some of the tasks."""
        return replace(self, tasks=tuple(tasks))

    @cached_property
    def models(self) -> tuple[str, ...]:
        """Return the models with a score."""
        return tuple(dict.fromkeys(name for task in self.tasks for name in task.scores))

    @cached_property
    def frame(self) -> DataFrame:
        """Return a row per task and ranked model; see `ScoredTask.rows`."""
        from pandas import DataFrame  # slow, and a single task needs no frame

        return DataFrame([row for task in self.tasks for row in task.rows()])

    @property
    def selects_on_test(self) -> bool:
        """Return True if the protocols let models pick the epoch on the test part."""
        return self.tasks[0].task.presentation.selects_on_test

    @property
    def missing(self) -> dict[str, dict[TaskName, str]]:
        """Return reasons for missing scores, by model and task, of models that were run."""
        names = dict.fromkeys(name for task in self.tasks for name in task.missing)
        run = {name for name in names if any(name in task.task.models for task in self.tasks)}
        return {
            name: {task.name: task.missing[name] for task in self.tasks if name in task.missing}
            for name in names
            if name in run
        }

    @cached_property
    def robots(self) -> dict[str, list[ScoredTask]]:
        """Return tasks by robot type; specimens and plans of a type are one robot."""
        return grouped(self.tasks, lambda task: task.data.robot.name)

    @cached_property
    def datasets(self) -> dict[str, list[ScoredTask]]:
        """Return tasks by data set without its specimen."""
        return grouped(self.tasks, lambda task: family_of(task.name))

    @cached_property
    def columns(self) -> dict[tuple[str, str, str], list[ScoredTask]]:
        """Return tasks by data set, protocol and condition: specimens and seeds together."""
        by_heading = grouped(
            self.tasks, lambda task: (family_of(task.name), task.name.protocol, task.name.condition)
        )
        order = list(self.datasets)
        return dict(sorted(by_heading.items(), key=lambda item: order.index(item[0][0])))

    @property
    def measured(self) -> dict[str, list[ScoredTask]]:
        """Return tasks by measured data set."""
        return {name: of for name, of in self.datasets.items() if of[0].kind == "measured"}

    @cached_property
    def claim(self) -> tuple[str, DataFrame] | None:
        """Return kind and rows of the robots of a claim: the measured ones if there are enough.

        Measured and simulated robots are never averaged. None: fewer than `FEWEST_ROBOTS` of each
        kind.
        """
        for kind in dict.fromkeys(["measured", "simulated", *self.frame["kind"]]):
            rows = self.frame[self.frame["kind"] == kind]
            if rows["robot"].nunique() >= FEWEST_ROBOTS:
                return kind, rows
        return None

    @property
    def scope(self) -> str:
        """Return number and kind of the robots of a claim, such as "12 simulated robots"."""
        if self.claim is None:
            return ""
        kind, rows = self.claim
        return f"{rows['robot'].nunique()} {kind} robots"

    def noise(self, tasks: Sequence[ScoredTask]) -> float:
        """Return the mean noise floor of tasks, in the metric's unit; NaN: unknown."""
        rows = self.frame[self.frame["task"].isin(tasks)].drop_duplicates("task")
        return float(np.mean(rows["noise"].to_numpy()))

    def mark(self, model: str, protocol: str = "") -> str:
        """Return the text printed next to a model's name, for one protocol or all."""
        marks = [
            mark_of(task.task.models[model].presentation)
            for task in self.tasks
            if protocol in ("", task.name.protocol) and model in task.task.models
        ]
        return ", ".join(filter(None, dict.fromkeys(marks)))

    def costs(self, model: str) -> list[Cost]:
        """Return the recorded costs of a model's scored fits."""
        results = (result for task in self.tasks for result in task.results.get(model, ()))
        return [result.cost for result in results if result.cost is not None]

    def fit_s(self, model: str, tasks: Iterable[ScoredTask]) -> float:
        """Return the median fit time of a model in tasks, s; NaN: not recorded."""
        costs = [result.cost for task in tasks for result in task.results.get(model, ())]
        times = [cost.fit_s for cost in costs if cost is not None]
        return float(np.median(times)) if times else math.nan
