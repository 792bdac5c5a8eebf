"""Stored results of the models that a table or a figure of the paper compares."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stiff_bench.analysis.collected import StoredResults
from stiff_bench.analysis.selection import find_model
from stiff_bench.figures.figure_source import marks
from stiff_bench.paper.paper_models import DATASET, SEED
from stiff_bench.store.names import Variant
from stiff_bench.store.newest import Slot, slot_of
from stiff_bench.store.versions import sources
from stiff_bench.tables.units import counted, first_few
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.record import CellResult

PAPER_RESULTS = Path("results/paper/runs")
"""Where `bench reproduce paper` stores what the paper's tables and figures show."""
REPRODUCE = "`bench reproduce paper` (or `paper-quick`)"
"""The command that makes results."""
RERUN = f"{REPRODUCE} with `--rerun failed`"
"""The same, which tries again what failed."""


@dataclass(frozen=True, eq=False)
class Found:
    """Stored results of some models under one protocol.

    Attributes:
        protocol: its name.
        results: model -> its results, one a split; none of models that have none, or failed on one.
        failures: model -> its name, with the reason why it has no numbers though it was run.
        missing: models that were never run.
        n_left_out: splits on which some of the models have a result, and others do not.
    """

    protocol: str
    results: dict[str, list[CellResult]]
    failures: Mapping[str, str]
    missing: Sequence[str]
    n_left_out: int = 0

    @property
    def each(self) -> list[CellResult]:
        """All results, model after model."""
        return [one for of_model in self.results.values() for one in of_model]

    @property
    def setting(self) -> str:
        """Protocol, splits and seed, and what must be read with the models."""
        n_splits = max(map(len, self.results.values()))
        with_them = marks(one.shown for one in self.each)
        return f"{self.protocol}, {counted(n_splits, 'split')}, seed {SEED}.{with_them}"

    def absences(self) -> Iterator[str]:
        """Yield what is missing or failed, and the command that makes it."""
        if self.n_left_out:
            yield (
                f"Left out: {counted(self.n_left_out, 'split')} of {self.protocol} that only some "
                f"of the models have; {REPRODUCE} makes the others'."
            )
        if self.failures:
            reasons = ", ".join(self.failures.values())
            yield f"Failed under {self.protocol}: {reasons}; {RERUN} computes it again."
        if self.missing:
            names = first_few(self.missing)
            yield f"Without a result under {self.protocol}: {names}; {REPRODUCE} makes it."


@dataclass(frozen=True, eq=False)
class PaperResults(StoredResults):
    """Results of a folder, by model and protocol of the paper."""

    @classmethod
    def of(cls, folder: Path) -> PaperResults:
        """Read a folder.

        Raises:
            StoreError: it holds no results, and `bench reproduce` makes them; or a file of it is
                corrupt.
        """
        return cls.read(folder, f"; {REPRODUCE} makes the results")

    def of_models(self, models: Iterable[Variant], protocol: str) -> Found:
        """Return the results of models, which have defaults too, each on its own splits.

        They are of the newest case under the protocol: other seeds and older data are others.
        """
        results, failures, missing = dict[str, list[CellResult]](), dict[str, str](), list[str]()
        of_case = (DATASET, protocol, "", SEED)
        cases = [
            case
            for case in self.cases
            for name in [case.name]
            if (name.dataset, name.protocol, name.condition, name.seed) == of_case
        ]
        newest = [max(cases, key=lambda case: case.newest_run)] if cases else []
        for variant in models:
            model, stored_name = variant.name, find_model(variant, newest)
            if stored_name is None:
                missing.append(model)
                continue
            competitor = newest[0].competitors[stored_name]
            if competitor.failures:
                first = next(iter(competitor.failures.values()))
                failures[model] = f"{model} ({first.why_none})"
            else:
                results[model] = list(competitor.done.values())
        return Found(protocol, results, failures, missing)

    def on_shared_splits(self, models: Iterable[Variant], protocol: str) -> Found:
        """Return the results of models on the splits that all of them have, of those that have any.

        Raises:
            StoreError: none has a result, or no split is of all.
        """
        found = self.of_models(models, protocol)
        slots = [set(map(slot_of, of_model)) for of_model in found.results.values()]
        any_of = set[Slot]().union(*slots)
        shared = any_of.intersection(*slots)
        if not shared:
            why, command = f"no result of {first_few(found.missing)}", REPRODUCE
            if found.results:
                why = f"no split in common of {', '.join(found.results)}"
            elif found.failures:
                why, command = f"failed: {', '.join(found.failures.values())}", RERUN
            raise StoreError(
                f"{self.folder}: nothing to print of {DATASET} under {protocol}: {why}; "
                f"{command} makes it",
                "results",
            )
        on_shared = {
            model: [one for one in of_model if slot_of(one) in shared]
            for model, of_model in found.results.items()
        }
        return replace(found, results=on_shared, n_left_out=len(any_of) - len(shared))

    def provenance(self, shown: Iterable[Found]) -> str:
        """Return a line that names which stiffbench made the results that are shown."""
        counts = Counter(one.run_id for found in shown for one in found.each)
        return sources(self.folder, self.runs, counts)


def named_results(folder: Path | None, what: str, *, made_of: str) -> PaperResults:
    """Return the results that something is made of; no folder: where `bench reproduce` puts them.

    `made_of` says why it needs none of them, such as "is fitted here"; "": it does.

    Raises:
        StoreError: as `PaperResults.of`.
        ConfigError: a folder was named that is not read.
    """
    if not made_of:
        return PaperResults.of(folder or PAPER_RESULTS)
    if folder is not None:
        raise ConfigError(f"{folder}: {what} {made_of} and reads none", "results")
    return PaperResults(PAPER_RESULTS, ())
