"""Where libraries keep what they remember: in our cache, so that nothing is written elsewhere."""

from __future__ import annotations

import os

from stiff_models.cache_folder import cache_folder

_FOLDERS = {
    "DASK_CONFIG": "dask",
    "MPLCONFIGDIR": "matplotlib",
    "TORCHINDUCTOR_CACHE_DIR": "torchinductor",
}
"""Environment variable, read when the library is imported -> folder below our cache.

matplotlib would make two in the user's home, torch an empty one among the temporary files, and
dask-jobqueue puts its settings beside Dask's; a user's own are still read from where they are."""


def keep_libraries_in_our_cache() -> None:
    """Set the libraries' folders, unless the user did, or has switched the cache off."""
    folder = cache_folder()
    if folder is not None:
        for variable, name in _FOLDERS.items():
            os.environ.setdefault(variable, str(folder / name))
