"""`bench figure` and `bench reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import click

from stiff_bench.api import RESULTS
from stiff_bench.cli.options import (
    FILE,
    Picture,
    case_options,
    command_line,
    execution_options,
    models_option,
)
from stiff_bench.console import print_text, say


@click.command()
@click.argument("name")
@click.option(
    "--results",
    type=FILE,
    metavar="DIR",
    help=f"Of the results.  [default: {RESULTS}; results/paper/runs for the paper's figures]",
)
@click.option(
    "--output",
    type=Picture(),
    metavar="FILE.pdf",
    help="What to write: .png, .pdf or .svg.  [default: figure-NAME.png]",
)
@models_option
@case_options
def figure(name: str, results: Path | None, output: Path | None, **chosen: Any) -> None:
    """Draw a figure and print its caption.

    NAME is one of the source paper's figures (4, 5, 6, 8, 9), or one that any results
    can be drawn as: regression, errors, losses, sweep, freezing, learning-curves, workspace,
    springs, ranks. The caption says which data set and protocol it shows, where results of several
    could be drawn.
    """
    from stiff_bench.api.figures import figure

    prepared = figure(name, results, **chosen)
    target = output or Path(f"figure-{name}.png")
    prepared.save(target)
    print_text(f"{target}: {prepared.title}. {prepared.caption}")


@click.command()
@click.argument("what", type=click.Choice(["paper", "leaderboard"]), default="paper")
@click.option(
    "--quick/--full",
    default=None,
    help="Of the paper: one split and coarse sweeps, about 7 minutes on 2 cores; or five splits, "
    "every width, depth and pair of layers, about an hour.  [default: quick]",
)
@click.option(
    "--output",
    type=FILE,
    default=Path("results"),
    metavar="DIR",
    help="Where the folder paper/ or leaderboard/ is written.",
)
@click.option("--write-only", is_flag=True, help="Compute nothing; write what results allow.")
@execution_options("the number of cores")
def reproduce(
    what: Literal["paper", "leaderboard"],
    quick: bool | None,
    output: Path,
    write_only: bool,
    plan_only: bool,
    **how: Any,
) -> int:
    """Run all that the paper's tables and figures need, or the committed leaderboard; write them.

    What is stored already is not computed again: stopped in any way, the same command goes on. The
    leaderboard takes about 2 hours on 2 cores.
    """
    from stiff_bench.api.reproduction import reproduction
    from stiff_bench.cli.run import say_summary, show_plan

    if what == "leaderboard" and quick is not None:
        raise click.UsageError("--quick and --full are of the paper; the leaderboard has one size")
    asked = reproduction(what, full=quick is False, output=output, command=command_line(), **how)
    if plan_only:
        return show_plan(asked, "github")
    status = 0
    if not write_only:
        results = asked.compute()
        say_summary(results)
        say("writing tables and figures")
        status = int(any(result.status == "failed" for result in results.cells))
    for path in asked.write():
        click.echo(path)
    return status
