"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import tempfile
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
        raise StoreError(f"{folder}: cannot be made: {reason}") from error


def check_new_file(path: Path) -> None:
    """See that a file of data is a new one in a folder that is there, before the work is done.

    Raises:
        StoreError: it exists, or its folder does not.
    """
    if path.exists():
        raise StoreError(
            f"{path}: exists, and nothing is written over it; give the name of a new file"
        )
    if not path.parent.is_dir():
        raise StoreError(f"{path}: cannot be written: no folder {path.parent}")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give the path of a temporary file beside `path`; rename it to `path` at the end.

    Readers see the old file or the new one, never a part. After an error or an exception that
    stops the program, the old one stands and nothing else is left. StoreError: the file cannot be
    written.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".tmp" + path.suffix)
    except OSError as error:
        raise _cannot_write(path, error) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        flush_to_disk(temporary)
        temporary.chmod(0o666 & ~_umask())  # mkstemp's own mode is for secrets
        temporary.replace(path)
        flush_to_disk(path.parent)  # else a power cut may take back the name
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def flush_to_disk(path: Path) -> None:
    """See that a file's content, or a folder's names, outlast a power cut."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _umask() -> int:
    mask = os.umask(0)  # can only be read by setting it
    os.umask(mask)
    return mask


def _cannot_write(path: Path, error: OSError) -> StoreError:
    return StoreError(f"{path}: cannot be written: {error.strerror or error}")


LARGEST = 2**16
"""Bytes; `tomllib` takes the square of a long dotted key's parts."""
DEEPEST = 16
"""Tables and lists inside each other."""


def read_toml(
    path: Path, *, named: str = "", error: type[StiffBenchError] = DataError
) -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: of the file.
        named: how the error names it; "": by its path.
        error: that is raised where it cannot be read, or is no TOML, or larger or deeper than any
            settings are.
    """
    try:
        with path.open("rb") as file:
            return _tables(file.read(LARGEST + 1))
    except OSError as problem:
        reason = problem.strerror or problem
        raise error(f"{named or path}: cannot be read: {reason}") from problem
    except ValueError as problem:
        raise error(f"{named or path}: not TOML: {problem}") from problem


def _tables(content: bytes) -> dict[str, Any]:
    if len(content) > LARGEST:
        raise ValueError(f"larger than {LARGEST} bytes")
    try:
        table = tomllib.loads(content.decode())
    except RecursionError:
        raise _too_deep() from None
    level: list[Any] = [table]
    for _ in range(DEEPEST):
        level = [child for node in level for child in _children(node)]
    if level:
        raise _too_deep()
    return table


def _children(node: object) -> list[Any]:
    found = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    return [child for child in found if isinstance(child, dict | list)]


def _too_deep() -> ValueError:
    return ValueError(f"more than {DEEPEST} tables or lists inside each other")
