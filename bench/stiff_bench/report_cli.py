"""The `bench report` command."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench.cli_options import (
    FILE,
    RESULTS,
    command_line,
    debug_option,
    ranking_options,
)
from stiff_bench.messages import say


@click.command()
@click.option(
    "--results",
    "folders",
    type=FILE,
    multiple=True,
    default=(RESULTS,),
    show_default=str(RESULTS),
    metavar="DIR",
    help="Folder of results: the --output of `bench run`; may be repeated. Folders are not "
    "compared with each other.",
)
@click.option(
    "--output",
    type=FILE,
    required=True,
    metavar="FILE.html",
    help="The page; an older one is replaced.",
)
@ranking_options
@debug_option
def report(
    folders: tuple[Path, ...],
    output: Path,
    models: tuple[str, ...],
    datasets: tuple[str, ...],
    protocols: tuple[str, ...],
    metric: str,
    axis: str | None,
    seed: int,
) -> None:
    """Write all that results say as one HTML page that needs no network.

    Ranks, pairwise comparisons, figures, scores, failures, and where the results come from; its
    tables can be sorted and filtered in a browser.
    """
    from stiff_bench.report.commands import Choice
    from stiff_bench.report.write import write_report

    choice = Choice(models, datasets, protocols, metric, axis, seed)
    write_report(folders, choice, output, command_line())
    say(f"{output}: the page is written")
