"""The `bench` command: find the command that the words call, run it, and tell how it ended.

What a command needs is imported when it is called, so that help answers at once.
"""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import stiffbench as sb
from stiff_bench.console import escape_missing_characters, print_text, say, wrapped
from stiff_protocols.contract.errors import ConfigError, StiffBenchError, unknown_name
from stiffbench.commands import COMMANDS, GROUPS, Command

if TYPE_CHECKING:
    from cyclopts import App
    from cyclopts.help import HelpPanel

INTERRUPTION = "interrupted. Results so far are saved; run the same command to continue."
USAGE_ERROR, CELLS_FAILED = 2, 1
BY_WORDS = {command.words: command for commands in COMMANDS.values() for command in commands}
HELP_FLAGS = ("-h", "--help")
GENERAL_OPTIONS = (
    ("--debug", "Show the traceback of an error; valid for every command."),
    ("--version", "Show the version."),
)
NAME_COLUMN = 28
"""Width of the column of options' names; longer names have a line of their own."""


class Stopped(BaseException):
    """A signal asked the process to end; no failure of a fit, so no fit may catch it."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit status.

    0: done; 1: a fit failed; 2: bad input; 130: interrupted; 143: stopped by SIGTERM.
    """
    words = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in words
    for stream in (sys.stdout, sys.stderr):
        escape_missing_characters(stream)
    for name in ("SIGTERM", "SIGHUP"):  # so that temporary files are taken away
        if hasattr(signal, name):  # Windows has no SIGHUP
            signal.signal(getattr(signal, name), _stop)
    try:
        status = run([word for word in words if word != "--debug"])
    except (KeyboardInterrupt, Stopped) as stopped:
        say(INTERRUPTION)
        status = 128 + (stopped.args[0] if isinstance(stopped, Stopped) else signal.SIGINT)
    except Exception as error:
        if debug:
            raise
        if isinstance(error, StiffBenchError | OSError):
            message = error.as_typed() if isinstance(error, StiffBenchError) else str(error)
            say(f"error: {' '.join(message.split())}")
            status = USAGE_ERROR
        else:
            say(f"internal error: {type(error).__name__}: {error} (add --debug for the traceback)")
            status = CELLS_FAILED
    sys.exit(status)


def _stop(number: int, _: object) -> None:
    raise Stopped(number)


def run(words: list[str]) -> int:
    """Run the command that words call, and return its exit status.

    Raises:
        ConfigError: a word is wrong.
    """
    for length in (1, 2):
        if command := BY_WORDS.get(" ".join(words[:length])):
            return run_command(command, words[length:])
    group = words[0] if words and words[0] in GROUPS else ""
    name = next(iter(words[bool(group) :]), "")
    if words == ["--version"]:
        print(f"bench, version {sb.__version__}")
    elif name in ("", *HELP_FLAGS):
        with contextlib.redirect_stdout(sys.stdout if name else sys.stderr):
            print_overview(group)
        return 0 if name else USAGE_ERROR
    else:
        paths = [command.split() for command in BY_WORDS]
        names = {path[-1] if group else path[0] for path in paths if group in ("", path[0])}
        raise unknown_name(f"{f'bench {group}'.strip()} command", name, names)
    return 0


def run_command(command: Command, options: list[str]) -> int:
    """Run a command and return its exit status; ConfigError: a word is wrong."""
    from cyclopts import CycloptsError, UnusedCliTokensError

    app = command_app(command)
    try:
        return int(app(options) or 0)
    except CycloptsError as error:
        text = str(error)
        if isinstance(error, UnusedCliTokensError):
            text = f"superfluous: {' '.join(map(repr, error.unused_tokens or ()))}."
        raise ConfigError(f"{text} Example: {command.example.splitlines()[0]}") from error


def command_app(command: Command) -> App:
    """Return the cyclopts app of a command."""
    from cyclopts import App

    app = App(
        name=f"bench {command.words}",
        help_format="plaintext",
        help_formatter=HelpPage(),
        help_epilogue=page_end(command.example),
        help_flags=HELP_FLAGS,
        version_flags=(),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        verbose=False,
        suppress_keyboard_interrupt=False,
    )
    app["--help"].show = False
    app.default(command.function())
    return app


def print_overview(group: str) -> None:
    """Print the commands of `bench`, or of a group."""
    print_text(f"Usage: {f'bench {group}'.strip()} COMMAND\n\n{GROUPS[group]}")
    examples = []
    for heading, commands in COMMANDS.items():
        rows = dict[str, str]()
        for command in commands:
            above, _, name = command.words.rpartition(" ")
            if above == group:
                rows[name] = command.summary
                examples.append(command.example)
            elif not group:
                rows[above] = GROUPS[above]
        if rows:
            print_rows("Commands" if group else heading, [*rows.items()])
    if not group:
        print_rows("Options", GENERAL_OPTIONS)
        examples = [examples[0], "bench run --help"]
    print_text("\n" + page_end("\n".join(examples)))


# help pages


def print_rows(heading: str, rows: Sequence[tuple[str, str]]) -> None:
    """Print names and their descriptions as two columns below a heading."""
    width = max((len(name) for name, _ in rows if len(name) <= NAME_COLUMN), default=0)
    print_text(f"\n{heading}:")
    for name, text in rows:
        if len(name) > width:
            print_text(f"  {name}")
            name = ""
        print_text(wrapped(text, f"  {name:<{width}}  ", " " * (width + 4)))


def page_end(example: str) -> str:
    """Return the end of a page: the option for it, and an example as it is."""
    lines = "\n".join(f"  {line}" for line in example.splitlines())
    return f"-h, --help  Show this page.\n\nExample:\n{lines}"


class HelpPage:
    """The formatter of cyclopts' help pages."""

    def __call__(self, console: Any, options: Any, panel: HelpPanel) -> None:
        """Print a group of options with its heading."""
        rows = []
        for entry in panel.entries:
            is_option = entry.positional_label is None
            end = " [required]" if entry.required and is_option else ""
            end = f" [default: {entry.default}]" if entry.default else end
            text = _plain(entry.description) + end
            rows.append((", ".join(entry.display_labels_with_metavar), text))
        if rows:
            print_rows(str(panel.title), rows)

    def render_usage(self, console: Any, options: Any, usage: Any) -> None:
        """Print the usage."""
        print_text(f"Usage: {str(usage).strip()}")

    def render_description(self, console: Any, options: Any, description: Any) -> None:
        """Print the text of a command; lines of a list stay as they are."""
        for paragraph in _plain(description).split("\n\n"):
            is_list = paragraph.startswith(" ")
            print_text("\n" + (paragraph if is_list else wrapped(" ".join(paragraph.split()))))


def _plain(text: Any) -> str:
    text = getattr(text, "primary_renderable", text)
    return str(getattr(text, "plain", text) or "")


if __name__ == "__main__":
    main()
