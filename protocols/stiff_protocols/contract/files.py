"""Write files completely or not at all, and read settings."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stiff_protocols.contract.errors import DataError, StiffBenchError, StoreError


def make_folder(folder: Path) -> None:
    """Create an output folder with its parents; StoreError if that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "it is a file" if folder.is_file() else error.strerror or error
        raise StoreError(f"{folder}: cannot create this folder: {reason}") from error


def check_new_file(path: Path) -> None:
    """Raise StoreError, before the work, if a data file exists or its folder does not."""
    if path.exists():
        raise StoreError(
            f"{path}: exists and is not overwritten; give another name, or delete it first"
        )
    if not path.parent.is_dir():
        raise StoreError(
            f"{path}: cannot be written: the folder {path.parent} does not exist; create it first"
        )


def other_content(text: str) -> str:
    """Return what was saved in place of a file, and the next step, from its first text; or ""."""
    start = text.lstrip("\ufeff\u00ef\u00bb\u00bf \t\r\n")[:100].lower()
    if start.startswith("version https://git-lfs"):
        return "a Git LFS pointer to the file; run: git lfs pull"
    if start.startswith(("<!doctype html", "<html")):
        web_page = "a web page, saved in place of the file; download the file itself"
        return f"{web_page} (on GitHub: Raw)"
    return ""


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield the path of a temporary file next to `path`; rename it to `path` at the end.

    Readers see the old file or the new file, never a part, even after a power cut. After an error
    or an exception that stops the program, only the old file is left. StoreError: the file cannot
    be written.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        temporary.touch()
        yield temporary
        with temporary.open("rb+") as file:  # on the disk before it has the name
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def read_toml(
    path: Path, *, named: str = "", error: type[StiffBenchError] = DataError
) -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: path of the file.
        named: name of the file in the error; "": its path.
        error: error to raise if the file cannot be read, or is not TOML.
    """
    try:
        return tomllib.loads(path.read_bytes().decode())
    except OSError as problem:
        reason = problem.strerror or problem
        raise error(f"{named or path}: cannot be read: {reason}") from problem
    except ValueError as problem:
        raise error(f"{named or path}: not TOML: {problem}") from problem
