"""How many processor cores there are: asked at every start, so that nothing else is imported."""

from __future__ import annotations

import os


def usable_cores() -> int:
    """Return the number of processor cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
