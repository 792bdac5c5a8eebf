"""Print messages on standard error and results on standard output."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import sys
import textwrap
import warnings
from collections.abc import Iterator
from typing import TextIO

from stiff_protocols.contract.display import one_line as one_line
from stiff_protocols.contract.display import printable as printable

SCREEN = "screen"
"""Format of tables for a terminal."""
WIDEST_TEXT = 100
"""Characters of a line of text."""
_CELLS = re.compile(r"\S {2,}\S|^\|")
"""Pattern of lines of tables; sentences do not match."""
_BULLET_AND_SENTENCE = re.compile(r"(\s*(?:\W )?)(.*)")


def escape_missing_characters(stream: TextIO) -> None:
    """Make a stream write "?" for characters that its encoding does not have, such as ≈.

    Standard error writes their numbers already.
    """
    if isinstance(stream, io.TextIOWrapper) and stream.errors != "backslashreplace":
        stream.reconfigure(errors="replace")


def say(message: str) -> None:
    """Print a message on standard error, as one line except on a terminal."""
    line = f"bench: {one_line(message)}"
    print(wrapped(line, indent="  ") if sys.stderr.isatty() else line, file=sys.stderr, flush=True)


def text_width() -> int:
    """Return the width of lines of text: the terminal's, at most `WIDEST_TEXT`."""
    return min(WIDEST_TEXT, shutil.get_terminal_size((WIDEST_TEXT, 24)).columns)


def wrapped(text: str, first_indent: str = "", indent: str = "") -> str:
    """Break a paragraph into lines of `text_width`, without breaking words or names."""
    return textwrap.fill(
        text,
        text_width(),
        initial_indent=first_indent,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


def wrapped_lines(text: str) -> str:
    """Break the lines of a text that are too wide, except lines of tables."""
    lines = text.split("\n")
    for number, line in enumerate(lines):
        if len(line) > text_width() and not _CELLS.search(line):
            bullet, sentence = _BULLET_AND_SENTENCE.findall(line)[0]
            lines[number] = wrapped(sentence, bullet, " " * len(bullet))
    return "\n".join(lines)


@contextlib.contextmanager
def printing_to_stderr() -> Iterator[None]:
    """Redirect standard output to standard error, also for C libraries."""
    sys.stdout.flush()
    with contextlib.redirect_stdout(sys.stderr), contextlib.ExitStack() as stack:
        saved_stdout = os.dup(1)
        stack.callback(os.close, saved_stdout)
        stack.callback(os.dup2, saved_stdout, 1)
        os.dup2(2, 1)
        yield


def print_text(text: str, *, laid_out: bool = False) -> None:
    """Print a result; a closed pipe (`| head`) is not an error.

    A text that is laid out for a terminal may hold colours; its parts are escaped already.
    """
    try:
        print(text if laid_out else printable(text), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # flushed again at exit


def print_prose(text: str) -> None:
    """Print sentences; on a terminal, lines that are too wide are broken between words."""
    print_text(wrapped_lines(printable(text)) if sys.stdout.isatty() else text)


def print_markdown(text: str) -> None:
    """Print Markdown: laid out on a terminal, elsewhere as it is."""
    if not sys.stdout.isatty():
        print_text(text)
        return
    from rich.console import Console  # 0.1 s
    from rich.markdown import Markdown

    Console(width=text_width()).print(Markdown(printable(text), hyperlinks=False))


@contextlib.contextmanager
def warnings_on_stderr() -> Iterator[None]:
    """Print each warning once on standard error, in one line."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        yield
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        say(f"warning: {message}")
