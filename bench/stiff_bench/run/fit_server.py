"""Imported by the server that forks the fits' processes, which it makes answerable for all of them.

The server adopts what a fit's process leaves behind. It ends with the run's process, however that
ended, and then kills all that is below it and deletes the fits' folders (Linux).
"""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import sys
import tempfile
import warnings
from pathlib import Path

from stiff_bench.run.fit_process import (
    ADOPT_ORPHANS,
    SIGNAL_AT_END_OF_PARENT,
    end_all_below,
    prctl,
)

SERVER = "multiprocessing.forkserver"
"""A word of the server's command line."""


def folder_prefix(run: int) -> str:
    """Return how the names of the folders begin that the fits of a run's process have."""
    return f"bench-{run}-"


def _end(*_: object) -> None:
    end_all_below()
    for folder in Path(tempfile.gettempdir()).glob(f"{folder_prefix(_RUN)}*"):
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


_RUN = os.getppid()
if any(SERVER in word for word in sys.orig_argv):
    prctl(ADOPT_ORPHANS, 1)
    prctl(SIGNAL_AT_END_OF_PARENT, signal.SIGTERM)
    signal.signal(signal.SIGTERM, _end)
    atexit.register(_end)
    warnings.filterwarnings("ignore", "forkserver: waitpid returned unexpected pid")  # an orphan
