"""Compare two models: the difference of their errors per axis, and its uncertainty."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stiff_bench.results.load import StoredResults, Task
from stiff_bench.results.notes import (
    TRAINING_MARK,
    differing_libraries,
    left_out_notes,
    same_name_other_data,
    sources,
)
from stiff_bench.results.scored_task import score_task, shared_errors, sort_key
from stiff_bench.results.selection import EVERYTHING, Selection, resolve_model_name
from stiff_bench.results.significance import Estimate, Question, Verdict, decide, estimates
from stiff_bench.store.names import TaskName, labels, natural_key
from stiff_bench.store.samples import StoredData
from stiff_bench.tables.units import first_few
from stiff_protocols.contract.errors import ConfigError, DataError, StoreError
from stiff_protocols.contract.record import CellResult, Presentation
from stiff_protocols.contract.types import AXES
from stiff_protocols.scoring.paired import holm

NORM = "norm"
ERRORS = {**{axis: sort_key("mae", axis) for axis in AXES}, NORM: sort_key(NORM)}
"""Compared errors: the absolute error along each axis, and the length of the error vector."""


@dataclass(frozen=True)
class Difference:
    """One kind of error of A and of B.

    Attributes:
        error: one of `ERRORS`.
        means: mean absolute errors of A and of B, m.
        over_splits: estimate of the corrected t test; None with one split or pooled splits.
        over_poses: estimate of the bootstrap over poses, with the fitted models held fixed.
        verdict: verdict of all estimates; without splits it holds only for the fitted models.
    """

    error: str
    means: tuple[float, float]
    over_splits: Estimate | None
    over_poses: Estimate
    verdict: Verdict

    @property
    def difference(self) -> float:
        """Return A minus B, m; negative if A is better."""
        return self.means[0] - self.means[1]

    @property
    def estimate(self) -> Estimate:
        """Return the estimate over splits if there is one, else over poses."""
        return self.over_splits or self.over_poses

    @property
    def cautious(self) -> Estimate:
        """Return the estimate with the wider interval, for texts with a single interval."""
        return max(
            self.estimate, self.over_poses, key=lambda estimate: estimate.high - estimate.low
        )


@dataclass(frozen=True)
class Comparison:
    """A and B in one task.

    Attributes:
        task: task with both models.
        a, b: labels and warnings that are printed with their numbers.
        results: results of A and of B on their common splits.
        n_poses: number of tested poses.
        differences: kind of error -> difference.
        missing: lines about requested splits without a result of A or B.
        among_all: verdict on leaderboard and report page, with p corrected for all pairs of models.
            None without other models, or if A or B is not ranked.
    """

    task: Task
    a: Presentation
    b: Presentation
    results: tuple[Sequence[CellResult], Sequence[CellResult]]
    n_poses: int
    differences: dict[str, Difference]
    missing: tuple[str, ...]
    among_all: Verdict | None

    @property
    def name(self) -> TaskName:
        """Return the name of the task."""
        return self.task.name

    @property
    def norm(self) -> Difference:
        """Return the difference of the 3-D errors."""
        return self.differences[NORM]

    @property
    def n_splits(self) -> int:
        """Return the number of common splits."""
        return len(self.results[0])

    @property
    def over_splits(self) -> bool:
        """Return True if the spread over splits is known."""
        return self.norm.over_splits is not None

    @property
    def selects_on_test(self) -> bool:
        """Return True if the protocol lets models use the test part for a choice."""
        return self.a.selects_on_test or self.b.selects_on_test


def compare(task: Task, a: str, b: str, data: StoredData, question: Question) -> Comparison:
    """Compare two models on their common splits of a task.

    Raises:
        DataError: a model has no results there, they share no split, or only one pose was tested.
    """
    for name in (a, b):
        if not task.models[name].done:
            first = next(iter(task.models[name].failures.values()))
            raise DataError(f"{name} has no result ({first.why_none})")
    if not (splits := task.shared_splits([a, b])):
        raise DataError(f"{a} and {b} have no result on the same split")
    results = task.results(a, splits), task.results(b, splits)
    rows = np.concatenate([result.prediction.rows for result in results[0] if result.prediction])
    n_poses = len(np.unique(data.samples.pose_id[rows]))
    if n_poses < 2:
        raise DataError("a bootstrap over poses needs at least 2 poses, there is 1")
    return Comparison(
        task=task,
        a=task.models[a].presentation,
        b=task.models[b].presentation,
        results=results,
        n_poses=n_poses,
        differences={of.error: of for of in _differences(results, data, question)},
        missing=tuple(_missing(task, a, b)),
        among_all=_among_all(task, a, b, data, question),
    )


def _among_all(task: Task, a: str, b: str, data: StoredData, question: Question) -> Verdict | None:
    try:
        scored = score_task(task, [*task.models], ERRORS[NORM], data, question.seed)
    except StoreError:  # two other models share no split
        return None
    if len(scored.scores) < 3 or not {a, b} <= scored.scores.keys():
        return None
    verdicts = scored.verdicts([(a, b)], question)
    return verdicts[0] if verdicts else None


def _differences(
    results: Sequence[Sequence[CellResult]], data: StoredData, question: Question
) -> Iterator[Difference]:
    """Yield each kind of error with its verdict; with several splits also over splits."""
    means, of_errors = [], []
    for key in ERRORS.values():
        a, b = (key.of_splits(of_model) for of_model in results)
        if a is None or b is None:
            raise DataError(f"no value of {key.text}")
        means.append((float(a.mean()), float(b.mean())))
        errors = shared_errors(key, results, [a, b], data, question.seed)
        of_methods = estimates(errors, [(0, 1)], question, all_p_values=True)
        of_errors.append([estimate for (estimate,) in of_methods])
    # the axes are corrected for each other (Holm); the length is a separate question
    by_method = [
        [*_corrected(of_axes), length] for *of_axes, length in zip(*of_errors, strict=True)
    ]
    for error, of_both, *of_error in zip(ERRORS, means, *by_method, strict=True):
        over_splits = of_error[0] if len(of_error) > 1 else None
        verdict = decide(of_error, question.confidence)
        yield Difference(error, of_both, over_splits, of_error[-1], verdict)


def _corrected(results: Sequence[Estimate]) -> list[Estimate]:
    """Correct the p-values of results for each other (Holm)."""
    p_values = holm([result.p_value for result in results]).tolist()
    return [replace(result, p_value=p) for result, p in zip(results, p_values, strict=True)]


def _missing(task: Task, a: str, b: str) -> Iterator[str]:
    """Yield lines about splits without a result of A or B, with the reasons."""
    models = [task.models[name] for name in (a, b)]
    run = {split for model in models for split in (*model.done, *model.failures)}
    n_requested = max(model.n_requested for model in models)
    if len(run) < n_requested:
        yield f"{len(run)} of {n_requested} requested splits were run"
    for model in models:
        missing_splits = sorted(run - model.done.keys())
        failures = [model.failures.get(split) for split in missing_splits]
        reasons = dict.fromkeys(failure.why_none if failure else "not run" for failure in failures)
        if missing_splits:
            n_missing = f"{len(missing_splits)} of {len(run)} splits"
            yield f"{model.name} has no result on {n_missing} ({'; '.join(reasons)})"


@dataclass(frozen=True)
class ModelComparison:
    """Two models in all tasks in which both were run.

    Attributes:
        a, b: names.
        question: settings of the tests.
        comparisons: one per task; at least one.
        notes: tasks that were not compared, and results that do not count.
        provenance: versions of stiffbench that made the results.
    """

    a: str
    b: str
    question: Question
    comparisons: tuple[Comparison, ...]
    notes: tuple[str, ...]
    provenance: tuple[str, ...]


def compare_folder(
    folder: Path,
    a: str,
    b: str,
    question: Question,
    selection: Selection = EVERYTHING,
) -> ModelComparison:
    """Compare two models in every selected task with common splits.

    Raises:
        ConfigError: a name is unknown, A is B, or they have no task in common.
        StoreError: the folder holds no results, or corrupt ones.
    """
    stored = StoredResults.read(folder)
    a, b = (resolve_model_name(word, stored.tasks) for word in (a, b))
    if a == b:
        raise ConfigError(f"both models are {a!r}; give two different models")
    chosen = selection.tasks_of(stored.tasks)
    chosen.sort(key=lambda task: (natural_key(task.name.text), task.name))
    task_labels = labels(task.name for task in chosen)
    run = {
        name: [task_labels[task.name] for task in chosen if name in task.models] for name in (a, b)
    }
    data_of = stored.data_of
    comparisons, notes = list[Comparison](), list[str]()
    for task in chosen:
        if not {a, b} <= task.models.keys():
            continue
        if task.models[a].presentation.reports_training:
            notes.append(f"not compared: {task_labels[task.name]}: {TRAINING_MARK}.")
            continue
        data = data_of(task.name.data_sha256)
        try:
            comparisons.append(compare(task, a, b, data, question))
        except DataError as error:
            notes.append(f"not compared: {task_labels[task.name]}: {error}.")
    if not comparisons:
        places = "; ".join(f"{name} was run in {_named(tasks)}" for name, tasks in run.items())
        data_notes = "".join(f"; {line}" for line in same_name_other_data(chosen, data_of))
        raise ConfigError(
            " ".join(notes) or f"{a} and {b} have no comparison in common: {places}{data_notes}"
        )
    for name, other_name in ((a, b), (b, a)):
        if only := [place for place in run[name] if place not in run[other_name]]:
            notes.append(f"only {name} was run in {_named(only)}.")
    shared = [comparison.task for comparison in comparisons]
    counts = {
        name: Counter(
            result.run_id for comparison in comparisons for result in comparison.results[number]
        )
        for number, name in enumerate((a, b))
    }
    return ModelComparison(
        a=a,
        b=b,
        question=question,
        comparisons=tuple(comparisons),
        notes=(
            *notes,
            *same_name_other_data(shared, data_of),
            *left_out_notes(shared),
            *differing_libraries(stored.runs, counts),
        ),
        provenance=(sources(folder, stored.runs, counts[a] + counts[b]),),
    )


def _named(names: Sequence[str]) -> str:
    return first_few([f"({name})" for name in names]) or "none of these"
