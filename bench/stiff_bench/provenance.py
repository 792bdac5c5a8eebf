"""Where a run came from: everything beside the cells that can change a number."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from stiff_bench.cores import usable_cores

_PACKAGES = ("stiffbench", "numpy", "scipy", "scikit-learn", "torch", "pin", "pandas")


def environment() -> dict[str, str]:
    """Return versions, processor, threads, commit and whether the tree was dirty."""
    facts = {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": str(usable_cores()),
        "threads": os.environ.get("OMP_NUM_THREADS", "default"),
        "gpu": _gpu(),
    }
    for package in _PACKAGES:
        try:
            facts[package] = version(package)
        except PackageNotFoundError:
            facts[package] = "not installed"
    return facts | _commit()


def _gpu() -> str:
    """Return the GPU that networks can use; "" without one, or where no model needs torch."""
    torch = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_available():
        return ""
    return str(torch.cuda.get_device_name())


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        return platform.processor() or "unknown"
    return platform.processor() or "unknown"


def _commit() -> dict[str, str]:
    """Return the checkout's commit; empty where stiffbench is installed without one."""
    here = Path(__file__).resolve().parent
    try:
        commit = _git(here, "rev-parse", "HEAD")
        dirty = _git(here, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return {"commit": "", "dirty": ""}
    return {"commit": commit, "dirty": str(bool(dirty)).lower()}


def _git(folder: Path, *words: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(folder), *words], capture_output=True, text=True, check=True, timeout=10
    )
    return done.stdout.strip()
