"""The `bench` command.

Only click is imported here; what a command needs comes when it runs, so that help answers at once.
"""

from __future__ import annotations

import signal
import sys

import click

from stiff_bench.cli.data_commands import data
from stiff_bench.cli.help_pages import WIDEST_PAGE, group
from stiff_bench.cli.map_commands import map_
from stiff_bench.cli.model_commands import export, fit, predict
from stiff_bench.cli.path_commands import path
from stiff_bench.cli.plugin_commands import check, list_, new, show
from stiff_bench.cli.posture_commands import posture
from stiff_bench.cli.refusals import refusal
from stiff_bench.cli.result_commands import (
    compare,
    figure,
    leaderboard,
    merge,
    report,
    results,
    table,
)
from stiff_bench.cli.run_commands import reproduce, run
from stiff_bench.cli.submission_commands import submit, verify
from stiff_bench.console import replace_closed_streams, say
from stiff_bench.run.machine import prepare
from stiff_protocols.contract.errors import StiffBenchError

INTERRUPTION = "interrupted. Results so far are saved; run the same command to continue."
USAGE_ERROR, CELLS_FAILED = 2, 1


class Stopped(BaseException):
    """A signal asked the process to end; no failure of a cell, so no cell may catch it."""

    def __init__(self, number: int) -> None:
        """Remember the signal's number."""
        self.number = number


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit status.

    0: done; 1: a cell failed; 2: bad input; 130: interrupted; 143: stopped by SIGTERM.
    """
    words = sys.argv[1:] if arguments is None else arguments
    replace_closed_streams()
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    for number in (signal.SIGTERM, signal.SIGHUP):  # so that temporary files are taken away
        signal.signal(number, _stop)
    try:
        status = bench.main(args=words, prog_name="bench", standalone_mode=False)
    except (click.Abort, KeyboardInterrupt, Stopped) as stopped:
        say(INTERRUPTION)
        status = 128 + getattr(stopped, "number", signal.SIGINT)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        status = USAGE_ERROR
    except (click.ClickException, StiffBenchError, OSError) as error:
        if debug:
            raise
        if isinstance(error, click.ClickException):
            message = refusal(error)
        else:
            message = error.as_typed() if isinstance(error, StiffBenchError) else str(error)
        say(f"error: {' '.join(message.split())}")
        status = USAGE_ERROR
    except Exception as error:
        if debug:
            raise
        say(f"internal error: {type(error).__name__}: {error} (add --debug for the traceback)")
        status = CELLS_FAILED
    sys.exit(status if isinstance(status, int) else 0)


def _stop(number: int, _: object) -> None:
    raise Stopped(number)


@group(
    context_settings={
        "help_option_names": ["-h", "--help"],
        "show_default": True,
        "max_content_width": WIDEST_PAGE,
    },
    epilog="bench run --model vjm --model vjm-gp --dataset fanuc-r2000ic --splits 5\n"
    "bench leaderboard\n"
    "bench run --help",
)
@click.version_option(package_name="stiffbench", prog_name="bench")
@click.option(
    "--debug",
    is_flag=True,
    expose_value=False,
    help="Show the traceback of an error; valid for every command.",
)
def bench() -> None:
    """Benchmark stiffness models of industrial robots."""
    prepare()


for command in (
    *(check, compare, data, export, figure, fit, leaderboard, list_, map_, merge, new, path),
    *(posture, predict, report, reproduce, results, run, show, submit, table),
    verify,
):
    bench.add_command(command)


if __name__ == "__main__":
    main()
