"""Stored results of the paper's study, found by what they are of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from stiff_bench.paper.study import DATASET, PAPER_PROTOCOL, SEED
from stiff_bench.words import counted
from stiff_protocols.errors import StoreError

if TYPE_CHECKING:
    from stiff_bench.collected import Competitor, Contest
    from stiff_protocols.record import CellResult

PAPER_RESULTS = Path("results/paper/runs")
"""Where `bench reproduce` stores what the paper's tables and figures show."""


def paper_results(folder: Path) -> PaperResults:
    """Read the results that `--results` names.

    Raises:
        StoreError: there are none, and `bench reproduce` makes them; or a file is damaged.
    """
    from stiff_bench.store import has_results

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
        from stiff_bench.collected import collect  # late: `bench --help` needs the folder's name

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
        if found.reasons:
            n_splits = counted(len(found.reasons), "split")
            raise StoreError(
                f"{where}: no result of {n_splits}: {next(iter(found.reasons.values()))}"
            )
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
