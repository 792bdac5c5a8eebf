"""Stored results, sorted into cases: models on the same data and the same splits."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any, Self

import numpy as np

from stiff_bench.store.database import (
    read_data,
    read_manifests,
    read_results,
    why_no_results,
)
from stiff_bench.store.names import SHORT, CaseName, grouped, labels, natural_key
from stiff_bench.store.newest import (
    Runs,
    Slot,
    of_newest_options,
    of_newest_splits,
    select_result,
    slot_of,
)
from stiff_bench.store.samples import StoredData, what_differs
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import Cell, CellResult, Presentation, RunManifest


def test_share(results: Sequence[CellResult], data: StoredData) -> float:
    """Return the share (0..1) of the samples that a model is tested on.

    Tool paths are the same in all splits: there it is the share that no split trains on.
    """
    n_train, n_test = split_sizes(results)
    if results[0].presentation.measured_sha256:
        return 1.0 - n_train / len(data.measured)
    return n_test / len(data.samples)


def split_sizes(results: Sequence[CellResult]) -> tuple[float, float]:
    """Return the mean numbers of training and test rows per split.

    The results of the splits are correlated through n_test / n_samples. This holds for learning
    curves too: few training rows hardly overlap from split to split (counted in
    tests/protocols/scoring/test_false_positives.py).
    """
    n_test = np.mean([len(r.prediction.rows) for r in results if r.prediction is not None])
    return float(np.mean([result.n_train for result in results])), float(n_test)


@dataclass(frozen=True, eq=False, repr=False)
class Competitor(BriefFields):
    """One model, with its options, in one case.

    Attributes:
        presentation: labels and warnings that are printed with its numbers.
        done: its results by slot, in order.
        failures: failed or skipped fits by slot, with the reason; no slot is also in `done`.
        n_requested: number of splits that its newest run requested here; 0 if unknown.
    """

    presentation: Presentation
    done: Mapping[Slot, CellResult]
    failures: Mapping[Slot, CellResult]
    n_requested: int

    @property
    def name(self) -> str:
        """Key with the options that differ from their defaults."""
        return self.presentation.model

    @property
    def cell(self) -> Cell:
        """Return any of its cells; all have the same model options."""
        return next(iter([*self.done.values(), *self.failures.values()])).cell


@dataclass(frozen=True, eq=False, repr=False)
class Case(BriefFields):
    """All models on one data set under one protocol and condition.

    Results on different data are never in the same case, even if the data sets share a name.

    Attributes:
        name: data set, protocol, condition, seed and data hashes.
        slots: splits on which at least one model was run, in order.
        competitors: models by name, sorted by name.
        newest_run: latest run that requested these results and failures; a run's name begins with
            its time.
        first_requested: position of its first cell in the order of the runs' requests; infinite if
            no run requested it.
        cell: any of its cells; all have the same options of data set and protocol.
        left_out: reasons why some results do not count.
        every: all results, including those that do not count.
    """

    name: CaseName
    slots: tuple[Slot, ...]
    competitors: Mapping[str, Competitor]
    newest_run: str
    first_requested: float
    cell: Cell
    left_out: tuple[str, ...]
    every: tuple[CellResult, ...] = field(repr=False)

    @property
    def presentation(self) -> Presentation:
        """Return the labels printed with the numbers; its model is an arbitrary one."""
        return next(iter(self.competitors.values())).presentation

    @property
    def measured_sha256(self) -> str:
        """Return the hash of the data set, without tool path points added by the protocol."""
        return self.presentation.measured_sha256 or self.name.data_sha256

    @property
    def has_paths(self) -> bool:
        """Return True if the protocol added tool paths; the metrics are then errors on paths."""
        return self.measured_sha256 != self.name.data_sha256

    def results(self, competitor: str, slots: Sequence[Slot] | None = None) -> list[CellResult]:
        """Return a model's results on these slots (default: all its slots), in order."""
        done = self.competitors[competitor].done
        if slots is None:
            return list(done.values())
        return [done[slot] for slot in slots if slot in done]

    def results_of_all_slots(self, competitor: str) -> list[CellResult]:
        """Return a model's results, or none unless every split has a result."""
        done = self.competitors[competitor].done if competitor in self.competitors else {}
        return self.results(competitor) if all(slot in done for slot in self.slots) else []

    def shared_slots(self, competitors: Iterable[str]) -> list[Slot]:
        """Return the splits on which all of these models have a result, in order."""
        done = (self.competitors[name].done for name in competitors)
        return sorted(set(self.slots).intersection(*done))


@dataclass(frozen=True, eq=False, repr=False)
class StoredResults(BriefFields):
    """All results stored in a folder.

    Attributes:
        folder: folder that was read.
        cases: all of its results, in the order in which runs requested them.
        runs: manifests in the folder.
    """

    folder: Path
    cases: tuple[Case, ...]
    runs: tuple[RunManifest, ...] = ()

    @functools.cached_property
    def data_of(self) -> Callable[[str], StoredData]:
        """Return a cached reader of data sets by hash; it raises StoreError for corrupt data."""
        return functools.cache(functools.partial(read_data, self.folder))

    @classmethod
    def read(cls, folder: Path, where_from: str = " (valid: an output of `bench run`)") -> Self:
        """Read all results of a folder and sort them into cases.

        If results contradict each other, the newest run counts: see `newest.py`.

        Raises:
            StoreError: the folder holds no results, or its file is corrupt.
        """
        results = read_results(folder)
        if not results:
            raise StoreError(f"{folder}: {why_no_results(folder)}{where_from}", "results")
        return cls.of_results(folder, results)

    @classmethod
    def of_results(cls, folder: Path, results: Sequence[CellResult]) -> Self:
        """Sort the given results of a folder into cases."""
        manifests = tuple(read_manifests(folder))
        runs = Runs.of(manifests)
        cases = [_case(of_case, runs) for of_case in grouped(results, case_name_of).values()]
        in_order = sorted(cases, key=lambda case: (case.first_requested, case.name))
        return cls(folder, tuple(in_order), manifests)


def case_name_of(result: CellResult) -> CaseName:
    """Return the name of the case that a result belongs to."""
    cell, texts = result.cell, result.presentation
    data = cell.data_sha256, cell.source_sha256
    return CaseName(texts.dataset, texts.protocol, cell.condition, cell.seed, *data)


def _case(case_results: Sequence[CellResult], runs: Runs) -> Case:
    results, left_out = of_newest_splits(case_results, runs)
    in_order = runs.newest_first(results)
    newest_of = {
        result.presentation.model: result for result in reversed(in_order)
    }  # the newest is the last set
    competitors = {}
    for model, of_model in sorted(
        grouped(results, lambda result: result.presentation.model).items()
    ):
        newest_result = newest_of[model]
        current_results, older_options = of_newest_options(of_model, newest_result)
        left_out += older_options
        of_slots = {
            slot: select_result(slot_results, runs)
            for slot, slot_results in sorted(grouped(current_results, slot_of).items())
        }
        competitors[model] = Competitor(
            presentation=newest_result.presentation,
            done={slot: result for slot, result in of_slots.items() if result.status == "ok"},
            failures={slot: result for slot, result in of_slots.items() if result.status != "ok"},
            n_requested=newest_result.n_splits,
        )
    slots = {
        slot
        for competitor in competitors.values()
        for slot in (*competitor.done, *competitor.failures)
    }
    return Case(
        name=case_name_of(case_results[0]),
        slots=tuple(sorted(slots)),
        competitors=competitors,
        newest_run=runs.run_of(in_order[0]),
        first_requested=min(
            runs.first_requested.get(result.cell.key, inf) for result in case_results
        ),
        cell=results[0].cell,
        left_out=tuple(left_out),
        every=tuple(case_results),
    )


def competitor_names(cases: Iterable[Case]) -> list[str]:
    """Return the names of all models with a result or a failure."""
    return sorted({name for case in cases for name in case.competitors})


def same_name_other_data(
    cases: Sequence[Case], data_of: Callable[[str], StoredData]
) -> Iterator[str]:
    """Yield a line per data set name that is used for different data.

    Source domains of cases are checked in the same way. `data_of` returns the data with a hash; it
    raises StoreError if they are not stored.
    """
    of_dataset = grouped(sorted(cases, key=lambda c: c.newest_run), lambda case: case.name.dataset)
    for dataset, dataset_cases in sorted(of_dataset.items()):
        # the newest hash is the last
        hashes = {case.measured_sha256: case.name.data_sha256 for case in dataset_cases}
        what = "data or TCP"
        if len(hashes) > 1:
            with suppress(StoreError):
                what = what_differs([data_of(sha256) for sha256 in hashes.values()])
        yield from _several(dataset, f"data here: {what}", hashes)
    names = labels(case.name for case in cases)
    for dataset_cases in grouped(cases, lambda case: replace(case.name, source_sha256="")).values():
        sources = {case.name.source_sha256 for case in dataset_cases}
        yield from _several(names[dataset_cases[0].name], "pre-training data here", sorted(sources))


def _several(name: str, what: str, hashes: Collection[str]) -> Iterator[str]:
    if len(hashes) > 1:
        short = ", ".join(sha256[:SHORT] for sha256 in hashes)
        yield f"{name} is the name of different {what} ({short}); they are never compared."


def left_out_notes(cases: Sequence[Case]) -> Iterator[str]:
    """Yield a line per reason why results of these cases do not count."""
    names = labels(case.name for case in cases)
    reasons = [(reason, names[case.name]) for case in cases for reason in case.left_out]
    for reason, pairs in grouped(reasons, lambda pair: pair[0]).items():
        places = list(dict.fromkeys(place for _, place in pairs))
        where = places[0] if len(places) == 1 else f"{len(places)} comparisons"
        yield f"{where}: {reason} are left out."


def caveats_of(cases: Iterable[Case]) -> list[str]:
    """Return warnings and caveats of the cases' protocols and data sets, without repeats."""
    presentations = [case.presentation for case in cases]
    caveats = [caveat for presentation in presentations for caveat in presentation.caveats]
    return [
        *filter(
            None,
            dict.fromkeys([*(presentation.warning for presentation in presentations), *caveats]),
        )
    ]


def of_newest_data(cases: Sequence[Case]) -> list[Case]:
    """Return the cases on each data set's newest data.

    Some cases differ only in the source domain's data or in added tool paths: the newest is kept.
    """
    in_order = sorted(
        cases, key=lambda case: (case.newest_run, case.name)
    )  # later cases replace earlier ones
    newest_data = {case.name.dataset: case.measured_sha256 for case in in_order}
    current = [c for c in in_order if c.measured_sha256 == newest_data[c.name.dataset]]
    newest_source = {replace(case.name, data_sha256="", source_sha256=""): case for case in current}
    return list(newest_source.values())


def in_order(case: Case) -> tuple[Any, ...]:
    """Return a sort key that puts "n = 5" before "n = 10"."""
    name = case.name
    return (*map(natural_key, (name.protocol, name.condition, name.dataset)), name)


def newest_results(stored: StoredResults) -> list[CellResult]:
    """Return the newest results and failures, sorted by comparison."""
    return [
        result
        for case in sorted(stored.cases, key=in_order)
        for model in case.competitors.values()
        for result in (*model.done.values(), *model.failures.values())
    ]
