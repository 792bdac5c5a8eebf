"""Stored results, sorted into cases: who met whom on the same data and the same splits."""

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
    counting,
    of_newest_options,
    of_newest_splits,
    slot_of,
)
from stiff_bench.store.samples import StoredData, what_differs
from stiff_protocols.contract.brief_fields import BriefFields
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import Cell, CellResult, Presentation, RunManifest


def test_share(results: Sequence[CellResult], data: StoredData) -> float:
    """Return which part of the samples (0..1) the splits of a model leave to be tested on.

    Of tool paths, which are the same in all splits, it is the part that no split trains on.
    """
    n_train, n_test = split_sizes(results)
    if results[0].shown.measured_sha256:
        return 1.0 - n_train / len(data.measured)
    return n_test / len(data.samples)


def split_sizes(results: Sequence[CellResult]) -> tuple[float, float]:
    """Return how many rows a split of a model trains and tests on, means over the splits.

    What ties the splits' results together is n_test / n_samples, also where a split trains on a
    part of the rest alone (a learning curve): few training rows hardly overlap from split to split
    (counted in tests/protocols/scoring/test_false_positives.py).
    """
    n_test = np.mean([len(r.prediction.rows) for r in results if r.prediction is not None])
    return float(np.mean([result.n_train for result in results])), float(n_test)


@dataclass(frozen=True, eq=False, repr=False)
class Competitor(BriefFields):
    """One model, with its options, in one case.

    Attributes:
        shown: what must stand beside its numbers.
        done: its results by slot, in order.
        failures: by slot, none of which is done: records that say why it failed or was skipped.
        n_asked: how many splits its newest run was asked for here; 0 where it is not known.
    """

    shown: Presentation
    done: Mapping[Slot, CellResult]
    failures: Mapping[Slot, CellResult]
    n_asked: int

    @property
    def name(self) -> str:
        """Key with the options that differ from their defaults."""
        return self.shown.model

    @property
    def cell(self) -> Cell:
        """One of its cells; the options of the model are the same in all."""
        return next(iter([*self.done.values(), *self.failures.values()])).cell


@dataclass(frozen=True, eq=False, repr=False)
class Case(BriefFields):
    """All competitors on one data set under one protocol and condition.

    Results of different data never meet in one, even where the data sets' names are the same.

    Attributes:
        name: what they share.
        slots: the splits that any of them was run on, in order.
        competitors: by name, in the order of their names.
        newest_run: the latest of the runs that asked for its results and failures; a run's name
            begins with its time.
        first_asked: place of its first cell in the order in which cells were asked for; infinite
            where no run says so.
        cell: one of its cells; the options of data set and protocol are the same in all.
        left_out: which results do not count, and why.
        every: all results, those that do not count too.
    """

    name: CaseName
    slots: tuple[Slot, ...]
    competitors: Mapping[str, Competitor]
    newest_run: str
    first_asked: float
    cell: Cell
    left_out: tuple[str, ...]
    every: tuple[CellResult, ...] = field(repr=False)

    @property
    def shown(self) -> Presentation:
        """What stands beside the numbers; what it says of the model is of any of the models."""
        return next(iter(self.competitors.values())).shown

    @property
    def measured_sha256(self) -> str:
        """Hash of the data set, without points of tool paths that the protocol added to it."""
        return self.shown.measured_sha256 or self.name.data_sha256

    @property
    def has_paths(self) -> bool:
        """Whether the protocol added tool paths, whose errors the metrics then are of."""
        return self.measured_sha256 != self.name.data_sha256

    def results(self, competitor: str, slots: Sequence[Slot] | None = None) -> list[CellResult]:
        """Return a model's results on these slots (default: all that it has), in order."""
        done = self.competitors[competitor].done
        if slots is None:
            return list(done.values())
        return [done[slot] for slot in slots if slot in done]

    def results_of_all_slots(self, competitor: str) -> list[CellResult]:
        """Return a model's results if it has one on every split; else none."""
        done = self.competitors[competitor].done if competitor in self.competitors else {}
        return self.results(competitor) if all(slot in done for slot in self.slots) else []

    def shared_slots(self, competitors: Iterable[str]) -> list[Slot]:
        """Return the splits on which all of these models have a result, in order."""
        done = (self.competitors[name].done for name in competitors)
        return sorted(set(self.slots).intersection(*done))


@dataclass(frozen=True, eq=False, repr=False)
class StoredResults(BriefFields):
    """What a folder of results holds.

    Attributes:
        folder: that was read.
        cases: all of its results, in the order in which they were asked for.
        runs: whose manifests it holds.
    """

    folder: Path
    cases: tuple[Case, ...]
    runs: tuple[RunManifest, ...] = ()

    @functools.cached_property
    def data_of(self) -> Callable[[str], StoredData]:
        """Reads the data set of a hash, each once; StoreError: it is corrupt."""
        return functools.cache(functools.partial(read_data, self.folder))

    @classmethod
    def read(cls, folder: Path, where_from: str = " (valid: an output of `bench run`)") -> Self:
        """Read every result of a folder and sort them into cases.

        Where results contradict each other, those of the newest run count: see `newest.py`.

        Raises:
            StoreError: the folder holds no results, or its file is corrupt.
        """
        results = read_results(folder)
        if not results:
            raise StoreError(f"{folder}: {why_no_results(folder)}{where_from}", "results")
        return cls.of_results(folder, results)

    @classmethod
    def of_results(cls, folder: Path, results: Sequence[CellResult]) -> Self:
        """Sort some results of a folder into cases, as `read` does with all."""
        manifests = tuple(read_manifests(folder))
        runs = Runs.of(manifests)
        cases = [_case(of_case, runs) for of_case in grouped(results, case_name_of).values()]
        in_order = sorted(cases, key=lambda case: (case.first_asked, case.name))
        return cls(folder, tuple(in_order), manifests)


def case_name_of(result: CellResult) -> CaseName:
    """Return the name of the case that a result belongs to."""
    cell, shown = result.cell, result.shown
    data = cell.data_sha256, cell.source_sha256
    return CaseName(shown.dataset, shown.protocol, cell.condition, cell.seed, *data)


def _case(found: Sequence[CellResult], runs: Runs) -> Case:
    results, left_out = of_newest_splits(found, runs)
    in_order = runs.newest_first(results)
    newest_of = {one.shown.model: one for one in reversed(in_order)}  # the newest is the last set
    competitors = {}
    for model, of_model in sorted(grouped(results, lambda one: one.shown.model).items()):
        newest = newest_of[model]
        own, older_options = of_newest_options(of_model, newest)
        left_out += older_options
        of_slots = {
            slot: counting(found, runs) for slot, found in sorted(grouped(own, slot_of).items())
        }
        competitors[model] = Competitor(
            shown=newest.shown,
            done={slot: one for slot, one in of_slots.items() if one.status == "ok"},
            failures={slot: one for slot, one in of_slots.items() if one.status != "ok"},
            n_asked=newest.n_splits,
        )
    slots = {slot for one in competitors.values() for slot in (*one.done, *one.failures)}
    return Case(
        name=case_name_of(found[0]),
        slots=tuple(sorted(slots)),
        competitors=competitors,
        newest_run=runs.run_of(in_order[0]),
        first_asked=min(runs.first_asked.get(result.cell.key, inf) for result in found),
        cell=results[0].cell,
        left_out=tuple(left_out),
        every=tuple(found),
    )


def competitor_names(cases: Iterable[Case]) -> list[str]:
    """Return the names of all models that have a result or a failure anywhere."""
    return sorted({name for case in cases for name in case.competitors})


def same_name_other_data(
    cases: Sequence[Case], data_of: Callable[[str], StoredData]
) -> Iterator[str]:
    """Yield a line for each data set whose name stands for different numbers in the folder.

    So too for cases whose source domain does. `data_of` returns the data with a hash; it raises
    StoreError where they are not stored.
    """
    of_dataset = grouped(sorted(cases, key=lambda c: c.newest_run), lambda one: one.name.dataset)
    for dataset, found in sorted(of_dataset.items()):
        # the newest last
        hashes = {one.measured_sha256: one.name.data_sha256 for one in found}
        what = "data or TCP"
        if len(hashes) > 1:
            with suppress(StoreError):
                what = what_differs([data_of(sha256) for sha256 in hashes.values()])
        yield from _several(dataset, f"data here: {what}", hashes)
    names = labels(case.name for case in cases)
    for found in grouped(cases, lambda one: replace(one.name, source_sha256="")).values():
        sources = {one.name.source_sha256 for one in found}
        yield from _several(names[found[0].name], "pre-training data here", sorted(sources))


def _several(name: str, what: str, hashes: Collection[str]) -> Iterator[str]:
    if len(hashes) > 1:
        short = ", ".join(sha256[:SHORT] for sha256 in hashes)
        yield f"{name} stands for different {what} ({short}); they are never compared."


def left_out_notes(cases: Sequence[Case]) -> Iterator[str]:
    """Yield a line for each reason why results of these cases do not count."""
    names = labels(case.name for case in cases)
    reasons = [(reason, names[one.name]) for one in cases for reason in one.left_out]
    for reason, found in grouped(reasons, lambda pair: pair[0]).items():
        places = list(dict.fromkeys(place for _, place in found))
        where = places[0] if len(places) == 1 else f"{len(places)} comparisons"
        yield f"{where}: {reason} are left out."


def caveats_of(cases: Iterable[Case]) -> list[str]:
    """Return what must be read with the protocols and the data sets of cases, each once."""
    shown = [case.shown for case in cases]
    caveats = [caveat for one in shown for caveat in one.caveats]
    return [*filter(None, dict.fromkeys([*(one.warning for one in shown), *caveats]))]


def of_newest_data(cases: Sequence[Case]) -> list[Case]:
    """Return the cases of the data that each data set's newest run was on.

    Of those that differ in the source domain's data or in added tool paths alone, the newest stay.
    """
    in_order = sorted(cases, key=lambda one: (one.newest_run, one.name))  # the last ones stay
    newest_data = {one.name.dataset: one.measured_sha256 for one in in_order}
    current = [c for c in in_order if c.measured_sha256 == newest_data[c.name.dataset]]
    newest_source = {replace(one.name, data_sha256="", source_sha256=""): one for one in current}
    return list(newest_source.values())


def in_order(case: Case) -> tuple[Any, ...]:
    """Return a sort key: "n = 5" stands before "n = 10"."""
    name = case.name
    return (*map(natural_key, (name.protocol, name.condition, name.dataset)), name)


def newest_results(stored: StoredResults) -> list[CellResult]:
    """Return the results and failures that count, the newest of each, sorted by comparison."""
    return [
        result
        for case in sorted(stored.cases, key=in_order)
        for model in case.competitors.values()
        for result in (*model.done.values(), *model.failures.values())
    ]
