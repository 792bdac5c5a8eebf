"""Results of several models on the splits that all of them have."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from stiff_bench.paper.study import DATASET, PAPER_PROTOCOL, SEED
from stiff_bench.store.database import read_manifests
from stiff_bench.store.names import grouped
from stiff_bench.store.versions import sources
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult

if TYPE_CHECKING:
    from stiff_bench.analysis.collected import Competitor, Contest
    from stiff_protocols.contract.record import CellResult


REPRODUCE, FULL = "`bench reproduce`", "`bench reproduce --full`"
"""The commands that make results."""


@dataclass(frozen=True, eq=False)
class SharedSplits:
    """What a folder has of some models under one protocol.

    Attributes:
        protocol: its name.
        results: model -> its results, on the same splits for all; a model that has none is not
            there.
        failures: model -> why it has no numbers, though it was run.
        missing: models that were never run.
        n_left_out: splits on which some of the models have a result, and others do not.
    """

    protocol: str
    results: Mapping[str, Sequence[CellResult]]
    failures: Mapping[str, str]
    missing: Sequence[str]
    n_left_out: int

    @property
    def n_splits(self) -> int:
        """How many splits all have."""
        return len(next(iter(self.results.values()), ()))

    def notes(
        self, remedy: str = REPRODUCE, labels: Mapping[str, str] | None = None
    ) -> Iterator[str]:
        """Yield what was run how often, and what is not there and what makes it.

        Args:
            remedy: the command that makes what is missing.
            labels: model -> what it is called in the table, if not so.
        """
        spread = ", mean ± standard deviation over them" if self.n_splits > 1 else ""
        yield (
            f"Ours: {DATASET} (simulated), {self.protocol}, "
            f"{counted(self.n_splits, 'split')}{spread}, seed {SEED}."
        )
        pickers = [name for name, found in self.results.items() if found[0].shown.picked_on_test]
        if pickers:
            which = "all" if len(pickers) == len(self.results) else ", ".join(pickers)
            yield f"{self.protocol} picks the best epoch on the test part ({which}): optimistic."
        yield from self._regimes()
        yield from self.absences(remedy, labels)

    def absences(
        self, remedy: str = REPRODUCE, labels: Mapping[str, str] | None = None
    ) -> Iterator[str]:
        """Yield what is not there, and what makes it; arguments as in `notes`."""
        if self.n_left_out:
            yield (
                f"Left out: {counted(self.n_left_out, 'split')} of {self.protocol} that only some "
                f"of the models have; {FULL} makes the others'."
            )
        for reason in self.failures.values():
            yield f"No numbers: {reason}."
        if self.missing:
            names = ", ".join((labels or {}).get(model, model) for model in self.missing)
            yield f"Without a result under {self.protocol}: {names}; {remedy} makes it."

    def _regimes(self) -> Iterator[str]:
        """Yield how models used training labels, where there is something to say."""
        shown = {model: found[0].shown.regime for model, found in self.results.items()}
        for regime, models in grouped(shown, lambda model: shown[model]).items():
            if regime:
                which = "all of ours" if len(models) == len(shown) else ", ".join(models)
                yield f"{self.protocol}, {which}: {regime}."


@dataclass(frozen=True, eq=False)
class TriedModels:
    """What a folder has of some models under one protocol, each on its own splits.

    Attributes:
        results, failures, missing: as in `SharedSplits`.
    """

    results: Mapping[str, list[CellResult]]
    failures: Mapping[str, str]
    missing: Sequence[str]


def tried_models(results: PaperResults, models: Iterable[str], protocol: str) -> TriedModels:
    """Return the results of models; one that failed on a split has none."""
    found, failures, missing = dict[str, list[CellResult]](), dict[str, str](), list[str]()
    for model in models:
        try:
            found[model] = results.splits(model, protocol)
        except StoreError as error:
            if _was_run(results, model, protocol):
                failures[model] = str(error)
            else:
                missing.append(model)
    return TriedModels(found, failures, missing)


def shared_splits(results: PaperResults, models: Iterable[str], protocol: str) -> SharedSplits:
    """Return the results of models on the splits that all of them have, of those that have any.

    Raises:
        StoreError: none has a result, or no split is of all.
    """
    tried = tried_models(results, models, protocol)
    found, failures, missing = tried.results, tried.failures, tried.missing
    if not found:
        why = "; ".join(failures.values()) or f"no result of {missing[0]}"
        if len(missing) > 1 and not failures:
            why += f" nor of {len(missing) - 1} others"
        raise StoreError(
            f"--results {results.folder}: nothing to print of {DATASET} under {protocol}: {why}; "
            f"{REPRODUCE} makes it"
        )
    each = [{one.cell.split_sha256 for one in of_model} for of_model in found.values()]
    shared, any_of = set.intersection(*each), set.union(*each)
    if not shared:
        raise StoreError(
            f"--results {results.folder}: {', '.join(found)} have no split of {protocol} in "
            f"common; {FULL} makes what is missing"
        )
    return SharedSplits(
        protocol=protocol,
        results={
            model: [one for one in of_model if one.cell.split_sha256 in shared]
            for model, of_model in found.items()
        },
        failures=failures,
        missing=missing,
        n_left_out=len(any_of - shared),
    )


def provenance(results: PaperResults, used: Iterable[SharedSplits]) -> str:
    """Return a line that names which stiffbench made the results that are shown."""
    counts = Counter(
        one.run_id for part in used for of_model in part.results.values() for one in of_model
    )
    (line,) = sources(results.folder, list(read_manifests(results.folder)), counts)
    return line


def _was_run(results: PaperResults, model: str, protocol: str) -> bool:
    return any(
        model in contest.competitors
        for contest in results.contests
        if (contest.name.protocol, contest.name.dataset, contest.name.seed)
        == (protocol, DATASET, SEED)
    )


"""Where `bench reproduce` stores what the paper's tables and figures show."""


def paper_results(folder: Path) -> PaperResults:
    """Read the results that `--results` names.

    Raises:
        StoreError: there are none, and `bench reproduce` makes them; or a file is damaged.
    """
    from stiff_bench.store.database import has_results

    if not has_results(folder):
        raise StoreError(f"--results {folder}: holds no results; `bench reproduce` makes them")
    return PaperResults.of(folder)


@dataclass(frozen=True, eq=False)
class PaperResults:
    """The newest results of a folder, model by model.

    Attributes:
        folder: of the results.
        contests: all that it holds.
    """

    folder: Path
    contests: tuple[Contest, ...]

    @classmethod
    def of(cls, folder: Path) -> PaperResults:
        """Read a folder.

        Raises:
            StoreError: it holds no results, or a file of it is damaged.
        """
        from stiff_bench.analysis.collected import collect

        return cls(folder, tuple(collect(folder)))

    def models(self, protocol: str = PAPER_PROTOCOL, dataset: str = DATASET) -> list[str]:
        """Return the names of the models that have a result under a protocol, in order."""
        found = self._contest(protocol, dataset)
        return (
            [] if found is None else [name for name, one in found.competitors.items() if one.done]
        )

    def has(self, model: str, protocol: str = PAPER_PROTOCOL, dataset: str = DATASET) -> bool:
        """Say whether a model has a result under a protocol."""
        return model in self.models(protocol, dataset)

    def splits(
        self, model: str, protocol: str = PAPER_PROTOCOL, dataset: str = DATASET
    ) -> list[CellResult]:
        """Return a model's results, one a split, in the order of the splits.

        Raises:
            StoreError: it has none, or failed on a split.
        """
        where = f"{self.folder}: {model} on {dataset} under {protocol}"
        found = self._competitor(model, protocol, dataset)
        if found is None:
            raise StoreError(f"{where}: no result; `bench reproduce` makes it")
        if found.failures:
            n_splits = counted(len(found.failures), "split")
            first = next(iter(found.failures.values()))
            raise StoreError(f"{where}: no result of {n_splits}: {first.why_none}")
        return [found.done[slot] for slot in sorted(found.done)]

    def _competitor(self, model: str, protocol: str, dataset: str) -> Competitor | None:
        contest = self._contest(protocol, dataset)
        return None if contest is None else contest.competitors.get(model)

    def _contest(self, protocol: str, dataset: str) -> Contest | None:
        """Return the newest contest of that name: other seeds and older data are others."""
        found: Sequence[Contest] = [
            contest
            for contest in self.contests
            if (contest.name.protocol, contest.name.dataset) == (protocol, dataset)
            and not contest.name.condition
            and contest.name.seed == SEED
        ]
        return max(found, key=lambda contest: contest.newest_run, default=None)
