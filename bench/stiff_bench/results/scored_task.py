"""Score the models of a task, and compare pairs of them.

Leaderboard and report page take verdicts from `ScoredTask.verdict`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from stiff_bench.results.fit_values import bound_results, pooled_prediction, values_of_splits
from stiff_bench.results.load import ModelResults, SplitId, Task
from stiff_bench.results.notes import mark_of
from stiff_bench.results.significance import (
    Estimate,
    Question,
    SharedErrors,
    Verdict,
    corrected_p_values,
    decide_pairs,
    estimates,
)
from stiff_bench.store.names import TaskName, without_options
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.units import PRINTED
from stiff_models.model_catalog import REFERENCE_MODEL, is_spring_model
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import ConfigError, DataError, StoreError
from stiff_protocols.contract.record import PATH_ERROR, TEACHER_EPOCHS, FitResult
from stiff_protocols.contract.types import AXES, BOUND_NAMES, FloatArray, Prediction
from stiff_protocols.scoring.bootstrap import pose_errors
from stiff_protocols.scoring.metrics import (
    METRICS,
    Metric,
    absolute_errors,
    metric,
    norm_errors,
    reading_errors,
    true_errors,
)
from stiff_protocols.scoring.paired import ROPE_M

NOISE_FLOOR = BOUND_NAMES["noise"]
SAME_PREDICTION = 1e-12
"""m; a larger difference is not by rounding."""
SEED, SPECIMEN = "seed", "specimen"
"""Options of data sets for a repeat with new noise, and for another robot of the same type."""
_ROW_ERRORS: dict[str, Callable[[Prediction], FloatArray | None]] = {
    "mae": absolute_errors,
    "norm": norm_errors,
    "reading": reading_errors,
    "true-norm": true_errors,
}
"""Row errors by metric, for metrics that are means over rows: their poses can be resampled."""


@dataclass(frozen=True)
class SortKey:
    """A metric on one axis, or its mean over all of its axes.

    Attributes:
        metric: metric with a better direction (smaller or larger).
        axis: "x", "y" or "z"; "": the mean of the metric's axes.
    """

    metric: Metric
    axis: str = ""

    @property
    def text(self) -> str:
        """Return metric, axis and unit as one line."""
        of_axis = f" of {self.axis}" if self.axis else ""
        shown_unit = f" [{self.unit}]" if self.unit else ""
        over = f", mean over {', '.join(self._axes)}" if len(self._axes) > 1 else ""
        return f"{self.metric.label}{of_axis}{shown_unit}{over}"

    @property
    def unit(self) -> str:
        """Return the printed unit."""
        return PRINTED[self.metric.unit][0]

    @property
    def factor(self) -> float:
        """Return the factor from the metric's unit to the printed unit."""
        return PRINTED[self.metric.unit][1]

    @property
    def sign(self) -> float:
        """Return 1 if smaller values are better, -1 if larger values are."""
        return -1.0 if self.metric.direction == "larger" else 1.0

    @property
    def is_cost(self) -> bool:
        """Return True for time or memory; no statistical test applies to these."""
        return self.metric.of_cost is not None

    @property
    def _axes(self) -> tuple[str, ...]:
        return (self.axis,) if self.axis else self.metric.axes

    def of_splits(self, results: Sequence[FitResult]) -> FloatArray | None:
        """Return the (J,) values of a model's results on J splits, in the metric's unit.

        It is one value if the protocol scores the predictions of all splits together. None: a
        value is missing.
        """
        split_values = values_of_splits(self.metric, results)
        try:
            of_axes = [[values[axis] for values in split_values] for axis in self._axes]
        except KeyError:
            return None
        return np.asarray(np.mean(of_axes, axis=0))

    def of_rows(self, prediction: Prediction) -> FloatArray | None:
        """Return the (n,) errors, m, whose mean is the value; None: not a mean over rows."""
        if self.metric.key not in _ROW_ERRORS:
            return None
        if (errors := _ROW_ERRORS[self.metric.key](prediction)) is None:
            return None
        columns = [self.metric.axes.index(axis) for axis in self._axes]
        return np.asarray(errors.reshape(len(errors), -1)[:, columns].mean(axis=1))


def sort_key(key: str = "norm", axis: str | None = None) -> SortKey:
    """Return the sort key of a metric and an axis.

    Raises:
        ConfigError: the metric or axis is unknown, or the metric cannot rank models.
    """
    chosen_metric = metric(key)
    if chosen_metric.needs_interval:
        valid = ", ".join(m.key for m in METRICS.values() if not m.needs_interval)
        raise ConfigError(f"{key} does not rank models (valid: {valid})", "metric")
    if axis is not None and axis not in chosen_metric.axes:
        with_axes = ", ".join(m.key for m in METRICS.values() if m.axes == AXES)
        need = f"use {', '.join(AXES)} of a metric with axes ({with_axes})"
        raise ConfigError(f"{axis!r}: no axis of {key}; {need}", "axis")
    return SortKey(chosen_metric, axis or "")


READINGS, TRUE = sort_key("norm"), sort_key("true-norm")
"""Error against the tracker's readings, and against the truth."""
_P95, _TRUE_P95 = sort_key("norm-p95"), sort_key("true-p95")
_COVERAGE = SortKey(METRICS["coverage"])


def family_of(name: TaskName) -> str:
    """Return a data set's name without its seed and specimen."""
    return without_options(name.dataset, SEED, SPECIMEN)


@dataclass(frozen=True, eq=False, repr=False)
class ScoredTask(BriefFields):
    """A task with the scores of its ranked models.

    Attributes:
        task: stored results.
        key: metric that ranks the models.
        data: samples of the task's data set.
        seed: seed of the draws of poses.
        splits: splits that all ranked models have; only these count.
        results: results on these splits by ranked model, in order.
        scores: (J,) values on these splits by model, in the metric's unit; one value if the
            protocol scores all splits together.
        missing: reasons for a missing score, by model.
    """

    task: Task
    key: SortKey
    data: StoredData
    seed: int
    splits: tuple[SplitId, ...]
    results: Mapping[str, Sequence[FitResult]]
    scores: Mapping[str, FloatArray]
    missing: Mapping[str, str]

    @property
    def name(self) -> TaskName:
        """Return the name of the task."""
        return self.task.name

    @property
    def kind(self) -> str:
        """Return the kind of the data."""
        return self.task.presentation.kind

    @property
    def models(self) -> tuple[str, ...]:
        """Return the ranked models, sorted by name."""
        return tuple(sorted(self.scores))

    @cached_property
    def errors(self) -> SharedErrors:
        """Return the errors for the verdicts, with a column per model of `models`."""
        results = [self.results[model] for model in self.models]
        scores = [self.scores[model] for model in self.models]
        return shared_errors(self.key, results, scores, self.data, self.seed)

    @cached_property
    def _p_values(self) -> FloatArray | None:
        """Return (m, m) p-values of all pairs of `models`, corrected for all pairs."""
        return corrected_p_values(self.errors)

    def verdict(self, model: str, reference: str = REFERENCE_MODEL) -> Verdict | None:
        """Return the verdict on a model ("a") and a reference ("b"), corrected for all pairs.

        None: no test applies. Differences in m up to `ROPE_M` are ignored.
        """
        if model == reference or not {model, reference} <= self.scores.keys():
            return None
        if self.key.is_cost or (p_values := self._p_values) is None:
            return None
        pair = self.models.index(model), self.models.index(reference)
        question = Question(ROPE_M if self.key.metric.unit == "m" else 0.0)
        verdicts = decide_pairs(self.errors, [pair], question, [float(p_values[pair])])
        return None if verdicts is None else verdicts[0]

    def estimates(self, model: str, reference: str = REFERENCE_MODEL) -> list[Estimate]:
        """Return estimates of error(model) - error(reference), in the metric's unit.

        With several splits the first estimate is over splits; the last is over poses.
        """
        if self.key.is_cost or not {model, reference} <= self.scores.keys():
            return []
        pair = self.models.index(model), self.models.index(reference)
        return [
            estimate for (estimate,) in estimates(self.errors, [pair], Question(seed=self.seed))
        ]

    def bounds(self, name: str) -> list[FitResult]:
        """Return results of a bound (a name of `BOUND_NAMES`) on these splits; or none."""
        return bound_results(self.results.values(), name)

    def mean(self, model: str) -> float:
        """Return a model's mean over the splits, in the metric's unit."""
        return float(self.scores[model].mean())

    @cached_property
    def copies(self) -> dict[str, str]:
        """Return the models that add nothing to a spring model, such as "= vjm-full" by model.

        Their predictions are the spring model's, or no fit fine-tuned its teacher.
        """
        springs, copies = [*filter(is_spring_model, self.models)], dict[str, str]()
        for model in self.models:
            if model in springs:
                continue
            results = self.results[model]
            teachers = {s for s in springs if _are_equal(results, self.results[s])}
            if all(of.diagnostics.get(TEACHER_EPOCHS) == 0.0 for of in results):
                teachers = teachers or {_teacher_of(result) for result in results}
            if teachers:
                copies[model] = f"= {teachers.pop() if len(teachers) == 1 else 'its teacher'}"
        return copies

    def mark(self, model: str) -> str:
        """Return the text printed next to the name of a model with results."""
        marks = mark_of(self.task.models[model].presentation), self.copies.get(model, "")
        return ", ".join(filter(None, marks))

    def best(self, models: Collection[str] = ()) -> str:
        """Return the model with the best score, of all or of the given models.

        It is a copy only if all are.
        """
        models = models or self.models
        originals = [model for model in models if model not in self.copies]
        return min(originals or models, key=lambda model: self.key.sign * self.mean(model))

    def like_best(self) -> set[str]:
        """Return the models that are not clearly worse than the best; none if no test applies."""
        best = self.best()
        if self.key.is_cost or self._p_values is None:
            return set()
        return {best} | {model for model in self.models if self.verdict(best, model) != "a"}

    def status(self, model: str) -> str:
        """Return a short reason for a missing score, such as "FAILED"; "" if there is one."""
        return self.missing.get(model, "").partition(":")[0]

    @property
    def left_out(self) -> str:
        """Return a note on splits that do not count; "" if all count."""
        every = {split for model in self.scores for split in self.task.models[model].done}
        n_count, n_all = len(self.splits), len(every)
        return f"only the {n_count} of {n_all} splits that all have count" * (n_all > n_count)

    def ratio(self, model: str) -> float:
        """Return a model's error over the VJM's; NaN if one is missing or no error."""
        if self.key.sign < 0.0 or not {model, REFERENCE_MODEL} <= self.scores.keys():
            return math.nan
        error, reference = self.mean(model), self.mean(REFERENCE_MODEL)
        return error / reference if error > 0.0 and reference else math.nan

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield a row per ranked model: what the task is, and its numbers.

        `error` and `noise` are in the metric's unit, the percentile `p95` and the error against
        `readings` in m, also of the `oracle`, the error left on tool `path`s in mm, `coverage` in
        1; NaN: unknown.
        """
        p95, noise, oracle = _TRUE_P95, math.nan, math.nan  # the truth has no noise
        if self.key != TRUE:
            p95, noise = _P95, _mean(self.key, self.bounds(NOISE_FLOOR))
        if (world := self.task.fit.dataset_params.get("world")) is not None:
            oracle = _mean(READINGS, self.bounds(BOUND_NAMES["oracle"]))
        for model in self.scores:
            results = self.results[model]
            paths = [result.diagnostics.get(PATH_ERROR, math.nan) for result in results]
            yield {
                "task": self,
                "model": model,
                "robot": self.data.robot.name,
                "kind": self.kind,
                "family": family_of(self.name),
                "world": world,
                "dataset": self.name.dataset,
                "protocol": self.name.protocol,
                "condition": self.name.condition,
                "error": self.mean(model),
                "error ratio": self.ratio(model),
                "p95": _mean(p95, results),
                "readings": self.mean(model) if self.key == READINGS else _mean(READINGS, results),
                "oracle": oracle,
                "path": float(np.mean(paths)),
                "coverage": _mean(_COVERAGE, results),
                "noise": noise,
            }


def _teacher_of(result: FitResult) -> str:
    """Return the teacher that a fit chose, or that its options name."""
    return str(result.chosen.get("anchor") or result.fit.model_params.get("anchor", ""))


def _are_equal(results: Sequence[FitResult], of_teacher: Sequence[FitResult]) -> bool:
    """Test if two models have the same predictions on every split, up to rounding."""
    parts = [
        (result.prediction.predicted, taught.prediction.predicted)
        for result, taught in zip(results, of_teacher, strict=True)
        if result.prediction is not None and taught.prediction is not None
    ]
    return len(parts) == len(results) and all(
        a.shape == b.shape and np.allclose(a, b, rtol=0.0, atol=SAME_PREDICTION) for a, b in parts
    )


def _mean(key: SortKey, results: Sequence[FitResult]) -> float:
    values = key.of_splits(results) if results else None
    return math.nan if values is None else float(values.mean())


def split_sizes(results: Sequence[FitResult]) -> tuple[float, float]:
    """Return the mean numbers of training and test rows per split.

    The results of the splits are correlated through n_test / n_samples. This holds for learning
    curves too: few training rows hardly overlap from split to split (counted in
    tests/protocols/scoring/test_false_positives.py).
    """
    n_test = np.mean([len(r.prediction.rows) for r in results if r.prediction is not None])
    return float(np.mean([result.n_train for result in results])), float(n_test)


def _test_share(results: Sequence[FitResult], data: StoredData) -> float:
    """Return the share (0..1) of the samples that a model is tested on.

    Tool paths are the same in all splits: there it is the share that no split trains on.
    """
    n_train, n_test = split_sizes(results)
    if results[0].presentation.measured_sha256:
        return 1.0 - n_train / len(data.measured)
    return n_test / len(data.samples)


def shared_errors(
    key: SortKey,
    results: Sequence[Sequence[FitResult]],
    scores: Sequence[FloatArray],
    data: StoredData,
    seed: int,
) -> SharedErrors:
    """Return the errors of models on the same splits, with a column per model.

    `scores` are the (J,) values of the key on J splits, or one value of splits scored together.
    Untested poses of the data set have no rows. Tasks with different test poses of a data set thus
    share the draws.

    Raises:
        DataError: the models were not tested on the same rows.
    """
    columns = np.column_stack(scores)  # (J, m)
    predictions = [pooled_prediction(of_model) for of_model in results]
    of_rows = [key.of_rows(prediction) for prediction in predictions]
    errors, rows = [of_model for of_model in of_rows if of_model is not None], predictions[0].rows
    if errors and not all(np.array_equal(rows, prediction.rows) for prediction in predictions):
        raise DataError("only models that were tested on the same rows can be compared")
    pose_id = data.samples.pose_id
    return SharedErrors(
        of_splits=key.sign * columns if len(columns) > 1 else None,
        test_share=_test_share(results[0], data),
        of_poses=pose_errors(pose_id, np.column_stack(errors), rows) if errors else None,
        seed=seed,
    )


def score_task(
    task: Task, models: Sequence[str], key: SortKey, data: StoredData, seed: int
) -> ScoredTask:
    """Return the scores of the models that can be ranked, with the VJM's.

    Only the splits that all ranked models have count. A model with fewer requested splits is ranked
    if it has them all. A model without a value is missing. A model with an unfinished run is
    missing, too, unless it has every split that the finished models share. If the VJM was not run,
    its predictions are those that every fit contains.

    Raises:
        StoreError: two models have no split in common.
    """
    results: dict[str, Sequence[FitResult]] = {
        model: task.results(model)
        for model in models
        if model in task.models and not task.models[model].failures
    }
    scores = {model: key.of_splits(of_model) for model, of_model in results.items()}
    missing = _missing_reasons(task, models, scores, key)
    present = [model for model in models if model not in missing]
    splits = tuple(task.shared_splits(present)) if present else ()
    if present and not splits:
        raise StoreError(
            f"{task.name.text}: {' and '.join(present)} were run on different splits and share "
            "none, so they cannot be compared; leave one of them out or run it again"
        )
    for model in present:
        if len(results[model]) > len(splits):
            results[model] = task.results(model, splits)
            scores[model] = key.of_splits(results[model])
    ranked_results = {model: results[model] for model in present}
    if REFERENCE_MODEL not in task.models and splits:
        of_vjm = bound_results([ranked_results[present[0]]], REFERENCE_MODEL)
        if of_vjm:
            done = dict(zip(splits, of_vjm, strict=True))
            vjm = ModelResults(of_vjm[0].presentation, done, failures={}, n_requested=len(done))
            task = replace(task, models={**task.models, REFERENCE_MODEL: vjm})
            ranked_results[REFERENCE_MODEL] = of_vjm
            scores[REFERENCE_MODEL] = key.of_splits(of_vjm)
    values = {model: of for model in ranked_results if (of := scores[model]) is not None}
    return ScoredTask(task, key, data, seed, splits, ranked_results, values, missing)


def _missing_reasons(
    task: Task, models: Sequence[str], scores: Mapping[str, FloatArray | None], key: SortKey
) -> dict[str, str]:
    """Return the models that are not ranked, with the reason; a colon ends its short form."""
    missing = dict[str, str]()
    for model in models:
        if (stored := task.models.get(model)) is None:
            missing[model] = "not run"
        elif stored.failures:
            failure = next(iter(stored.failures.values()))
            missing[model] = f"{failure.status.upper()}: {' '.join(failure.failure.split())}"
        elif scores[model] is None:
            missing[model] = f"no value of {key.text}"
    of_models = {model: task.models[model] for model in models if model not in missing}
    finished = [m for m, stored in of_models.items() if len(stored.done) >= stored.n_requested]
    needed = set(task.shared_splits(finished))
    for model, stored in of_models.items():
        if not finished or not needed <= stored.done.keys():
            n_done = f"{len(stored.done)} of {stored.n_requested} splits"
            missing[model] = f"{n_done}: run not finished"
    return missing
