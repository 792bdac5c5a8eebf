"""Stored results of the models that a table or a figure of the paper compares."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stiff_bench.figures.figure_source import marks
from stiff_bench.paper.paper_models import DATASET, SEED
from stiff_bench.results.load import SplitId, StoredResults, split_of
from stiff_bench.results.notes import sources
from stiff_bench.results.selection import find_model
from stiff_bench.store.names import Variant
from stiff_bench.tables.units import counted, first_few
from stiff_protocols.contract.errors import ConfigError, StoreError
from stiff_protocols.contract.record import FitResult

PAPER_RESULTS = Path("results/paper/runs")
"""Folder of the results of `bench reproduce paper`."""
REPRODUCE = "`bench reproduce paper` (or `paper-quick`)"
"""The command that computes the results."""
RERUN = f"{REPRODUCE} with `--rerun failed`"
"""The command that repeats failed fits."""


@dataclass(frozen=True, eq=False)
class ProtocolResults:
    """Stored results of some models under one protocol.

    Attributes:
        protocol: its name.
        results: model -> its results, one per split. Models without results or with a failed split
            are omitted.
        failures: model -> its name, with the reason of its first failure.
        missing: models that were never run.
        n_left_out: number of splits that only some of the models have.
    """

    protocol: str
    results: dict[str, list[FitResult]]
    failures: Mapping[str, str]
    missing: Sequence[str]
    n_left_out: int = 0

    @property
    def all_fits(self) -> list[FitResult]:
        """All results, model after model."""
        return [fit for model_fits in self.results.values() for fit in model_fits]

    @property
    def setting(self) -> str:
        """Protocol, splits, seed, and the notes on the models."""
        n_splits = max(map(len, self.results.values()))
        notes = marks(fit.presentation for fit in self.all_fits)
        return f"{self.protocol}, {counted(n_splits, 'split')}, seed {SEED}.{notes}"

    def absences(self) -> Iterator[str]:
        """Yield notes on missing and failed results, with the command to compute them."""
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
            StoreError: nothing is stored (the message names the command), or a file is corrupt.
        """
        return cls.read(folder, f"; {REPRODUCE} makes the results")

    def of_models(self, models: Iterable[Variant], protocol: str) -> ProtocolResults:
        """Return the results of models, each on its own splits.

        Only the newest task under the protocol counts, not other seeds or older data.
        """
        results, failures, missing = dict[str, list[FitResult]](), dict[str, str](), list[str]()
        of_task = (DATASET, protocol, "", SEED)
        tasks = [
            task
            for task in self.tasks
            for name in [task.name]
            if (name.dataset, name.protocol, name.condition, name.seed) == of_task
        ]
        newest = [max(tasks, key=lambda task: task.newest_run)] if tasks else []
        for variant in models:
            model, stored_name = variant.name, find_model(variant, newest)
            if stored_name is None:
                missing.append(model)
                continue
            stored = newest[0].models[stored_name]
            if stored.failures:
                first = next(iter(stored.failures.values()))
                failures[model] = f"{model} ({first.why_none})"
            else:
                results[model] = list(stored.done.values())
        return ProtocolResults(protocol, results, failures, missing)

    def on_shared_splits(self, models: Iterable[Variant], protocol: str) -> ProtocolResults:
        """Return the results of models on their common splits.

        Models without results do not count.

        Raises:
            StoreError: no model has a result, or the models have no split in common.
        """
        stored = self.of_models(models, protocol)
        splits = [set(map(split_of, model_fits)) for model_fits in stored.results.values()]
        all_splits = set[SplitId]().union(*splits)
        shared = all_splits.intersection(*splits)
        if not shared:
            reason, command = f"no result of {first_few(stored.missing)}", REPRODUCE
            if stored.results:
                reason = f"no split in common of {', '.join(stored.results)}"
            elif stored.failures:
                reason, command = f"failed: {', '.join(stored.failures.values())}", RERUN
            raise StoreError(
                f"{self.folder}: nothing to print of {DATASET} under {protocol}: {reason}; "
                f"{command} makes it",
                "results",
            )
        on_shared = {
            model: [fit for fit in model_fits if split_of(fit) in shared]
            for model, model_fits in stored.results.items()
        }
        return replace(stored, results=on_shared, n_left_out=len(all_splits) - len(shared))

    def provenance(self, printed: Iterable[ProtocolResults]) -> str:
        """Return a line with the stiffbench versions that made the printed results."""
        counts = Counter(fit.run_id for results in printed for fit in results.all_fits)
        return sources(self.folder, self.runs, counts)


def named_results(folder: Path | None, what: str, *, made_of: str) -> PaperResults:
    """Return the results for a table or figure, by default from `PAPER_RESULTS`.

    `made_of` is the reason why it needs no results, such as "is fitted here"; "" if it needs them.

    Raises:
        StoreError: as in `PaperResults.of`.
        ConfigError: a folder was given, but no results are needed.
    """
    if not made_of:
        return PaperResults.of(folder or PAPER_RESULTS)
    if folder is not None:
        raise ConfigError(f"{folder}: {what} {made_of} and reads none", "results")
    return PaperResults(PAPER_RESULTS, ())
