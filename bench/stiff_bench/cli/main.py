"""The `bench` command.

Only click is imported here; what a command needs comes when it runs, so that help answers at once.
"""

from __future__ import annotations

import signal
import sys
from typing import Any

import click

from stiff_bench.api import RESULTS
from stiff_bench.api.process import prepare
from stiff_bench.cli.compare import compare, leaderboard, report, table
from stiff_bench.cli.data import data
from stiff_bench.cli.figures import figure, reproduce
from stiff_bench.cli.models import check, export, fit, new, predict
from stiff_bench.cli.options import (
    FILE,
    PROBABILITY,
    WholeRange,
    command_line,
    data_options,
    device_option,
    execution_options,
    format_option,
    plugin_option,
    seed_option,
    settings_option,
    several_keys,
)
from stiff_bench.cli.path import path
from stiff_bench.cli.refusals import Commands, refusal
from stiff_bench.cli.results import cache, merge
from stiff_bench.console import print_text, say
from stiff_protocols.contract.errors import StiffBenchError

INTERRUPTION = "interrupted; what is stored stays, the same command computes the rest"
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
        say(f"internal error: {type(error).__name__}: {error} (--debug shows where)")
        status = CELLS_FAILED
    sys.exit(status if isinstance(status, int) else 0)


def _stop(number: int, _: object) -> None:
    raise Stopped(number)


@click.group(
    cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True}
)
@click.version_option(package_name="stiffbench", prog_name="bench")
@click.option(
    "--debug", is_flag=True, expose_value=False, help="Show tracebacks; valid for every command."
)
def bench() -> None:
    """Benchmark stiffness models of industrial robots."""
    prepare()


@bench.command()
@several_keys(
    "--model",
    "models",
    help="A model, KEY@OPTION=VALUE for one with its own options, or 'all'; may be repeated.",
)
@several_keys(
    "--dataset",
    "datasets",
    help="A data set, such as kr10-twin@specimen=3; may be repeated.  [default: kr10-twin]",
)
@several_keys(
    "--protocol",
    "protocols",
    default=("holdout",),
    help="A protocol, such as kfold@folds=10; may be repeated.",
)
@several_keys(
    "--metric",
    "metrics",
    help="A metric of `bench list metrics`; may be repeated.  [default: mae, stde, me; of tool "
    "paths norm, norm-p95, norm-max, removed]",
)
@click.option(
    "--coverage", type=PROBABILITY, help="Coverage of prediction intervals.  [default: 0.9]"
)
@click.option(
    "--splits", type=WholeRange(1, 10_000), help="Number of splits.  [default: the protocol's]"
)
@seed_option
@settings_option
@data_options
@plugin_option
@device_option
@execution_options("1")
@click.option(
    "--output", type=FILE, default=RESULTS, metavar="DIR", help="Folder that stores the results."
)
@format_option
@click.option("--verbose", is_flag=True, help="Print what fits report, such as stiffnesses.")
def run(fmt: str, plan_only: bool, verbose: bool, **words: Any) -> int:
    """Fit and test models; print a table per data set and protocol.

    A fit is one model, trained and tested on one split. The VJM is run beside every model. Each
    result is stored in --output at once; the same command again computes what is missing.
    """
    from stiff_bench.api.run import run_of_words
    from stiff_bench.cli.run import execute, show_plan

    asked = run_of_words(**words, command=command_line())
    return show_plan(asked, fmt) if plan_only else execute(asked, fmt, verbose=verbose)


@bench.command("list")
@click.argument(
    "kind", metavar="KIND", type=click.Choice(["models", "datasets", "protocols", "metrics"])
)
@plugin_option
def list_(kind: str) -> None:
    """List what can be named.

    KIND is models, datasets, protocols or metrics.
    """
    from stiff_bench.api import catalog

    print_text(repr(getattr(catalog, f"list_{kind}")()))


@bench.command()
@click.argument("key")
@plugin_option
def show(key: str) -> None:
    """Explain a model, data set or protocol, with its options."""
    from stiff_bench.api import catalog

    print_text(catalog.show(key))


for command in (
    *(cache, check, compare, data, export, figure, fit, leaderboard, merge, new),
    *(path, predict, report, reproduce, table),
):
    bench.add_command(command)


if __name__ == "__main__":
    main()
