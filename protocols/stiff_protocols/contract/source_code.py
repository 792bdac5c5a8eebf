"""Hash the files of a plugin's model, so that changed code gives another result.

Built-in models have a version instead (`ModelInfo.version`), which a golden test checks.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from functools import cache
from modulefinder import ModuleFinder
from pathlib import Path

_NO_FILES_OF = {
    *("builtins", "abc", "typing", "numpy", "scipy", "sklearn", "torch"),
    *("stiff_bench", "stiff_datasets", "stiff_models", "stiff_protocols"),
}
"""Top-level packages whose files are not read: libraries and stiffbench."""


def code_of(*classes: type) -> str:
    """Return a hash of the files of a plugin's classes; "" for built-in classes.

    It covers the whole package of each class and of each of its bases. Without a package it covers
    the file, with the files of the same folder that it imports. An editable install keeps its
    version while its code changes. The hash does not depend on the process's history. A script
    from standard input or a notebook has no file: results of its classes cannot be stored.
    """
    modules = {base.__module__ for cls in classes for base in cls.__mro__}
    roots: set[Path] = set()
    for name in modules:
        file = getattr(sys.modules.get(name), "__file__", None)
        if name == "__main__" and not is_script_file(file):
            continue
        if name.partition(".")[0] not in _NO_FILES_OF and file is not None:
            roots |= _with_neighbours(_root(Path(file)))
    return _hash(sorted(map(code_below, roots))) if roots else ""


def is_script_file(file: str | None) -> bool:
    """Return whether the `__file__` of `__main__` is a file; "<stdin>" is not."""
    return file is not None and Path(file).is_file()


def code_below(root: Path) -> str:
    """Return a hash of a file, or of every Python file of a folder with its relative path."""
    if root.is_file():
        return file_code(root)
    files = sorted(
        (path.relative_to(root).as_posix(), path)
        for path in root.rglob("*.py")
        if path.is_file() and not path.name.startswith(".")  # such as an editor's lock
    )
    return _hash(f"{place} {file_code(path)}" for place, path in files)


def imported_files(file: Path) -> set[Path]:
    """Return a plugin file with the files and packages of its folder that it imports."""
    roots = _with_neighbours(file)
    below = (root.rglob("*.py") if root.is_dir() else [root] for root in roots)
    return {path for paths in below for path in paths if not path.name.startswith(".")}


def file_code(path: Path) -> str:
    """Return a hash of one file."""
    state = path.stat()
    return _code_of_state(path, state.st_mtime_ns, state.st_size)


@cache
def _code_of_state(path: Path, _mtime_ns: int, _size: int) -> str:
    """Return the hash of a file; the file is read again if it was changed."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _root(file: Path) -> Path:
    """Return the outermost package of a file; the file itself without a package."""
    root = file
    while (root.parent / "__init__.py").is_file():
        root = root.parent
    return root


def _with_neighbours(root: Path) -> set[Path]:
    """Return a package, or a file with the files and packages of its folder that it imports."""
    if root.is_dir():
        return {root}
    finder = ModuleFinder(path=[str(root.parent)])  # reads the files, and runs none
    try:
        finder.run_script(str(root))
    except (SyntaxError, ValueError):  # no Python: an extension module
        return {root}
    files = (getattr(module, "__file__", None) for module in finder.modules.values())
    return {root, *(_root(Path(file)) for file in files if file is not None)}


def _hash(texts: Iterable[str]) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()
