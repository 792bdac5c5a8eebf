"""Set the number of threads of linear algebra: one, unless the user sets another.

The number affects results: sums in another order round differently, and training amplifies that.
So it depends neither on the number of cores nor on the number of cells that run in parallel.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from stiff_models.io.cache_folder import cache_folder


def usable_cores() -> int:
    """Return the number of processor cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_VARIABLES = (
    *("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"),
    "VECLIB_MAXIMUM_THREADS",
)
"""Environment variables that the libraries read when they are loaded."""


def pinned(number: int | None = None) -> int:
    """Set and return the number of threads of every library and of child processes.

    None: OMP_NUM_THREADS, or 1.
    """
    setting = os.environ.get("OMP_NUM_THREADS", "")
    threads = number or (int(setting) if setting.isdecimal() and int(setting) > 0 else 1)
    os.environ.update(dict.fromkeys(_VARIABLES, str(threads)))
    if "numpy" in sys.modules:
        from threadpoolctl import threadpool_limits

        threadpool_limits(threads)
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(threads)
    return threads


_FOLDERS = {
    "DASK_CONFIG": "dask",
    "MPLCONFIGDIR": "matplotlib",
    "TORCHINDUCTOR_CACHE_DIR": "torchinductor",
}
"""Environment variable, read when the library is imported -> folder below our cache.

Otherwise matplotlib makes two folders in the user's home, torch an empty temporary folder, and
dask-jobqueue adds its settings to Dask's. A user's own settings are still read."""


def keep_libraries_in_our_cache() -> None:
    """Set the libraries' folders, unless the user did or our cache cannot be written."""
    folder = cache_folder()
    if folder is not None and _can_write(folder):
        for variable, name in _FOLDERS.items():
            os.environ.setdefault(variable, str(folder / name))


def _can_write(folder: Path) -> bool:
    """Check the folder, or the nearest parent that exists, for write permission."""
    existing = next(path for path in (folder, *folder.parents) if os.path.exists(path))
    return existing.is_dir() and os.access(existing, os.W_OK)


def prepare() -> None:
    """Set the variables that libraries read when they are loaded, unless the user did."""
    # Read by OpenMP when torch is imported. Threads that spin while they wait make small networks
    # a hundred times slower as soon as another process wants their core.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ["PYTHONSAFEPATH"] = "1"  # no Python that we start imports from the working directory
    keep_libraries_in_our_cache()
    pinned()
