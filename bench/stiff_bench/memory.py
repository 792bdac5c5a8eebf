"""How much memory this process takes: of a run, and of a fit inside it."""

from __future__ import annotations

import re
import sys
from pathlib import Path


class _Highest:
    """The highest peak before the kernel was last told to forget it, bytes."""

    seen = 0


def peak_memory_bytes() -> int:
    """Return the largest resident memory of this process so far; 0 where it is not known."""
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max(_Highest.seen, peak if sys.platform == "darwin" else peak * 1024)


class MemoryMeter:
    """Says how far the resident memory of this process rises; on Linux alone."""

    def __init__(self) -> None:
        """Start anew: the kernel forgets the peak so far, which `peak_memory_bytes` remembers."""
        self._start: int | None = None
        _Highest.seen = peak_memory_bytes()
        try:
            Path("/proc/self/clear_refs").write_text("5")  # proc(5): resets VmHWM
            self._start = _status("VmRSS")
        except OSError:
            return

    def rise(self) -> int | None:
        """Return the peak since the start above the start, bytes; None where it is not known."""
        return None if self._start is None else max(0, _status("VmHWM") - self._start)


def _status(name: str) -> int:
    """Return an entry of /proc/self/status, bytes."""
    found = re.search(rf"^{name}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(found.group(1)) * 1024 if found else 0
