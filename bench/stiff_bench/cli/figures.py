"""`bench figure` and `bench reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import click

from stiff_bench.api import RESULTS
from stiff_bench.cli.options import (
    FILE,
    FORMATS,
    case_options,
    command_line,
    execution_options,
    models_option,
    picture,
)
from stiff_bench.cli.run import say_summary, show_plan
from stiff_bench.console import print_text, say


@click.command()
@click.argument("name")
@click.option(
    "--results",
    type=FILE,
    metavar="DIR",
    help=f"Folder of results.  [default: {RESULTS}; results/paper/runs for the paper's figures]",
)
@click.option(
    "--output",
    type=FILE,
    callback=picture,
    metavar="FILE.pdf",
    help="File to write: .png, .pdf or .svg.  [default: figure-NAME.png]",
)
@models_option
@case_options
def figure(name: str, results: Path | None, output: Path | None, **chosen: Any) -> None:
    """Draw a figure and print its caption.

    NAME is a figure of the source paper (4, 5, 6, 8, 9) or a general one: scores, regression,
    errors, losses, sweep, freezing, learning-curves, workspace, springs, calibration. The caption
    names the data set and protocol that are shown.
    """
    from stiff_bench.api.figures import figure

    prepared = figure(name, results, **chosen)
    target = output or Path(f"figure-{name}.png")
    prepared.save(target)
    print_text(f"{target}: {prepared.title}. {prepared.caption}")


@click.command()
@click.argument(
    "what",
    type=click.Choice(["paper", "leaderboard", "effects", "transfer"]),
    default="paper",
    metavar="[WHAT]",
)
@click.option(
    "--quick/--full",
    default=None,
    help="Size of the paper's study. Quick: one split and coarse sweeps, about 7 minutes on 2 "
    "cores. Full: five splits, every width, depth and pair of layers, about half an hour.  "
    "[default: quick]",
)
@click.option(
    "--paper-recipe",
    is_flag=True,
    help="Add the paper's own recipe to its Tables 9 and 10: 100,000 iterations of pre-training, "
    "50,000 of fine-tuning, on the first split alone, about half an hour.",
)
@click.option(
    "--output",
    type=FILE,
    default=Path("results"),
    metavar="DIR",
    help="Folder that takes the folder of this name.",
)
@click.option("--write-only", is_flag=True, help="Write from stored results alone.")
@execution_options("the number of cores")
@click.option("--format", "fmt", type=FORMATS, default="github", help="Format of the --plan.")
def reproduce(
    what: Literal["paper", "leaderboard", "effects", "transfer"],
    quick: bool | None,
    paper_recipe: bool,
    output: Path,
    write_only: bool,
    plan_only: bool,
    fmt: str,
    **how: Any,
) -> int:
    """Make the paper's tables and figures again, or another study.

    WHAT is paper (the default), leaderboard, effects (does the ranking of the models depend on the
    physics of the simulated robot?) or transfer (what do simulated data add to a few measured
    poses?). Stored results are not computed again: an interrupted command can be repeated. On 2
    cores the leaderboard and transfer take about 2 hours each, effects half an hour.
    """
    from stiff_bench.api.reproduction import reproduction

    if what != "paper" and quick is not None:
        raise click.UsageError(f"--quick and --full are of the paper; {what} has one size")
    if what != "paper" and paper_recipe:
        raise click.UsageError(f"--paper-recipe is of the paper, not of {what}")
    how |= {"paper_recipe": paper_recipe, "command": command_line()}
    asked = reproduction(what, full=quick is False, output=output, **how)
    if plan_only:
        return show_plan(asked, fmt)
    status = 0
    if not write_only:
        results = asked.compute()
        say_summary(results)
        say("writing tables and figures")
        status = int(any(result.status == "failed" for result in results.cells))
    for path in asked.write():
        print_text(str(path))
    return status
