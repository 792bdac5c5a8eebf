"""Which code computes a result: hashes of source files, so that other code is another result."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

LIBRARIES = ("numpy", "scipy", "scikit-learn", "torch", "pin")
"""Distributions that the numbers go through; their versions stand for their files."""
_NO_FILES_OF = {"builtins", "abc", "typing", "numpy", "scipy", "sklearn", "torch"}
"""Top-level names of classes' bases whose files are not read: the interpreter's and libraries'."""


def code_of(*classes: type, files: Iterable[Path] = ()) -> str:
    """Return a hash of the code that objects of these classes run, and of further files.

    It covers the whole package of each class and of each of its bases (the file alone where it is
    in no package), stiff_protocols with its metrics, and the versions of `LIBRARIES`. It depends
    on nothing else that the process did before.
    """
    modules = {base.__module__ for cls in classes for base in cls.__mro__} | {__name__}
    roots = {
        _root(Path(file))
        for name in modules
        if name.partition(".")[0] not in _NO_FILES_OF
        and (file := getattr(sys.modules.get(name), "__file__", None)) is not None
    }
    return _hash([library_versions(), *sorted(map(code_below, roots)), *map(file_code, files)])


def code_below(root: Path) -> str:
    """Return a hash of a file, or of every Python file of a folder with its place in there."""
    if root.is_file():
        return file_code(root)
    files = sorted((path.relative_to(root).as_posix(), path) for path in root.rglob("*.py"))
    return _hash(f"{place} {file_code(path)}" for place, path in files)


def file_code(path: Path) -> str:
    """Return a hash of one file."""
    state = path.stat()
    return _code_of_state(path, state.st_mtime_ns, state.st_size)


@cache
def _code_of_state(path: Path, _mtime_ns: int, _size: int) -> str:
    """Return a hash of a file as it stands now; it is read anew where it was changed."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@cache
def library_versions() -> str:
    """Return the versions of `LIBRARIES`, as one text."""
    return ", ".join(f"{name} {_version(name)}" for name in LIBRARIES)


def _root(file: Path) -> Path:
    """Return the outermost package that a file is in; the file itself where it is in none."""
    root = file
    while (root.parent / "__init__.py").is_file():
        root = root.parent
    return root


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed"


def _hash(texts: Iterable[str]) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()
