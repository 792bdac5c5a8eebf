"""Which of a folder's results a figure shows."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path

from stiff_bench.analysis.collected import Case, StoredResults, competitor_names
from stiff_bench.analysis.leaderboard import of_newest_data
from stiff_bench.analysis.selection import EVERYTHING, Selection, competitor_meant, stands_for
from stiff_bench.store.names import grouped, natural_key
from stiff_bench.store.newest import Slot
from stiff_bench.tables import metric_table
from stiff_bench.tables.metric_table import mark_of, pooled_prediction
from stiff_bench.tables.units import counted, first_few
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult, Presentation
from stiff_protocols.contract.types import Prediction
from stiff_protocols.scoring.metrics import norm_errors

Has = Callable[[CellResult], object]
"""What is true of a result that has what a figure shows."""


def between(counts: Collection[int], thing: str) -> str:
    """Return "5 splits", or "1 to 5 splits" where not all are equal."""
    least, most = min(counts), max(counts)
    return counted(most, thing) if least == most else f"{least} to {counted(most, thing)}"


def marks(shown: Iterable[Presentation]) -> str:
    """Return a sentence for each mark that stands beside models elsewhere; "" for none."""
    shown = list(shown)
    everyone = dict.fromkeys(one.model for one in shown)
    sentences = []
    for mark, marked in grouped(shown, mark_of).items():
        models = dict.fromkeys(one.model for one in marked)
        others = [name for name in everyone if name not in models]
        which = ", ".join(models)
        if len(models) > len(others) + 1:
            which = " but ".join(filter(None, ("All models shown", ", ".join(others))))
        sentences += [f" {which}: {mark}."] if mark else []
    return "".join(sentences)


def marks_in(cases: Iterable[Case], models: Collection[str]) -> str:
    """Return `marks` of the models of some cases."""
    return marks(
        found.shown for case in cases for name, found in case.competitors.items() if name in models
    )


def subtitle(case: Case) -> str:
    """Return which data set, protocol and condition a picture shows."""
    about = f"{case.name.dataset} ({case.shown.kind})"
    return ", ".join(filter(None, [about, case.name.protocol, case.name.condition]))


@dataclass(frozen=True, eq=False)
class FigureSource:
    """Results of a folder that figures may show.

    Attributes:
        folder: of the results.
        cases: those of the data sets and protocols that were asked for; at least one.
        models: words that were asked for; none: each figure takes those that it is clear with.
    """

    folder: Path
    cases: tuple[Case, ...]
    models: tuple[str, ...] = ()

    @classmethod
    def of(cls, folder: Path, selection: Selection = EVERYTHING) -> FigureSource:
        """Read a folder.

        Raises:
            StoreError: it holds no results, or a file of it is corrupt.
            ConfigError: a name has no results.
        """
        chosen = selection.cases_of(StoredResults.read(folder).cases)
        return cls(folder, tuple(chosen), selection.models)

    @cached_property
    def newest(self) -> tuple[Case, ...]:
        """The cases that figures show: those of the data that each name stands for last.

        Those whose reported rows hold training rows are shown where there are no others alone.
        """
        newest = tuple(of_newest_data(self.cases))
        tests = tuple(case for case in newest if not case.shown.reports_training)
        return tests or newest

    @cached_property
    def _as_asked(self) -> list[Case]:
        """The newest cases: data sets in the order of asking, newest runs first within each."""
        by_name = grouped(self.newest, lambda case: case.name.dataset)
        first = {name: min(case.first_asked for case in cases) for name, cases in by_name.items()}
        names = sorted(by_name, key=lambda name: (first[name], natural_key(name)))
        newest_first = (sorted(by_name[n], key=lambda c: c.newest_run, reverse=True) for n in names)
        return list(chain.from_iterable(newest_first))

    def names(self, cases: Sequence[Case]) -> list[str]:
        """Return the models asked for, or all, that have a result in these cases.

        Raises:
            ConfigError: a word has no results in the folder.
        """
        known, asked = competitor_names(self.cases), dict[str, None]()
        for word in self.models:
            found = [name for name in known if stands_for(word, name)]
            asked |= dict.fromkeys(found or [competitor_meant(word, self.cases)])
        done = {name for one in cases for name, found in one.competitors.items() if found.done}
        return [name for name in (asked or known) if name in done]

    def setting(self, case: Case, models: Collection[str], n_splits: Collection[int]) -> str:
        """Return data, protocol, splits and seed of some models, and what must be read with them.

        Other data sets, whose figures can be asked for, are named.
        """
        name, splits = case.name, between(n_splits, "split")
        of_case = metric_table.setting(
            case.shown, name.condition, splits, name.seed, after_data=", "
        )
        paths = (
            " Of tool paths: error without correction as deflection, removed error as prediction."
        )
        datasets = dict.fromkeys(stored.name.dataset for stored in self._as_asked)
        datasets.pop(name.dataset, None)
        more = f" Other data sets (`--dataset`): {first_few([*datasets])}." if datasets else ""
        return f"{of_case}.{marks_in([case], models)}{paths * case.has_paths}{more}"

    def results(self, case: Case, has: Has) -> list[CellResult]:
        """Return the results of a case, of the models asked for, that have what is shown."""
        each = (one for name in self.names([case]) for one in case.results(name))
        return [one for one in each if has(one)]

    def case(self, has: Has, needs: str, *, most_first: bool = False) -> Case:
        """Return the case to draw: fair before others, then measured, then with most models.

        Of equal ones it is of the data set that was asked for first. `needs` says what its results
        must have, with the command that makes it. With `most_first` it is the one with most models,
        fair and measured or not.

        Raises:
            StoreError: no case has such a result of the models asked for.
        """
        models = self.names(self.newest)

        def n_models(case: Case) -> int:
            there = [name for name in models if name in case.competitors]
            return sum(any(map(has, case.results(name))) for name in there)

        def preference(case: Case) -> tuple[int, bool, bool, bool, int, int]:
            n = n_models(case)
            fair = not case.shown.selects_on_test
            is_measured = case.shown.kind == "measured"
            whole = not case.name.condition  # not case of many sizes or directions
            first = n if most_first else min(n, 1)
            return first, fair, is_measured, whole, n, len(case.slots)

        best = max(self._as_asked, key=preference)  # the first of equal ones
        if not n_models(best):
            of = f" of {', '.join(self.models)}" if self.models else ""
            raise StoreError(f"{self.folder}: no result{of} has {needs}", "results")
        return best

    def compared(
        self, most: int, has: Has = lambda _: True, what: str = "a result", made_by: str = ""
    ) -> Compared:
        """Return the models to draw: those asked for, or `most` of the best and the linear one.

        `what` says what their results must have, and `made_by` which command makes it.

        Raises:
            StoreError: no result has it, or there is no split on which all models have it.
        """
        case = self.case(has, "; ".join(filter(None, (what, made_by))))
        able = [name for name in self.names([case]) if any(map(has, case.results(name)))]
        names = able if self.models else _best(case, able, most)
        shared = case.shared_slots(names)
        slots = [at for at in shared if all(has(case.competitors[n].done[at]) for n in names)]
        if not slots:
            raise StoreError(
                f"{self.folder}: {case.name.text}: {', '.join(names)}: no split on which all have "
                f"{what}; as many splits of each make them",
                "results",
            )
        about = self.setting(case, names, [len(slots)])
        if len(names) < len(able):
            about += f" Best {len(names)} of {len(able)} models, and {REFERENCE_MODEL} in any case."
        dataset = case.name.dataset
        if any(one.name.dataset == dataset and one not in self.newest for one in self.cases):
            about += f" Results on older data named {dataset} are left out."
        return Compared(case, tuple(names), tuple(slots), about)


@dataclass(frozen=True, eq=False)
class Compared:
    """Models of one case that a figure shows.

    Attributes:
        case: the results.
        models: their names, best first unless they were asked for.
        slots: the splits that all of them have.
        setting: data, protocol, splits, seed, marks of models, and what is left out.
    """

    case: Case
    models: tuple[str, ...]
    slots: tuple[Slot, ...]
    setting: str

    @property
    def subtitle(self) -> str:
        """Which data set, protocol and condition it is."""
        return subtitle(self.case)

    @property
    def tested(self) -> dict[str, Prediction]:
        """Model -> its test samples of all splits, one after the other."""
        return {
            name: pooled_prediction(self.case.results(name, self.slots)) for name in self.models
        }


def mean_length(results: Sequence[CellResult]) -> float:
    """Return the mean length of the error over the test samples of some results, m."""
    return float(norm_errors(pooled_prediction(results)).mean())


def _best(case: Case, names: Sequence[str], most: int) -> list[str]:
    """Return the best of the models that have most splits, and the linear one."""
    n_done = {name: len(case.competitors[name].done) for name in names}
    complete = [name for name in names if n_done[name] == max(n_done.values())]
    return with_linear(sorted(complete, key=lambda one: mean_length(case.results(one))), most)


def with_linear(ordered: Sequence[str], most: int) -> list[str]:
    """Return the first of some models; the linear one takes the last place if it comes later."""
    best = list(ordered[:most])
    if REFERENCE_MODEL in ordered and REFERENCE_MODEL not in best:
        best[-1:] = [REFERENCE_MODEL]
    return best
