"""Describe the environment of a run: everything that can change a number."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import entry_points, requires
from pathlib import Path

from threadpoolctl import threadpool_info

from stiff_bench.plan.cells import installed
from stiff_bench.plan.registry import plugin_files
from stiff_bench.run.machine import usable_cores

LIBRARIES = ("numpy", "scipy", "scikit-learn", "torch", "pin")
"""Libraries whose version can change numbers."""
_OURS = "stiffbench"
_NOT_LOADED = "not loaded"
_VARIABLES = re.compile(
    r"(OMP|GOMP|KMP|MKL|OPENBLAS|BLIS|ONEDNN|DNNL|ATEN|TORCH|PYTORCH|CUDA|CUBLAS|NVIDIA|STIFFBENCH)"
    r"_\w+|PYTHONHASHSEED|PYTHONOPTIMIZE"
)
"""Environment variables that our libraries read."""
_DEVELOPERS = re.compile(r"""extra\s*==\s*['"](dev|perf)['"]""")


def environment() -> dict[str, str]:
    """Return versions, processor, libraries, threads, plugins, commit and its state.

    torch is described only if a model has loaded it.
    """
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": str(usable_cores()),
        "threads": os.environ.get("OMP_NUM_THREADS", "default"),
        "libraries": "; ".join(sorted(_libraries())),
        **_torch(),
        **{name: os.environ[name] for name in sorted(os.environ) if _VARIABLES.fullmatch(name)},
        **{name: installed(name) for name in (_OURS, *sorted(_dependencies()))},
        "plugins": "; ".join(sorted(_plugins())),
        **_commit(),
    }


def _libraries() -> Iterator[str]:
    """Yield every BLAS and OpenMP library of the process with its version and threads."""
    for library in threadpool_info():
        details = (library["version"], library.get("threading_layer"), library.get("architecture"))
        words = " ".join(word for word in (library["internal_api"], *details) if word)
        yield f"{words} ({Path(library['filepath']).name}), threads {library['num_threads']}"


def _torch() -> dict[str, str]:
    """Return torch's threads, its arithmetic and the GPU ("": no GPU)."""
    torch = sys.modules.get("torch")
    if torch is None:
        return {"gpu": "", "torch threads": _NOT_LOADED, "torch arithmetic": _NOT_LOADED}
    arithmetic = {"capability": torch.backends.cpu.get_cpu_capability()}
    if (ours := sys.modules.get("stiff_models.device")) is not None:
        arithmetic["bfloat16"] = ours.has_fast_bfloat16(torch.device("cpu"))
        arithmetic["medium is float32"] = ours.medium_is_float32()
    return {
        "gpu": str(torch.cuda.get_device_name()) if torch.cuda.is_available() else "",
        "torch threads": str(torch.get_num_threads()),
        "torch arithmetic": ", ".join(f"{name} {value}" for name, value in arithmetic.items()),
    }


def _dependencies() -> set[str]:
    """Return the names of required and optional packages of stiffbench."""
    requirements = (line for line in requires(_OURS) or () if not _DEVELOPERS.search(line))
    return {re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in requirements} - {_OURS}


def _plugins() -> Iterator[str]:
    """Yield every `--plugin` file with its sha256, and every installed plugin with its version."""
    for file in plugin_files():
        yield f"{file} sha256 {hashlib.sha256(file.read_bytes()).hexdigest()}"
    for kind in ("models", "datasets", "protocols"):
        for point in entry_points(group=f"{_OURS}.{kind}"):
            if point.dist is not None:
                yield f"{point.dist.name} {point.dist.version} ({point.group}: {point.name})"


def _processor() -> str:
    with suppress(OSError):
        if match := re.search(r"^model name\s*: *(.+)", Path("/proc/cpuinfo").read_text(), re.M):
            return match[1].strip()
    return platform.processor() or "unknown"


def _commit() -> dict[str, str]:
    """Return the commit of the checkout; empty if stiffbench is installed without Git."""
    words = ("status", "--porcelain=v2", "--branch", "--untracked-files=no")
    try:
        status_lines = subprocess.run(
            ["git", "-C", str(Path(__file__).resolve().parent), *words],
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        ).stdout.splitlines()
    except (OSError, subprocess.SubprocessError):
        return {"commit": "", "dirty": ""}
    commit = "".join(line.split()[2] for line in status_lines if line.startswith("# branch.oid "))
    return {"commit": commit, "dirty": str(any(line[0] != "#" for line in status_lines)).lower()}
