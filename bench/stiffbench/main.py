"""The `bench` command.

Only cyclopts is imported here; what a command needs comes when it runs, so that help answers at
once.
"""

from __future__ import annotations

import contextlib
import signal
import sys
from typing import Any

from cyclopts import App, CycloptsError, Group
from cyclopts.exceptions import MissingArgumentError, UnknownCommandError, UnknownOptionError

import stiffbench as sb
from stiff_bench.console import say
from stiff_protocols.contract.errors import StiffBenchError, unknown_name
from stiffbench.commands import COMMANDS, GROUPS
from stiffbench.help_page import HelpPage

INTERRUPTION = "interrupted. Results so far are saved; run the same command to continue."
USAGE_ERROR, CELLS_FAILED = 2, 1


class Stopped(BaseException):
    """A signal asked the process to end; no failure of a cell, so no cell may catch it."""

    def __init__(self, number: int) -> None:
        """Remember the signal's number."""
        self.number = number


def bench_app(words: list[str]) -> App:
    """Return the command with its groups; only the command that is called has its options."""
    app = App(
        name="bench",
        help="Benchmark stiffness models of industrial robots.",
        help_epilogue=_example(
            "bench run --model vjm --model vjm-gp --dataset fanuc-r2000ic --splits 5\n"
            "bench leaderboard\n"
            "bench run --help"
        ),
        help_format="plaintext",
        help_formatter=HelpPage(),
        help_flags=("-h", "--help"),
        version=lambda: f"bench, version {sb.__version__}",
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        verbose=False,
    )
    options = Group("Options", sort_key=len(COMMANDS))
    app.command(
        _no_command,
        name="--debug",
        group=options,
        help="Show the traceback of an error; valid for every command.",
    )
    app["--help"].show = False
    app["--version"].group = (options,)
    groups: dict[str, App] = {}
    for number, (heading, commands) in enumerate(COMMANDS.items()):
        page_group = Group(heading, sort_key=number)
        for place, command in enumerate(commands):
            *group, name = command.words.split()
            parent = app
            how: dict[str, Any] = {"group": page_group}
            if group:
                (word,) = group
                if word not in groups:
                    text, example = GROUPS[word]
                    groups[word] = App(
                        name=word,
                        help=text,
                        help_epilogue=_example(example),
                        group=page_group,
                        sort_key=place,
                    )
                    app.command(groups[word])
                parent, how = groups[word], dict[str, Any]()
            n_words = len(command.words.split())
            is_called = " ".join(words[:n_words]) == command.words
            how |= {"name": name, "sort_key": place, "help_epilogue": _example(command.example)}
            if is_called:
                parent.command(command.function(), **how)
            else:
                parent.command(App(help=command.summary, **how))
    return app


def _no_command() -> None:
    """Do nothing: `main` reads --debug."""


def _example(lines: str) -> str:
    return "-h, --help  Show this page.\n\nExample:\n" + "\n".join(
        f"  {line}" for line in lines.splitlines()
    )


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit status.

    0: done; 1: a fit failed; 2: bad input; 130: interrupted; 143: stopped by SIGTERM.
    """
    words = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    for number in (signal.SIGTERM, signal.SIGHUP):  # so that temporary files are taken away
        signal.signal(number, _stop)
    try:
        app = bench_app(words)
        if not words or (len(words) == 1 and words[0] in GROUPS):
            with contextlib.redirect_stdout(sys.stderr):
                app([*words, "--help"])
            sys.exit(USAGE_ERROR)
        status = app(words)
    except (KeyboardInterrupt, Stopped) as stopped:
        say(INTERRUPTION)
        status = 128 + getattr(stopped, "number", signal.SIGINT)
    except (CycloptsError, StiffBenchError, OSError) as error:
        if debug:
            raise
        if isinstance(error, CycloptsError):
            message = refusal(error, app)
        else:
            message = error.as_typed() if isinstance(error, StiffBenchError) else str(error)
        say(f"error: {' '.join(message.split())}")
        status = USAGE_ERROR
    except Exception as error:
        if debug:
            raise
        say(f"internal error: {type(error).__name__}: {error} (add --debug for the traceback)")
        status = CELLS_FAILED
    sys.exit(status or 0)


def _stop(number: int, _: object) -> None:
    raise Stopped(number)


def refusal(error: CycloptsError, app: App) -> str:
    """Return the message of an error of cyclopts with the valid words or an example."""
    chain = [*(error.command_chain or ())]
    called = " ".join(["bench", *chain])
    for word in chain:
        app = app[word]
    if isinstance(error, UnknownCommandError) and error.unused_tokens:
        names = [name for name in app if not name.startswith("-")]
        return str(unknown_name(f"{called} command", error.unused_tokens[0], names))
    if isinstance(error, UnknownOptionError):
        names = [name for argument in error.argument_collection for name in argument.names]
        return str(
            unknown_name(f"{called} option", error.token.keyword or error.token.value, names)
        )
    example = f"example: {(app.help_epilogue or '').splitlines()[3].strip()}"
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        parameter = error.argument.parameter
        return f"{error.argument.name}: missing: {parameter.help}; {example}"
    return f"{error}; {example}"


if __name__ == "__main__":
    main()
