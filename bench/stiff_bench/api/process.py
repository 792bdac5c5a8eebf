"""What a process of the command line is told before libraries are loaded: threads and folders."""

from __future__ import annotations

import os

from stiff_bench.run.machine import keep_libraries_in_our_cache, pin_threads, threads_asked_for


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
