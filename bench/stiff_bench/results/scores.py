"""Frames of results: a row per fit, and a row per task and model."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from stiff_bench.results.load import StoredResults, Task, model_names, newest_tasks
from stiff_bench.results.notes import mark_of
from stiff_bench.results.scored_task import ScoredTask, SortKey, family_of, score_task
from stiff_bench.store.names import grouped
from stiff_bench.tables.units import MM, PRINTED
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.record import CellResult
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


UNIT_WORDS = {"%": "percent", "1/s": "per_s"}
"""Units as parts of a column's name."""


def fit_frame(results: Iterable[CellResult], robot_of: Callable[[str], str]) -> DataFrame:
    """Return a row per fit: identity, status, all metrics and costs in printed units.

    The unit ends the name of a column: `norm_mm`, `mae_x_mm`, `removed_percent`, `fit_time_ms`.

    Args:
        results: fits; a failed one has its reason and no values.
        robot_of: function that returns the robot's name for the hash of a data set.
    """
    from pandas import DataFrame  # slow, and a single task needs no frame

    rows = []
    for result in results:
        row = identity_of(result) | {"robot": robot_of(result.cell.data_sha256)}
        row |= {"status": result.status, "failure": result.failure}
        for item in METRICS.values():
            unit, factor = PRINTED[item.unit]
            for axis, value in item.of_result(result).items():
                words = (item.key.replace("-", "_"), axis, UNIT_WORDS.get(unit, unit))
                row["_".join(filter(None, words))] = factor * value
        rows.append(row)
    return DataFrame(rows)


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

        Args:
            stored: results with their samples.
            key: metric to score by.
            tasks: tasks to score, if they are on a data set's newest data.
            models: exact names of models to score, in addition to the VJM; None: all.
            seed: seed of the draws of poses.

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
        run = {name for task in self.tasks for name in task.task.models}
        names = dict.fromkeys(name for task in self.tasks for name in task.missing)
        return {
            name: [task.missing[name] for task in self.tasks if name in task.missing]
            for name in names
            if name in run
        }

    @property
    def run_models(self) -> list[str]:
        """Return the models with a score, then those without one that were run."""
        return list(dict.fromkeys([*self.models, *self.missing]))

    @cached_property
    def frame(self) -> DataFrame:
        """Return a row per task and ranked model, with ratios to the VJM's numbers.

        Columns of `ScoredTask.rows`, and `p95 ratio`, `path ratio` and `noise ratio` (error over
        noise); NaN: a number is missing.
        """
        from pandas import DataFrame  # slow, and a single task needs no frame

        frame = DataFrame([row for task in self.tasks for row in task.rows()])
        of_vjm = frame[frame["model"] == REFERENCE_MODEL].set_index("task")
        for name in ("p95", "path"):
            reference = frame["task"].map(of_vjm[name])
            frame[f"{name} ratio"] = frame[name] / reference.where(reference > 0.0)
        frame["noise ratio"] = frame["error"] / frame["noise"].where(frame["noise"] > 0.0)
        return frame

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
        n_robots = self.frame.groupby("kind", sort=False)["robot"].nunique().to_dict()
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

    def mark(self, model: str) -> str:
        """Return the text printed next to a model's name."""
        models = (task.task.models.get(model) for task in self.tasks)
        marks = (mark_of(stored.presentation) for stored in models if stored is not None)
        return ", ".join(filter(None, dict.fromkeys(marks)))

    def fit_s(self, model: str, tasks: Iterable[ScoredTask]) -> float:
        """Return the median fit time of a model in tasks, s; NaN: not recorded."""
        results = (result for task in tasks for result in task.results.get(model, ()))
        times = [result.cost.fit_s for result in results if result.cost is not None]
        return float(np.median(times)) if times else math.nan
