"""Load stored results: the newest fit of each split, sorted into tasks.

A task is a data set with a protocol and condition; its models have the same data and splits. A
folder may contain results of several runs, versions of stiffbench, and splits with one name. They
never mix: results that contradict the newest run are left out with a note. A run's name begins with
its time, so that names sort by it. A result belongs to the newest run that requested its fit, also
if an earlier run computed it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any, Self

from stiff_bench.store.database import read_data, read_manifests, read_results, why_no_results
from stiff_bench.store.names import TaskName, grouped, natural_key
from stiff_bench.store.samples import StoredData
from stiff_protocols.contract.display import BriefFields
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import Fit, FitResult, Presentation, RunManifest

SplitId = tuple[int, str]
"""A split: its number and the hash of its rows."""


def split_of(result: FitResult) -> SplitId:
    """Return the split of a result."""
    return result.fit.split_index, result.fit.split_sha256


def task_name_of(result: FitResult) -> TaskName:
    """Return the name of the task of a result."""
    fit, texts = result.fit, result.presentation
    data = fit.data_sha256, fit.source_sha256
    return TaskName(texts.dataset, texts.protocol, fit.condition, fit.seed, *data)


@dataclass(frozen=True, eq=False, repr=False)
class ModelResults(BriefFields):
    """Results of one model, with its options, in one task.

    Attributes:
        presentation: labels and warnings that are printed with its numbers.
        done: its results by split, in order.
        failures: failed or skipped fits by split, with the reason; no split is also in `done`.
        n_requested: number of splits that its newest run requested here; 0 if unknown.
    """

    presentation: Presentation
    done: Mapping[SplitId, FitResult]
    failures: Mapping[SplitId, FitResult]
    n_requested: int

    @property
    def fit(self) -> Fit:
        """Return any of its fits; all have the same model options."""
        return next(iter([*self.done.values(), *self.failures.values()])).fit


@dataclass(frozen=True, eq=False, repr=False)
class Task(BriefFields):
    """All models on one data set under one protocol and condition.

    Results on different data are never in the same task, even if the data sets share a name.

    Attributes:
        name: data set, protocol, condition, seed and data hashes.
        splits: splits on which at least one model was run, in order.
        models: models by name, sorted by name.
        newest_run: latest run that requested these results and failures.
        first_requested: position of its first fit in the order of the runs' requests; infinite if
            no run requested it.
        left_out: reasons why some results do not count.
        every: all results, including those that do not count.
    """

    name: TaskName
    splits: tuple[SplitId, ...]
    models: Mapping[str, ModelResults]
    newest_run: str
    first_requested: float
    left_out: tuple[str, ...]
    every: tuple[FitResult, ...] = field(repr=False)

    @property
    def presentation(self) -> Presentation:
        """Return the labels printed with the numbers; its model is an arbitrary one."""
        return next(iter(self.models.values())).presentation

    @property
    def fit(self) -> Fit:
        """Return any of its fits; all have the same options of data set and protocol."""
        return next(iter(self.models.values())).fit

    @property
    def measured_sha256(self) -> str:
        """Return the hash of the data set, without tool path points added by the protocol."""
        return self.presentation.measured_sha256 or self.name.data_sha256

    @property
    def has_paths(self) -> bool:
        """Return True if the protocol added tool paths; the metrics are then errors on paths."""
        return self.measured_sha256 != self.name.data_sha256

    def results(self, model: str, splits: Sequence[SplitId] | None = None) -> list[FitResult]:
        """Return a model's results on these splits (default: all its splits), in order."""
        done = self.models[model].done
        return [done[split] for split in (done if splits is None else splits) if split in done]

    def complete_results(self, model: str) -> list[FitResult]:
        """Return a model's results, or none unless every split has a result."""
        done = self.models[model].done if model in self.models else {}
        return self.results(model) if all(split in done for split in self.splits) else []

    def shared_splits(self, models: Iterable[str]) -> list[SplitId]:
        """Return the splits on which all of these models have a result, in order."""
        done = (self.models[name].done for name in models)
        return sorted(set(self.splits).intersection(*done))


@dataclass(frozen=True, eq=False, repr=False)
class StoredResults(BriefFields):
    """All results stored in a folder.

    Attributes:
        folder: folder that was read.
        tasks: all of its results, in the order in which runs requested them.
        runs: manifests in the folder.
    """

    folder: Path
    tasks: tuple[Task, ...]
    runs: tuple[RunManifest, ...] = ()

    @functools.cached_property
    def data_of(self) -> Callable[[str], StoredData]:
        """Return a cached reader of data sets by hash; it raises StoreError for corrupt data."""
        return functools.cache(functools.partial(read_data, self.folder))

    @classmethod
    def read(cls, folder: Path, valid_text: str = " (valid: an output of `bench run`)") -> Self:
        """Read all results of a folder and sort them into tasks.

        Raises:
            StoreError: the folder holds no results, or its file is corrupt.
        """
        results = read_results(folder)
        if not results:
            raise StoreError(f"{folder}: {why_no_results(folder)}{valid_text}", "results")
        return cls.of_results(folder, results)

    @classmethod
    def of_results(cls, folder: Path, results: Sequence[FitResult]) -> Self:
        """Sort the given results of a folder into tasks."""
        manifests = tuple(read_manifests(folder))
        in_order = sorted(manifests, key=lambda run: run.run_id)
        runs = _Runs({key: run.run_id for run in in_order for key in run.cells})
        tasks = [_task(of_task, runs) for of_task in grouped(results, task_name_of).values()]
        tasks.sort(key=lambda task: (task.first_requested, task.name))
        return cls(folder, tuple(tasks), manifests)

    @property
    def every(self) -> tuple[FitResult, ...]:
        """Return all results, including those that do not count."""
        return tuple(result for task in self.tasks for result in task.every)

    def newest_results(self) -> list[FitResult]:
        """Return the newest results and failures, sorted by task: "n = 5" before "n = 10"."""

        def place(task: Task) -> tuple[Any, ...]:
            name = task.name
            return (*map(natural_key, (name.protocol, name.condition, name.dataset)), name)

        return [
            result
            for task in sorted(self.tasks, key=place)
            for model in task.models.values()
            for result in (*model.done.values(), *model.failures.values())
        ]


def model_names(tasks: Iterable[Task]) -> list[str]:
    """Return the names of all models with a result or a failure."""
    return sorted({name for task in tasks for name in task.models})


def newest_tasks(tasks: Sequence[Task]) -> list[Task]:
    """Return the tasks on each data set's newest data.

    Some tasks differ only in the source domain's data or in added tool paths: the newest is kept.
    """
    in_order = sorted(tasks, key=lambda task: (task.newest_run, task.name))  # later ones replace
    newest_data = {task.name.dataset: task.measured_sha256 for task in in_order}
    current = [t for t in in_order if t.measured_sha256 == newest_data[t.name.dataset]]
    newest_source = {replace(task.name, data_sha256="", source_sha256=""): task for task in current}
    return list(newest_source.values())


@dataclass(frozen=True)
class _Runs:
    """The newest run that requested each fit, by the fit's key, in the order of requests."""

    newest: Mapping[str, str]

    @functools.cached_property
    def first_requested(self) -> dict[str, int]:
        """Place of each fit in the order of first requests."""
        return {key: place for place, key in enumerate(self.newest)}

    def run_of(self, result: FitResult) -> str:
        """Return the newest run that requested or computed a result."""
        return max(self.newest.get(result.fit.key, ""), result.run_id)

    def newest_first(self, results: Iterable[FitResult]) -> list[FitResult]:
        """Return results by run, the newest first; of one run, successes before failures.

        Results that the run computed come before results that it found. Equals keep their order.
        """

        def age(result: FitResult) -> tuple[str, str, bool]:
            return self.run_of(result), result.run_id, result.status == "ok"

        return sorted(results, key=age, reverse=True)


def _task(task_results: Sequence[FitResult], runs: _Runs) -> Task:
    results, left_out = _of_newest_splits(runs.newest_first(task_results), runs)
    models = {}
    for model, of_model in sorted(grouped(results, lambda r: r.presentation.model).items()):
        current_results, notes = _of_newest_options(of_model)
        left_out += notes
        by_split = {
            split: _select_result(split_results)
            for split, split_results in sorted(grouped(current_results, split_of).items())
        }
        models[model] = ModelResults(
            presentation=of_model[0].presentation,
            done={split: result for split, result in by_split.items() if result.status == "ok"},
            failures={split: result for split, result in by_split.items() if result.status != "ok"},
            n_requested=of_model[0].n_splits,
        )
    splits = {split for model in models.values() for split in (*model.done, *model.failures)}
    order = [runs.first_requested.get(result.fit.key, inf) for result in task_results]
    return Task(
        name=task_name_of(task_results[0]),
        splits=tuple(sorted(splits)),
        models=models,
        newest_run=runs.run_of(results[0]),
        first_requested=min(order),
        left_out=tuple(left_out),
        every=tuple(task_results),
    )


def _of_newest_splits(
    newest_first: Sequence[FitResult], runs: _Runs
) -> tuple[list[FitResult], list[str]]:
    """Return the results of one task with the newest run's splits, and a note.

    Two splits of one number show that the data were divided in two ways (another version of the
    protocol). Then the newest run's splits count, with splits of older runs that share some of them
    and contradict none.
    """
    splits = {*map(split_of, newest_first)}
    if len(splits) == len(dict(splits)):
        return list(newest_first), []
    newest_splits: dict[int, str] = {}
    for of_run in grouped(newest_first, runs.run_of).values():
        run_splits = dict(map(split_of, of_run))
        shared = newest_splits.keys() & run_splits.keys()
        if not newest_splits or (
            shared and all(newest_splits[index] == run_splits[index] for index in shared)
        ):
            newest_splits |= run_splits
    same = [result for result in newest_first if split_of(result) in newest_splits.items()]
    every_model, models_left = ({r.presentation.model for r in of} for of in (newest_first, same))
    without = sorted(every_model - models_left)
    models = f" (all of {', '.join(without)})" if without else ""
    return same, [f"older results on other splits than the newest run{models}"]


def _of_newest_options(
    newest_first: Sequence[FitResult],
) -> tuple[list[FitResult], list[str]]:
    """Return a model's results with options and version of its newest one, and a note.

    A name contains only the options that differ from their defaults. The same name has other
    options if a default, or a file that an option names, was changed.
    """
    fit = newest_first[0].fit
    intervals = {0, max(result.fit.interval_version for result in newest_first)}  # 0: none
    same = [
        result
        for result in newest_first
        if result.fit.model_version == fit.model_version
        and result.fit.model_params == fit.model_params
        and result.fit.interval_version in intervals
    ]
    name = newest_first[0].presentation.model
    notes = [f"older results of {name} with another version or other options"]
    return same, notes * (len(same) < len(newest_first))


def _select_result(newest_first: Sequence[FitResult]) -> FitResult:
    """Return the result to use among a model's results on one split.

    It is the newest run's result, also if it failed. A skipped result does not replace a result
    of another machine. The results differ only in their intervals: a result with intervals is
    preferred, then newer intervals.
    """
    tried = [result for result in newest_first if result.status != "skipped"]
    if not tried or tried[0].status != "ok":
        return (tried or newest_first)[0]
    done = [result for result in tried if result.status == "ok"]
    return next((result for result in done if result.fit.coverage is not None), done[0])
