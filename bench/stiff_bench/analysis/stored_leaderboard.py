"""The leaderboard of a folder of results, and where its numbers come from."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from stiff_bench.analysis.collected import Contest, chosen_contests, collect
from stiff_bench.analysis.leaderboard import Leaderboard, build_leaderboard
from stiff_bench.analysis.sort_key import SortKey
from stiff_bench.store.database import read_manifests
from stiff_bench.store.versions import sources
from stiff_protocols.contract.record import RunManifest


@dataclass(frozen=True, eq=False)
class StoredResults:
    """What a folder of results holds.

    Attributes:
        folder: that was read.
        contests: all of its results, sorted.
        runs: whose manifests it holds.
    """

    folder: Path
    contests: tuple[Contest, ...]
    runs: tuple[RunManifest, ...]

    @classmethod
    def read(cls, folder: Path) -> StoredResults:
        """Read a folder.

        Raises:
            StoreError: it holds no results, or a file of it is damaged.
        """
        with _no_garbage_collection():
            return cls(folder, tuple(collect(folder)), tuple(read_manifests(folder)))

    def board_of(
        self, contests: Sequence[Contest], *, models: Sequence[str], key: SortKey, seed: int
    ) -> Leaderboard:
        """Return the leaderboard of some of its contests; see `build_leaderboard`."""
        asked = {cell for run in self.runs for cell in run.cells}
        with _no_garbage_collection():
            return build_leaderboard(
                contests, models=models, key=key, folder=self.folder, asked=asked, seed=seed
            )

    def provenance(self, board: Leaderboard | None) -> tuple[str, ...]:
        """Return how many results count and, of those on a board, which stiffbench made them."""
        n_counting = sum(contest.n_results for contest in self.contests)
        counting = f"{n_counting} results of the folder count."
        n_failed = sum(
            len(one.failures) for contest in self.contests for one in contest.competitors.values()
        )
        if n_failed:
            counting += f" {n_failed} of them failed or were skipped."
        ranked = () if board is None else sources(self.folder, self.runs, board.run_ids)
        return (counting, *ranked)


def stored_leaderboard(
    folder: Path,
    *,
    models: Sequence[str] = (),
    datasets: Sequence[str] = (),
    protocols: Sequence[str] = (),
    key: SortKey,
    seed: int = 0,
) -> tuple[Leaderboard, tuple[str, ...]]:
    """Return the leaderboard of a folder, and lines that say which stiffbench made its results.

    Args:
        folder: of the results.
        models: names, or keys that stand for all their variants; none: all.
        datasets: the same.
        protocols: the same.
        key: what to rank by.
        seed: of the draws of poses.

    Raises:
        ConfigError: a name has no results, or there is nothing to compare.
        StoreError: the folder holds no results, or a file of it is damaged.
    """
    stored = StoredResults.read(folder)
    chosen = chosen_contests(stored.contests, datasets=datasets, protocols=protocols)
    board = stored.board_of(chosen, models=models, key=key, seed=seed)
    return board, stored.provenance(board)


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Look for no garbage among a million records, none of which is any: a quarter of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()  # nor later
        if enabled:
            gc.enable()
