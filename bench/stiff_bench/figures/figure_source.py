"""Selection of the results of a folder for a figure."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_bench.figures.style import short
from stiff_bench.results.fit_values import pooled_prediction
from stiff_bench.results.load import SplitId, StoredResults, Task, model_names, newest_tasks
from stiff_bench.results.notes import mark_of
from stiff_bench.results.selection import EVERYTHING, Selection, matches_key, resolve_model_name
from stiff_bench.store.names import grouped
from stiff_bench.tables.units import counted
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import FitResult, Presentation
from stiff_protocols.contract.types import FloatArray, Prediction
from stiff_protocols.scoring.metrics import norm_errors

LEAST = 1e-12
"""Smallest error before a logarithm is taken, m."""
NOISE = "noise"
"""Key of `BOUND_NAMES`: the deflection before the instruments' noise."""
Has = Callable[[FitResult], object]
"""Test of a result: true if a figure can show it."""


def between(counts: Collection[int], thing: str) -> str:
    """Return "5 splits", or "1 to 5 splits" if counts differ."""
    least, most = min(counts), max(counts)
    return counted(most, thing) if least == most else f"{least} to {counted(most, thing)}"


def marks(presentations: Iterable[Presentation]) -> str:
    """Return a sentence for each mark of the models; "" for none."""
    presentations = list(presentations)
    all_names = dict.fromkeys(presentation.model for presentation in presentations)
    sentences = []
    for mark, marked in grouped(presentations, mark_of).items():
        models = dict.fromkeys(presentation.model for presentation in marked)
        unmarked_names = [name for name in all_names if name not in models]
        subject = ", ".join(models)
        if len(models) > len(unmarked_names) + 1:
            exceptions = ", ".join(unmarked_names)
            subject = " but ".join(filter(None, ("All models shown", exceptions)))
        sentences += [f" {subject}: {mark}."] if mark else []
    return "".join(sentences)


def marks_in(tasks: Iterable[Task], models: Collection[str]) -> str:
    """Return `marks` of the models of some tasks."""
    return marks(
        stored.presentation
        for task in tasks
        for name, stored in task.models.items()
        if name in models
    )


def subtitle(task: Task) -> str:
    """Return the data set, protocol and condition for a picture."""
    return f"{data_text(task)}, {condition_text(task)}"


def data_text(task: Task) -> str:
    """Return the data set and its kind."""
    return f"{task.name.dataset} ({task.presentation.kind})"


def condition_text(task: Task) -> str:
    """Return the protocol and its condition."""
    return ", ".join(filter(None, [task.name.protocol, task.name.condition]))


def setting(tasks: Sequence[Task], models: Collection[str], n_splits: Collection[int]) -> str:
    """Return data, protocols, splits, seeds and model marks of some tasks."""
    splits = between(n_splits, "split")
    conditions = grouped(tasks, lambda task: (condition_text(task), task.name.seed))
    texts = [
        f"{', '.join(map(data_text, of_condition))}, {condition}, {splits}, seed {seed}"
        for (condition, seed), of_condition in conditions.items()
    ]
    paths = " Of tool paths: error without correction as deflection, removed error as prediction."
    has_paths = any(task.has_paths for task in tasks)
    return f"{'; '.join(texts)}.{marks_in(tasks, models)}{paths * has_paths}"


MOST_PANELS = 6
"""Data sets that a figure shows; its caption names the others."""
TITLE_LETTERS = 28
"""Longest line above one of three panels with model names on the left, letters."""


@dataclass(frozen=True, eq=False)
class FigureSource:
    """Results of a folder that figures may show.

    Attributes:
        folder: folder of the results.
        tasks: tasks of the selected data sets and protocols; at least one.
        models: selected models, as words; empty: each figure selects a readable number.
    """

    folder: Path
    tasks: tuple[Task, ...]
    models: tuple[str, ...] = ()

    @classmethod
    def of(cls, folder: Path, selection: Selection = EVERYTHING) -> FigureSource:
        """Read a folder.

        Raises:
            StoreError: the folder has no results, or a file is corrupt.
            ConfigError: a name has no results.
        """
        chosen = selection.tasks_of(StoredResults.read(folder).tasks)
        return cls(folder, tuple(chosen), selection.models)

    @cached_property
    def newest(self) -> tuple[Task, ...]:
        """Cases with the newest data of each name: measured first, then in the order of selection.

        Tasks that report training rows are included only if all tasks do.
        """
        newest = {task.name for task in newest_tasks(self.tasks)}
        in_order = [task for task in self.tasks if task.name in newest]
        tests = [task for task in in_order if not task.presentation.reports_training]
        return tuple(
            sorted(tests or in_order, key=lambda task: task.presentation.kind != "measured")
        )

    def names(self, tasks: Sequence[Task]) -> list[str]:
        """Return the selected models, or all, with a result in these tasks.

        Raises:
            ConfigError: a word has no results in the folder.
        """
        every_name, names = model_names(self.tasks), dict[str, None]()
        for word in self.models:
            matches = [name for name in every_name if matches_key(word, name)]
            names |= dict.fromkeys(matches or [resolve_model_name(word, self.tasks)])
        done = {name for task in tasks for name, model in task.models.items() if model.done}
        return [name for name in (names or every_name) if name in done]

    def results(self, task: Task, has: Has) -> list[FitResult]:
        """Return the results of the selected models in a task that pass `has`."""
        names = self.names([task])
        return [result for name in names for result in task.results(name) if has(result)]

    def tasks_with(self, has: Has, needs: str, *, most_first: bool = False) -> list[Task]:
        """Return the task to draw for each data set: measured first, then as selected.

        Preferred are, in this order: a protocol that does not select on test data, no condition,
        most models. With `most_first`, the task with most models is preferred to all others.
        `needs` names the required content of a result, with the command that creates it.

        Raises:
            StoreError: no task has such a result of the selected models.
        """
        models = self.names(self.newest)

        def n_models(task: Task) -> int:
            there = [name for name in models if name in task.models]
            return sum(any(map(has, task.results(name))) for name in there)

        def preference(task: Task) -> tuple[int, bool, bool, int, int, str]:
            n, is_fair = n_models(task), not task.presentation.selects_on_test
            is_plain = not task.name.condition  # a condition is one of many sizes or directions
            return n * most_first, is_fair, is_plain, n, len(task.splits), task.newest_run

        able = grouped(filter(n_models, self.newest), lambda task: task.name.dataset)
        if not able:
            of = f" of {', '.join(self.models)}" if self.models else ""
            raise StoreError(f"{self.folder}: no result{of} has {needs}", "results")
        return [max(tasks, key=preference) for tasks in able.values()]  # the first of equal tasks

    def task(self, has: Has, needs: str) -> Task:
        """Return the first of `tasks_with`, for a figure of one data set."""
        return self.tasks_with(has, needs)[0]

    def panels(
        self,
        most: int,
        has: Has = lambda _: True,
        what: str = "a result",
        made_by: str = "",
        *,
        most_panels: int = MOST_PANELS,
    ) -> Panels:
        """Return the data sets to draw, with the selected models or the `most` best.

        The best always include the linear model. `what` names the required content of the
        results. `made_by` names the command that creates it.

        Raises:
            StoreError: no result has this content, or the models do not share a split.
        """
        every = self.tasks_with(has, "; ".join(filter(None, (what, made_by))))
        tasks = every[:most_panels]
        able = {
            task: [name for name in self.names([task]) if any(map(has, task.results(name)))]
            for task in tasks
        }
        models = list(dict.fromkeys(name for names in able.values() for name in names))
        names = models if self.models else _best(able, most)
        panels = []
        for task in tasks:
            there = tuple(name for name in names if name in able[task])
            shared = task.shared_splits(there) if there else []
            splits = [at for at in shared if all(has(task.models[n].done[at]) for n in there)]
            if splits:
                panels.append(Compared(task, there, tuple(splits)))
        if not panels:
            raise StoreError(
                f"{self.folder}: {tasks[0].name.text}: {', '.join(names)}: no split on which all "
                f"have {what}; run each model on the same splits",
                "results",
            )
        notes = []
        if len(names) < len(models):
            always = f"; {REFERENCE_MODEL} is always among them" * (REFERENCE_MODEL in names)
            notes.append(f"Best {len(names)} of {len(models)} models{always}.")
        drawn = [panel.task.name.dataset for panel in panels]
        if hidden := [task.name.dataset for task in every if task.name.dataset not in drawn]:
            notes.append(f"Not shown: {', '.join(hidden)}.")
        data = {task.name.dataset: set[str]() for task in self.tasks}
        for task in self.tasks:
            data[task.name.dataset].add(task.measured_sha256)
        if older := [dataset for dataset in drawn if len(data[dataset]) > 1]:
            notes.append(f"Results on older data named {', '.join(older)} are left out.")
        return Panels(tuple(panels), tuple(names), " ".join(notes))

    def compared(self, most: int) -> Compared:
        """Return the first of `panels`, for a figure of one data set."""
        panels = self.panels(most, most_panels=1)
        return replace(panels.compared[0], notes=panels.notes)


@dataclass(frozen=True, eq=False)
class Compared:
    """Models of one task that a figure shows.

    Attributes:
        task: task with the results.
        models: names, best first unless they were selected.
        splits: splits that all models share.
        notes: sentences on omitted results.
    """

    task: Task
    models: tuple[str, ...]
    splits: tuple[SplitId, ...]
    notes: str = ""

    @property
    def setting(self) -> str:
        """Data, protocol, splits, seed, marks of models, and omitted results."""
        return Panels((self,), self.models, self.notes).setting

    @property
    def subtitle(self) -> str:
        """Data set, protocol and condition."""
        return subtitle(self.task)

    @property
    def tested(self) -> dict[str, Prediction]:
        """Model -> its test samples of all splits, one after the other."""
        return {
            name: pooled_prediction(self.task.results(name, self.splits)) for name in self.models
        }

    @property
    def linear_error(self) -> float | None:
        """Mean length of the linear model's error on the test samples, m; None: not known."""
        name = REFERENCE_MODEL if REFERENCE_MODEL in self.models else self.models[0]
        tested = pooled_prediction(self.task.results(name, self.splits))
        linear = tested.predicted if name == REFERENCE_MODEL else tested.reference
        return None if linear is None else _mean_distance(linear, tested.measured)

    @property
    def noise_floor(self) -> float | None:
        """Mean length of the error from the instruments' noise, m; None: not known."""
        return noise_floor(self.task.results(self.models[0], self.splits))


@dataclass(frozen=True, eq=False)
class Panels:
    """Data sets of a figure, with a panel per data set.

    Attributes:
        compared: models of each data set; at least one data set.
        models: all names, in the order of their colours.
        notes: sentences on omitted results.
    """

    compared: tuple[Compared, ...]
    models: tuple[str, ...]
    notes: str = ""

    @property
    def setting(self) -> str:
        """Data, protocols, splits, seed, marks of models, and omitted results."""
        n_splits = [
            len(panel.task.results(name, panel.splits))
            for panel in self.compared
            for name in panel.models
        ]
        about = setting([panel.task for panel in self.compared], self.models, n_splits)
        return " ".join(filter(None, [about, self.notes]))

    @property
    def titled(self) -> list[tuple[str, Compared]]:
        """Each panel with its title."""
        return list(zip(self.titles, self.compared, strict=True))

    @property
    def titles(self) -> list[str]:
        """Data set of each panel, on one line or two; [""] for a single panel."""
        tasks = [panel.task for panel in self.compared]
        if len(tasks) == 1:
            return [""]
        names = [short(task.name.dataset, TITLE_LETTERS) for task in tasks]
        kinds = [f"({task.presentation.kind})" for task in tasks]
        if not self.condition:
            conditions = [short(condition_text(task), TITLE_LETTERS) for task in tasks]
            kinds = [
                f"{kind} {condition}" for kind, condition in zip(kinds, conditions, strict=True)
            ]
        texts = list(zip(names, kinds, strict=True))
        is_long = max(len(" ".join(text)) for text in texts) > TITLE_LETTERS
        return [("\n" if is_long else " ").join(text) for text in texts]

    @property
    def subtitle(self) -> str:
        """`condition`; for a single panel with its data set."""
        return self.compared[0].subtitle if len(self.compared) == 1 else self.condition

    @property
    def condition(self) -> str:
        """Protocol and condition that all panels share; "" if they differ."""
        conditions = {condition_text(panel.task) for panel in self.compared}
        return conditions.pop() if len(conditions) == 1 else ""


def noise_floor(results: Iterable[FitResult]) -> float | None:
    """Return the mean length of the error from the instruments' noise, m; None: not known.

    `results` cover the drawn splits; the results of a single model are enough.
    """
    noise, measured = [], []
    for result in results:
        tested = result.prediction
        if tested is None or NOISE not in tested.bound_deflections:
            return None
        noise.append(tested.bound_deflections[NOISE])
        measured.append(tested.measured)
    return _mean_distance(np.concatenate(noise), np.concatenate(measured)) if noise else None


def _mean_distance(predicted: FloatArray, measured: FloatArray) -> float:
    """Return the mean distance between the rows of two (n, 3) arrays [m], m."""
    return float(np.linalg.norm(predicted - measured, axis=1).mean())


def mean_length(results: Sequence[FitResult]) -> float:
    """Return the mean length of the error over the test samples of some results, m."""
    return float(norm_errors(pooled_prediction(results)).mean())


def _best(able: Mapping[Task, Sequence[str]], most: int) -> list[str]:
    """Return the best models with most panels and splits, and the linear model."""
    errors = {}
    for task, names in able.items():
        n_done = {name: len(task.models[name].done) for name in names}
        complete = [name for name in names if n_done[name] == max(n_done.values())]
        errors[task.name] = {name: mean_length(task.results(name)) for name in complete}
    logarithms = pd.DataFrame(errors).clip(lower=LEAST).map(np.log)  # a row per model
    relative = (logarithms - logarithms.mean()).mean(axis=1)
    n_panels = logarithms.count(axis=1)
    ordered = sorted(logarithms.index, key=lambda name: (-n_panels[name], relative[name]))
    return with_linear(ordered, most)


def with_linear(ordered: Sequence[str], most: int) -> list[str]:
    """Return the first models; a later linear model replaces the last."""
    best = list(ordered[:most])
    if REFERENCE_MODEL in ordered and REFERENCE_MODEL not in best:
        best[-1:] = [REFERENCE_MODEL]
    return best
