"""Selection of the results of a folder for a figure."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from stiff_bench.analysis.collected import Case, StoredResults, competitor_names, of_newest_data
from stiff_bench.analysis.selection import EVERYTHING, Selection, matches_key, resolve_model_name
from stiff_bench.figures.style import short
from stiff_bench.store.names import grouped
from stiff_bench.store.newest import Slot
from stiff_bench.tables.metric_table import mark_of, pooled_prediction
from stiff_bench.tables.units import counted
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult, Presentation
from stiff_protocols.contract.types import FloatArray, Prediction
from stiff_protocols.scoring.metrics import norm_errors

LEAST = 1e-12
"""Smallest error before a logarithm is taken, m."""
NOISE = "noise"
"""Key of `BOUND_NAMES`: the deflection before the instruments' noise."""
Has = Callable[[CellResult], object]
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


def marks_in(cases: Iterable[Case], models: Collection[str]) -> str:
    """Return `marks` of the models of some cases."""
    return marks(
        competitor.presentation
        for case in cases
        for name, competitor in case.competitors.items()
        if name in models
    )


def subtitle(case: Case) -> str:
    """Return the data set, protocol and condition for a picture."""
    return f"{data_text(case)}, {condition_text(case)}"


def data_text(case: Case) -> str:
    """Return the data set and its kind."""
    return f"{case.name.dataset} ({case.presentation.kind})"


def condition_text(case: Case) -> str:
    """Return the protocol and its condition."""
    return ", ".join(filter(None, [case.name.protocol, case.name.condition]))


def setting(cases: Sequence[Case], models: Collection[str], n_splits: Collection[int]) -> str:
    """Return data, protocols, splits, seeds and model marks of some cases."""
    splits = between(n_splits, "split")
    conditions = grouped(cases, lambda case: (condition_text(case), case.name.seed))
    texts = [
        f"{', '.join(map(data_text, of_condition))}, {condition}, {splits}, seed {seed}"
        for (condition, seed), of_condition in conditions.items()
    ]
    paths = " Of tool paths: error without correction as deflection, removed error as prediction."
    has_paths = any(case.has_paths for case in cases)
    return f"{'; '.join(texts)}.{marks_in(cases, models)}{paths * has_paths}"


MOST_PANELS = 6
"""Data sets that a figure shows; its caption names the others."""
TITLE_LETTERS = 28
"""Longest line above one of three panels with model names on the left, letters."""


@dataclass(frozen=True, eq=False)
class FigureSource:
    """Results of a folder that figures may show.

    Attributes:
        folder: folder of the results.
        cases: cases of the selected data sets and protocols; at least one.
        models: selected models, as words; empty: each figure selects a readable number.
    """

    folder: Path
    cases: tuple[Case, ...]
    models: tuple[str, ...] = ()

    @classmethod
    def of(cls, folder: Path, selection: Selection = EVERYTHING) -> FigureSource:
        """Read a folder.

        Raises:
            StoreError: the folder has no results, or a file is corrupt.
            ConfigError: a name has no results.
        """
        chosen = selection.cases_of(StoredResults.read(folder).cases)
        return cls(folder, tuple(chosen), selection.models)

    @cached_property
    def newest(self) -> tuple[Case, ...]:
        """Cases with the newest data of each name: measured first, then in the order of selection.

        Cases that report training rows are included only if all cases do.
        """
        newest = {case.name for case in of_newest_data(self.cases)}
        in_order = [case for case in self.cases if case.name in newest]
        tests = [case for case in in_order if not case.presentation.reports_training]
        return tuple(
            sorted(tests or in_order, key=lambda case: case.presentation.kind != "measured")
        )

    def names(self, cases: Sequence[Case]) -> list[str]:
        """Return the selected models, or all, with a result in these cases.

        Raises:
            ConfigError: a word has no results in the folder.
        """
        every_name, names = competitor_names(self.cases), dict[str, None]()
        for word in self.models:
            matches = [name for name in every_name if matches_key(word, name)]
            names |= dict.fromkeys(matches or [resolve_model_name(word, self.cases)])
        done = {name for case in cases for name, model in case.competitors.items() if model.done}
        return [name for name in (names or every_name) if name in done]

    def results(self, case: Case, has: Has) -> list[CellResult]:
        """Return the results of the selected models in a case that pass `has`."""
        names = self.names([case])
        return [result for name in names for result in case.results(name) if has(result)]

    def cases_with(self, has: Has, needs: str, *, most_first: bool = False) -> list[Case]:
        """Return the case to draw for each data set: measured first, then as selected.

        Preferred are, in this order: a protocol that does not select on test data, no condition,
        most models. With `most_first`, the case with most models is preferred to all others.
        `needs` names the required content of a result, with the command that creates it.

        Raises:
            StoreError: no case has such a result of the selected models.
        """
        models = self.names(self.newest)

        def n_models(case: Case) -> int:
            there = [name for name in models if name in case.competitors]
            return sum(any(map(has, case.results(name))) for name in there)

        def preference(case: Case) -> tuple[int, bool, bool, int, int, str]:
            n, is_fair = n_models(case), not case.presentation.selects_on_test
            is_plain = not case.name.condition  # a condition is one of many sizes or directions
            return n * most_first, is_fair, is_plain, n, len(case.slots), case.newest_run

        able = grouped(filter(n_models, self.newest), lambda case: case.name.dataset)
        if not able:
            of = f" of {', '.join(self.models)}" if self.models else ""
            raise StoreError(f"{self.folder}: no result{of} has {needs}", "results")
        return [max(cases, key=preference) for cases in able.values()]  # the first of equal cases

    def case(self, has: Has, needs: str) -> Case:
        """Return the first of `cases_with`, for a figure of one data set."""
        return self.cases_with(has, needs)[0]

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
        every = self.cases_with(has, "; ".join(filter(None, (what, made_by))))
        cases = every[:most_panels]
        able = {
            case: [name for name in self.names([case]) if any(map(has, case.results(name)))]
            for case in cases
        }
        models = list(dict.fromkeys(name for names in able.values() for name in names))
        names = models if self.models else _best(able, most)
        panels = []
        for case in cases:
            there = tuple(name for name in names if name in able[case])
            shared = case.shared_slots(there) if there else []
            slots = [at for at in shared if all(has(case.competitors[n].done[at]) for n in there)]
            if slots:
                panels.append(Compared(case, there, tuple(slots)))
        if not panels:
            raise StoreError(
                f"{self.folder}: {cases[0].name.text}: {', '.join(names)}: no split on which all "
                f"have {what}; run each model on the same splits",
                "results",
            )
        notes = []
        if len(names) < len(models):
            always = f"; {REFERENCE_MODEL} is always among them" * (REFERENCE_MODEL in names)
            notes.append(f"Best {len(names)} of {len(models)} models{always}.")
        drawn = [panel.case.name.dataset for panel in panels]
        if hidden := [case.name.dataset for case in every if case.name.dataset not in drawn]:
            notes.append(f"Not shown: {', '.join(hidden)}.")
        data = {case.name.dataset: set[str]() for case in self.cases}
        for case in self.cases:
            data[case.name.dataset].add(case.measured_sha256)
        if older := [dataset for dataset in drawn if len(data[dataset]) > 1]:
            notes.append(f"Results on older data named {', '.join(older)} are left out.")
        return Panels(tuple(panels), tuple(names), " ".join(notes))

    def compared(self, most: int) -> Compared:
        """Return the first of `panels`, for a figure of one data set."""
        panels = self.panels(most, most_panels=1)
        return replace(panels.compared[0], notes=panels.notes)


@dataclass(frozen=True, eq=False)
class Compared:
    """Models of one case that a figure shows.

    Attributes:
        case: case with the results.
        models: names, best first unless they were selected.
        slots: splits that all models share.
        notes: sentences on omitted results.
    """

    case: Case
    models: tuple[str, ...]
    slots: tuple[Slot, ...]
    notes: str = ""

    @property
    def setting(self) -> str:
        """Data, protocol, splits, seed, marks of models, and omitted results."""
        return Panels((self,), self.models, self.notes).setting

    @property
    def subtitle(self) -> str:
        """Data set, protocol and condition."""
        return subtitle(self.case)

    @property
    def tested(self) -> dict[str, Prediction]:
        """Model -> its test samples of all splits, one after the other."""
        return {
            name: pooled_prediction(self.case.results(name, self.slots)) for name in self.models
        }

    @property
    def linear_error(self) -> float | None:
        """Mean length of the linear model's error on the test samples, m; None: not known."""
        name = REFERENCE_MODEL if REFERENCE_MODEL in self.models else self.models[0]
        tested = pooled_prediction(self.case.results(name, self.slots))
        linear = tested.predicted if name == REFERENCE_MODEL else tested.reference
        return None if linear is None else _mean_distance(linear, tested.measured)

    @property
    def noise_floor(self) -> float | None:
        """Mean length of the error from the instruments' noise, m; None: not known."""
        return noise_floor(self.case.results(self.models[0], self.slots))


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
            len(panel.case.results(name, panel.slots))
            for panel in self.compared
            for name in panel.models
        ]
        about = setting([panel.case for panel in self.compared], self.models, n_splits)
        return " ".join(filter(None, [about, self.notes]))

    @property
    def titled(self) -> list[tuple[str, Compared]]:
        """Each panel with its title."""
        return list(zip(self.titles, self.compared, strict=True))

    @property
    def titles(self) -> list[str]:
        """Data set of each panel, on one line or two; [""] for a single panel."""
        cases = [panel.case for panel in self.compared]
        if len(cases) == 1:
            return [""]
        names = [short(case.name.dataset, TITLE_LETTERS) for case in cases]
        kinds = [f"({case.presentation.kind})" for case in cases]
        if not self.condition:
            conditions = [short(condition_text(case), TITLE_LETTERS) for case in cases]
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
        conditions = {condition_text(panel.case) for panel in self.compared}
        return conditions.pop() if len(conditions) == 1 else ""


def noise_floor(results: Iterable[CellResult]) -> float | None:
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


def mean_length(results: Sequence[CellResult]) -> float:
    """Return the mean length of the error over the test samples of some results, m."""
    return float(norm_errors(pooled_prediction(results)).mean())


def _best(able: Mapping[Case, Sequence[str]], most: int) -> list[str]:
    """Return the best models with most panels and splits, and the linear model."""
    errors = {}
    for case, names in able.items():
        n_done = {name: len(case.competitors[name].done) for name in names}
        complete = [name for name in names if n_done[name] == max(n_done.values())]
        errors[case.name] = {name: mean_length(case.results(name)) for name in complete}
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
