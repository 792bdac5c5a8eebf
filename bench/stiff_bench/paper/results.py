"""Stored results of the models that a table or a figure of the paper compares."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from stiff_bench.analysis.collected import Competitor, Contest, collect
from stiff_bench.paper.study import DATASET, SEED
from stiff_bench.store.database import has_results, read_manifests
from stiff_bench.store.names import grouped
from stiff_bench.store.versions import sources
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.record import CellResult

REPRODUCE, FULL = "`bench reproduce`", "`bench reproduce --full`"
"""The commands that make results."""


@dataclass(frozen=True, eq=False)
class Found:
    """What a folder has of some models under one protocol.

    Attributes:
        protocol: its name.
        results: model -> its results, one a split in the order of the splits; a model that has
            none, or that failed on a split, is not there.
        failures: model -> why it has no numbers, though it was run.
        missing: models that were never run.
        n_left_out: splits on which some of the models have a result, and others do not.
    """

    protocol: str
    results: Mapping[str, Sequence[CellResult]]
    failures: Mapping[str, str]
    missing: Sequence[str]
    n_left_out: int = 0

    def notes(
        self, remedy: str = REPRODUCE, labels: Mapping[str, str] | None = None
    ) -> Iterator[str]:
        """Yield what was run how often, what must be read with it, and what is not there.

        Args:
            remedy: the command that makes what is missing.
            labels: model -> what it is called in the table, if not so.
        """
        n_splits = len(next(iter(self.results.values())))
        spread = ", mean ± standard deviation over them" if n_splits > 1 else ""
        yield (
            f"Ours: {DATASET} (simulated), {self.protocol}, {counted(n_splits, 'split')}{spread}, "
            f"seed {SEED}."
        )
        shown = {model: found[0].shown for model, found in self.results.items()}
        pickers = [model for model, one in shown.items() if one.picked_on_test]
        if pickers:
            which = "all" if len(pickers) == len(shown) else ", ".join(pickers)
            yield f"{self.protocol} picks the best epoch on the test part ({which}): optimistic."
        for regime, models in grouped(shown, lambda model: shown[model].regime).items():
            if regime:
                which = "all of ours" if len(models) == len(shown) else ", ".join(models)
                yield f"{self.protocol}, {which}: {regime}."
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


@dataclass(frozen=True, eq=False)
class PaperResults:
    """The newest results of a folder.

    Attributes:
        folder: of the results.
        contests: all that it holds.
    """

    folder: Path
    contests: tuple[Contest, ...]

    @classmethod
    def of(cls, folder: Path) -> PaperResults:
        """Read the folder that `--results` names.

        Raises:
            StoreError: it holds no results, and `bench reproduce` makes them; or a file of it is
                damaged.
        """
        if not has_results(folder):
            raise StoreError(f"--results {folder}: holds no results; {REPRODUCE} makes them")
        return cls(folder, tuple(collect(folder)))

    def of_models(self, models: Iterable[str], protocol: str) -> Found:
        """Return the results of models under a protocol, each on its own splits."""
        contest = self._contest(protocol)
        competitors: Mapping[str, Competitor] = {} if contest is None else contest.competitors
        results, failures, missing = dict[str, list[CellResult]](), dict[str, str](), list[str]()
        for model in models:
            found = competitors.get(model)
            if contest is None or found is None:
                missing.append(model)
            elif found.failures:
                first = next(iter(found.failures.values()))
                failures[model] = (
                    f"{self.folder}: {model} on {DATASET} under {protocol}: no result of "
                    f"{counted(len(found.failures), 'split')}: {first.why_none}"
                )
            else:
                results[model] = contest.results(model)
        return Found(protocol, results, failures, missing)

    def on_shared_splits(self, models: Iterable[str], protocol: str) -> Found:
        """Return the results of models on the splits that all of them have, of those that have any.

        Raises:
            StoreError: none has a result, or no split is of all.
        """
        found, contest = self.of_models(models, protocol), self._contest(protocol)
        if contest is None or not found.results:
            missing = found.missing
            why = "; ".join(found.failures.values()) or f"no result of {missing[0]}"
            if len(missing) > 1 and not found.failures:
                why += f" nor of {len(missing) - 1} others"
            raise StoreError(
                f"--results {self.folder}: nothing to print of {DATASET} under {protocol}: {why}; "
                f"{REPRODUCE} makes it"
            )
        shared = contest.shared_slots(found.results)
        if not shared:
            raise StoreError(
                f"--results {self.folder}: {', '.join(found.results)} have no split of {protocol} "
                f"in common; {FULL} makes what is missing"
            )
        any_of = {slot for model in found.results for slot in contest.competitors[model].done}
        return Found(
            protocol,
            {model: contest.results(model, shared) for model in found.results},
            found.failures,
            found.missing,
            n_left_out=len(any_of) - len(shared),
        )

    def provenance(self, shown: Iterable[Found]) -> str:
        """Return a line that names which stiffbench made the results that are shown."""
        counts = Counter(
            one.run_id for found in shown for of_model in found.results.values() for one in of_model
        )
        (line,) = sources(self.folder, list(read_manifests(self.folder)), counts)
        return line

    def _contest(self, protocol: str) -> Contest | None:
        """Return the newest contest under a protocol: other seeds and older data are others."""
        found = [
            contest
            for contest in self.contests
            if (contest.name.dataset, contest.name.protocol) == (DATASET, protocol)
            and not contest.name.condition
            and contest.name.seed == SEED
        ]
        return max(found, key=lambda contest: contest.newest_run, default=None)
