"""This process and its machine: threads, memory, and everything that can change a number.

Linear algebra has one thread, unless the user sets another number. The number affects results: sums
in another order round differently, and training amplifies that. So it depends neither on the number
of cores nor on the number of fits that run in parallel.
"""

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

from stiff_models.io.cache_folder import cache_folder

LIBRARIES = ("numpy", "scipy", "scikit-learn", "torch", "pin")
"""Libraries whose version can change numbers."""
_OURS = "stiffbench"
_NOT_LOADED = "not loaded"
_THREADS = (
    *("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"),
    "VECLIB_MAXIMUM_THREADS",
)
"""Environment variables that the libraries read when they are loaded."""
_VARIABLES = re.compile(
    r"(OMP|GOMP|KMP|MKL|OPENBLAS|BLIS|ONEDNN|DNNL|ATEN|TORCH|PYTORCH|CUDA|CUBLAS|NVIDIA|STIFFBENCH)"
    r"_\w+|PYTHONHASHSEED|PYTHONOPTIMIZE"
)
"""Environment variables that our libraries read."""
_DEVELOPERS = re.compile(r"""extra\s*==\s*['"](dev|perf)['"]""")
_FOLDERS = {
    "DASK_CONFIG": "dask",
    "MPLCONFIGDIR": "matplotlib",
    "TORCHINDUCTOR_CACHE_DIR": "torchinductor",
}
"""Environment variable, read when the library is imported -> folder below our cache.

Otherwise matplotlib makes two folders in the user's home, torch an empty temporary folder, and
dask-jobqueue adds its settings to Dask's. A user's own settings are still read."""


def prepare() -> None:
    """Set the variables that libraries read when they are loaded, unless the user did."""
    # Read by OpenMP when torch is imported. Threads that spin while they wait make small networks
    # a hundred times slower as soon as another process wants their core.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ["PYTHONSAFEPATH"] = "1"  # no Python that we start imports from the working directory
    keep_libraries_in_our_cache()
    pinned()


def pinned(number: int | None = None) -> int:
    """Set and return the number of threads of every library and of child processes.

    None: OMP_NUM_THREADS, or 1.
    """
    setting = os.environ.get("OMP_NUM_THREADS", "")
    threads = number or (int(setting) if setting.isdecimal() and int(setting) > 0 else 1)
    os.environ.update(dict.fromkeys(_THREADS, str(threads)))
    if "numpy" in sys.modules:
        from threadpoolctl import threadpool_limits

        threadpool_limits(threads)
    if (torch := sys.modules.get("torch")) is not None:
        torch.set_num_threads(threads)
    return threads


def keep_libraries_in_our_cache() -> None:
    """Set the libraries' folders, unless the user did or our cache cannot be written."""
    folder = cache_folder()
    if folder is None:
        return
    existing = next(path for path in (folder, *folder.parents) if os.path.exists(path))
    if existing.is_dir() and os.access(existing, os.W_OK):
        for variable, name in _FOLDERS.items():
            os.environ.setdefault(variable, str(folder / name))


def usable_cores() -> int:
    """Return the number of processor cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def peak_memory_bytes() -> int:
    """Return the largest resident memory of this process so far; 0 if unknown."""
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max(MemoryMeter.highest, peak if sys.platform == "darwin" else peak * 1024)


class MemoryMeter:
    """Measure by how much the resident memory of this process rises (only on Linux)."""

    highest = 0
    """Peak before the kernel's counter was last reset, bytes."""

    def __init__(self) -> None:
        """Reset the kernel's peak; `peak_memory_bytes` keeps the highest so far."""
        self._start: int | None = None
        MemoryMeter.highest = peak_memory_bytes()
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")  # proc(5): resets VmHWM
            self._start = _status("VmRSS")

    def rise(self) -> int | None:
        """Return the rise from the start to the peak since then, bytes; None if unknown."""
        return None if self._start is None else max(0, _status("VmHWM") - self._start)


def _status(name: str) -> int:
    """Return an entry of /proc/self/status, bytes."""
    entry = re.search(rf"^{name}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(entry.group(1)) * 1024 if entry else 0


def environment() -> dict[str, str]:
    """Return versions, processor, libraries, threads, plugins, commit and its state.

    torch is described only if a model has loaded it.
    """
    from stiff_bench.plan.fits import installed  # needs numpy, for which threads are set first

    requirements = (line for line in requires(_OURS) or () if not _DEVELOPERS.search(line))
    packages = {re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in requirements} - {_OURS}
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": str(usable_cores()),
        "threads": os.environ.get("OMP_NUM_THREADS", "default"),
        "libraries": "; ".join(sorted(_libraries())),
        **_torch(),
        **{name: os.environ[name] for name in sorted(os.environ) if _VARIABLES.fullmatch(name)},
        **{name: installed(name) for name in (_OURS, *sorted(packages))},
        "plugins": "; ".join(sorted(_plugins())),
        **_commit(),
    }


def _libraries() -> Iterator[str]:
    """Yield every BLAS and OpenMP library of the process with its version and threads."""
    from threadpoolctl import threadpool_info

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


def _plugins() -> Iterator[str]:
    """Yield every `--plugin` file with its sha256, and every installed plugin with its version."""
    from stiff_bench.plan.registry import plugin_files

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
