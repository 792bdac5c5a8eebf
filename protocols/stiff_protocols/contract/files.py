"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stiff_protocols.contract.errors import DataError, StiffBenchError, StoreError


def make_folder(folder: Path) -> None:
    """Make a folder for output, with its parents; StoreError where that cannot be done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "it is a file" if folder.is_file() else error.strerror or error
        raise StoreError(f"{folder}: cannot create this folder: {reason}") from error


def check_new_file(path: Path) -> None:
    """See that a file of data is a new one in a folder that is there, before the work is done.

    Raises:
        StoreError: it exists, or its folder does not.
    """
    if path.exists():
        raise StoreError(
            f"{path}: exists and is not overwritten; give another name, or delete it first"
        )
    if not path.parent.is_dir():
        raise StoreError(f"{path}: cannot be written: there is no folder {path.parent}")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give the path of a temporary file beside `path`; rename it to `path` at the end.

    Readers see the old file or the new one, never a part, after a power cut too. After an error or
    an exception that stops the program, the old one stands and nothing else is left. StoreError:
    the file cannot be written.
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


LARGEST = 2**16
"""Bytes; `tomllib` takes the square of a long dotted key's parts."""


def read_toml(
    path: Path, *, named: str = "", error: type[StiffBenchError] = DataError
) -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: of the file.
        named: how the error names it; "": by its path.
        error: that is raised where it cannot be read, or is no TOML, or larger than any settings.
    """
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise ValueError(f"larger than {LARGEST} bytes")
        return tomllib.loads(content.decode())
    except OSError as problem:
        reason = problem.strerror or problem
        raise error(f"{named or path}: cannot be read: {reason}") from problem
    except RecursionError as problem:
        raise error(f"{named or path}: not TOML: nested too deeply") from problem
    except ValueError as problem:
        raise error(f"{named or path}: not TOML: {problem}") from problem
