"""`bench figure` and `bench reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stiff_bench.api import RESULTS
from stiff_bench.cli.options import (
    FILE,
    FORMATS,
    command_line,
    execution_options,
    picture,
    selection_options,
)
from stiff_bench.cli.run import say_summary, show_plan
from stiff_bench.console import print_text, say

if TYPE_CHECKING:
    from stiff_bench.analysis.selection import Selection


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
@selection_options
def figure(name: str, results: Path | None, output: Path | None, selection: Selection) -> None:
    """Draw a figure and print its caption.

    NAME is a figure of the source paper (4, 5, 6, 8, 9) or a general one: `bench list figures`. The
    caption names the data set and protocol that are shown.
    """
    from stiff_bench.api.figures import figure
    from stiff_bench.api.results import Results

    stored = Results(results or RESULTS, selection=selection) if selection.options else results
    prepared = figure(name, stored)
    target = output or Path(f"figure-{name}.png")
    prepared.save(target)
    print_text(f"{target}: {prepared.title}. {prepared.caption}")


@click.command()
@click.argument("name")
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
    name: str, output: Path, write_only: bool, plan_only: bool, fmt: str, **how: Any
) -> int:
    """Run a study and write its page.

    NAME is a study that stiffbench ships, or a file such as my_study.toml: paper (the source
    paper's tables and figures, an hour on 2 cores), paper-quick (one split and coarse sweeps, 7
    minutes), leaderboard (2 hours), effects (is the ranking robust to other physics of the
    simulated robot? half an hour), transfer (what do simulated data add to a few measured poses? 2
    hours), intervals, anchored, anchored-steps. Stored results are not computed again: an
    interrupted command can be repeated.
    """
    from stiff_bench.api.reproduction import reproduction

    asked = reproduction(name, output=output, command=command_line(), **how)
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
