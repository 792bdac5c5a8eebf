"""The `bench` command.

Only click is imported here; what a command needs comes when it runs, so that help answers at once.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

import click

from stiff_bench.cli.compare import compare, leaderboard, report, table
from stiff_bench.cli.data import data
from stiff_bench.cli.figures import figure, reproduce
from stiff_bench.cli.models import check, export, fit, new, predict
from stiff_bench.cli.options import (
    FiniteRange,
    begin_execution,
    chosen,
    command_line,
    data_options,
    debug_option,
    device_option,
    execution_of,
    execution_options,
    format_option,
    output_option,
    plugin_option,
    seed_option,
    settings_option,
)
from stiff_bench.cli.results import cache, merge
from stiff_bench.console import print_text, say
from stiff_bench.run.machine import keep_libraries_in_our_cache, pin_threads, threads_asked_for
from stiff_protocols.contract.errors import StiffBenchError

INTERRUPTION = "interrupted; finished cells are kept, and the same command again computes the rest"
USAGE_ERROR, CELLS_FAILED, INTERRUPTED = 2, 1, 130


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
    for number in (signal.SIGTERM, signal.SIGHUP):  # so that temporary files are taken away
        signal.signal(number, _stop)
    debug = "--debug" in words
    try:
        status = bench.main(args=words, prog_name="bench", standalone_mode=False)
    except (click.Abort, KeyboardInterrupt):
        say(INTERRUPTION)
        status = INTERRUPTED
    except Stopped as stopped:
        say(INTERRUPTION)
        status = 128 + stopped.number
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        status = USAGE_ERROR
    except (click.ClickException, StiffBenchError, OSError) as error:
        if debug:
            raise
        message = error.format_message() if isinstance(error, click.ClickException) else str(error)
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


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="stiffbench", prog_name="bench")
@debug_option
def bench() -> None:
    """Benchmark stiffness models of industrial robots."""
    # Read by OpenMP when torch is imported. Threads that spin while they wait make small networks
    # a hundred times slower as soon as another process wants their core.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ["PYTHONSAFEPATH"] = "1"  # no Python that we start imports from the working directory
    keep_libraries_in_our_cache()
    pin_threads(threads_asked_for())


@bench.command()
@click.option(
    "--model",
    "models",
    multiple=True,
    metavar="KEY",
    help="A model, KEY@OPTION=VALUE for one with options of its own, or 'all' for every one that "
    "`bench list models` shows; may be repeated.",
)
@click.option(
    "--dataset",
    "datasets",
    multiple=True,
    metavar="KEY",
    help="A data set, such as kr10-twin@specimen=3; may be repeated.  [default: kr10-twin]",
)
@click.option(
    "--protocol",
    "protocols",
    multiple=True,
    metavar="KEY",
    default=("holdout",),
    show_default="holdout",
    help="A protocol, such as kfold@folds=10; may be repeated.",
)
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="KEY",
    default=("mae", "stde", "me"),
    show_default="mae, stde, me",
    help="A metric; may be repeated; `bench list metrics` shows them.",
)
@click.option(
    "--coverage",
    type=FiniteRange(0, 1, min_open=True, max_open=True),
    default=None,
    help="Probability that an interval is to hold a sample.  [default: 0.9]",
)
@click.option(
    "--splits",
    type=click.IntRange(1, 10_000),
    default=None,
    help="Number of splits.  [default: the protocol's]",
)
@seed_option("splits and models", most=2**32 - 20_000)
@settings_option
@data_options
@plugin_option
@device_option("Where networks run.")
@execution_options
@output_option("Where results are stored.")
@format_option("the tables")
@debug_option
def run(plugins: tuple[Path, ...], fmt: str, **words: Any) -> int:
    """Fit and test models and print a table for each data set and protocol.

    Results are kept in --output, each as soon as it is there: the same command again computes what
    is missing.
    """
    taken = begin_execution(words)
    from stiff_bench.plan.registry import usable_registry
    from stiff_bench.plan.request import plan_run

    registry = usable_registry(plugins)
    plan = plan_run(chosen(words, registry), registry, **words, command=command_line())
    execution = execution_of(taken, plan, registry)
    from stiff_bench.cli.run import execute, show_plan

    return show_plan([plan], fmt, execution) if taken["plan"] else execute(plan, fmt, execution)


@bench.command("list")
@click.argument("kind", type=click.Choice(["models", "datasets", "protocols", "metrics"]))
@plugin_option
@debug_option
def list_(kind: str, plugins: tuple[Path, ...]) -> None:
    """List what can be named: models, data sets, protocols or metrics."""
    from stiff_bench.cli.show import metrics_overview, overview
    from stiff_bench.plan.registry import usable_registry

    if kind == "metrics":
        print_text(metrics_overview())
        return

    registry = usable_registry(plugins)
    families = registry.families if kind == "models" else ()
    print_text(overview(getattr(registry, kind).values(), families))


@bench.command()
@click.argument("key")
@plugin_option
@debug_option
def show(key: str, plugins: tuple[Path, ...]) -> None:
    """Show what a model, data set or protocol is and which options it has."""
    from stiff_bench.cli.show import describe
    from stiff_bench.plan.registry import usable_registry

    print_text(describe(usable_registry(plugins).find(key)))


for command in (
    *(cache, check, compare, data, export, figure, fit, leaderboard, merge, new),
    *(predict, report, reproduce, table),
):
    bench.add_command(command)


if __name__ == "__main__":
    main()
