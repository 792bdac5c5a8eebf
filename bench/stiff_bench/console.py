"""What `bench` says on standard error, and what it keeps off standard output."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator

import click

from stiff_protocols.contract.errors import StoreError
from stiff_protocols.contract.screen import one_line as one_line
from stiff_protocols.contract.screen import printable as printable


def say(message: str) -> None:
    """Print one line for people."""
    click.echo(f"bench: {one_line(message)}", err=True)


@contextlib.contextmanager
def printing_to_stderr() -> Iterator[None]:
    """Send what is printed inside to standard error, by C libraries too: tables have the other."""
    sys.stdout.flush()
    with contextlib.redirect_stdout(sys.stderr), contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # a descriptor that is closed needs no care
            kept = os.dup(1)
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, 1)
            os.dup2(2, 1)
        yield


def print_text(text: str) -> None:
    """Print a result; a closed pipe (`| head`) is not an error.

    Raises:
        StoreError: standard output cannot be written, as on a full disk.
    """
    try:
        click.echo(printable(text))
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # flushed again at exit
        if not isinstance(error, BrokenPipeError):
            raise StoreError(f"standard output: cannot be written: {error.strerror}") from error


def replace_closed_streams() -> None:
    """Open the null device in place of standard streams that the caller has closed.

    Otherwise the next file that is opened gets the descriptor, and a library that prints would
    write into it. Messages are dropped; a result on standard output is an error.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:  # the lowest free descriptor is this one
            os.open(os.devnull, os.O_WRONLY if descriptor == 2 else os.O_RDONLY)
    for descriptor, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(descriptor, "w", encoding="utf-8", closefd=False))


@contextlib.contextmanager
def warnings_said() -> Iterator[None]:
    """Say each warning once, in a line."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        yield
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        say(f"warning: {message}")
