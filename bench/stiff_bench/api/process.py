"""What a process is told before libraries are loaded, and the cache that processes share."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from stiff_bench.run.machine import keep_libraries_in_our_cache, pin_threads, threads_asked_for

if TYPE_CHECKING:
    from stiff_models.io.training_cache import CacheInfo


def prepare() -> None:
    """Set what libraries read when they are loaded, unless the user did."""
    # Read by OpenMP when torch is imported. Threads that spin while they wait make small networks
    # a hundred times slower as soon as another process wants their core.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ["PYTHONSAFEPATH"] = "1"  # no Python that we start imports from the working directory
    keep_libraries_in_our_cache()
    pinned()


def pinned(number: int | None = None) -> int:
    """Give a number of threads to every library, and return it; None: that of the environment."""
    threads = number or threads_asked_for()
    pin_threads(threads)
    return threads


def cache_info() -> CacheInfo:
    """Return how many pre-trained networks the cache holds, and where."""
    from stiff_models.io import training_cache

    return training_cache.cache_info()


def clear_cache() -> CacheInfo:
    """Delete every pre-trained network, and return what there was."""
    from stiff_models.io import training_cache

    return training_cache.clear_cache()
