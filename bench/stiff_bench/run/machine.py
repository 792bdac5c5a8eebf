"""How many threads the linear algebra of a process uses: one, unless the user says otherwise.

The number shapes results: sums of another order round otherwise, and a training amplifies that. So
it does not depend on how many cores there are, nor on how many cells run side by side.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from stiff_models.io.training_cache import cache_folder


def usable_cores() -> int:
    """Return the number of processor cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_VARIABLES = (
    *("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"),
    "VECLIB_MAXIMUM_THREADS",
)
"""Read by the libraries when they are loaded."""


def pin_threads(number: int) -> None:
    """Give this number of threads to every library, loaded or not, and to child processes."""
    os.environ.update(dict.fromkeys(_VARIABLES, str(number)))
    if "numpy" in sys.modules:
        from threadpoolctl import threadpool_limits

        threadpool_limits(number)
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(number)


def threads_asked_for() -> int:
    """Return what the environment says, or one."""
    said = os.environ.get("OMP_NUM_THREADS", "")
    return int(said) if said.isdecimal() and int(said) > 0 else 1


_FOLDERS = {
    "DASK_CONFIG": "dask",
    "MPLCONFIGDIR": "matplotlib",
    "TORCHINDUCTOR_CACHE_DIR": "torchinductor",
}
"""Environment variable, read when the library is imported -> folder below our cache.

matplotlib would make two in the user's home, torch an empty one among the temporary files, and
dask-jobqueue puts its settings beside Dask's; a user's own are still read from where they are."""


def keep_libraries_in_our_cache() -> None:
    """Set the libraries' folders, unless the user did, or our cache is off or cannot be written."""
    folder = cache_folder()
    if folder is not None and _can_write(folder):
        for variable, name in _FOLDERS.items():
            os.environ.setdefault(variable, str(folder / name))


def _can_write(folder: Path) -> bool:
    """Check the folder, or the nearest parent that exists, for write permission."""
    existing = next(path for path in (folder, *folder.parents) if os.path.exists(path))
    return existing.is_dir() and os.access(existing, os.W_OK)
