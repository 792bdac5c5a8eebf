"""The leaderboard of a folder of results, and where its numbers come from."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from stiff_bench.collected import chosen_contests, collect
from stiff_bench.leaderboard import Leaderboard, build_leaderboard
from stiff_bench.result_source import sources
from stiff_bench.sort_key import SortKey
from stiff_bench.store import read_manifests


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
    with _no_garbage_collection():
        contests = collect(folder)
        runs = list(read_manifests(folder))
        board = build_leaderboard(
            chosen_contests(contests, datasets=datasets, protocols=protocols),
            models=models,
            key=key,
            folder=folder,
            asked={cell for run in runs for cell in run.cells},
            seed=seed,
        )
    n_counting = sum(contest.n_results for contest in contests)
    counting = f"{n_counting} results of the folder count."
    return board, (counting, *sources(folder, runs, board.run_ids))


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Look for no garbage among a million records, none of which is any: a quarter of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
