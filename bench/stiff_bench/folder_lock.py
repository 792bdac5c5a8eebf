"""A lock on a folder of results, so that packing and writing do not cross.

Whoever reads or writes cells holds it together with others; whoever packs them holds it alone. The
lock (flock on ``OUTPUT/.lock``) ends with its process, however that ends.
"""

from __future__ import annotations

import errno
import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from stiff_protocols.errors import StoreError

PATIENCE_S = 60.0
"""How long packing waits for those who read or write."""

_PAUSE_S = 0.05
_BUSY = (errno.EWOULDBLOCK, errno.EACCES)


def make_lock(folder: Path) -> None:
    """Make the lock's file, so that readers without the right to write can hold it."""
    _lock_file(folder).touch()


@contextmanager
def shared(folder: Path) -> Iterator[None]:
    """Hold the lock together with others, while reading or writing cells.

    Where there is no lock (a folder from before there were any, one that was copied without it, a
    file system that has none), nobody packs at the same time either: packing makes it or is
    refused.
    """
    try:
        handle = os.open(_lock_file(folder), os.O_RDONLY)
    except OSError:
        yield
        return
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_SH)
        yield
    finally:
        os.close(handle)


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold the lock alone, while packing.

    Raises:
        StoreError: the file system has no locks, the folder cannot be written, or others hold the
            lock for longer than `PATIENCE_S`.
    """
    try:
        handle = os.open(_lock_file(folder), os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be packed: {error.strerror or error}") from error
    try:
        _wait_for(handle, folder)
        yield
    finally:
        os.close(handle)


def _wait_for(handle: int, folder: Path) -> None:
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            return fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in _BUSY:
                raise StoreError(
                    f"{folder}: cannot be packed: its file system has no locks "
                    f"({error.strerror or error}); everything else works"
                ) from error
        if time.monotonic() > end:
            raise StoreError(
                f"{folder}: cannot be packed: another process reads or writes it for more than "
                f"{PATIENCE_S:g} s; pack it later (bench pack)"
            )
        time.sleep(_PAUSE_S)


def _lock_file(folder: Path) -> Path:
    return folder / ".lock"
