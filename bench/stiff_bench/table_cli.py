"""`bench table`."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench.cli_options import FILE, command_line, debug_option, format_option
from stiff_bench.messages import print_text


@click.command()
@click.argument("number", type=click.Choice(["2", "3", "6", "7", "8", "9", "10"]), metavar="NUMBER")
@click.option(
    "--results",
    type=FILE,
    default=None,
    metavar="DIR",
    help="Folder of the results, as `bench reproduce` makes them; tables 2 and 3 need none.  "
    "[default: results/paper/runs]",
)
@format_option("the table")
@debug_option
def table(number: str, results: Path | None, fmt: str) -> None:
    """Print a table of the source paper beside ours: 2, 3, 6, 7, 8, 9 or 10.

    2: the VJM's errors on the samples it was fitted to; 3: identified joint stiffnesses; 6 and 7:
    errors on the simulated source by depth and by activation; 8: which layers are unfrozen; 9:
    last epoch against best epoch; 10: VJM, FT-MLP and DT-CNN.
    """
    from stiff_bench.paper.paper_results import PAPER_RESULTS, paper_results
    from stiff_bench.paper.paper_table_text import render_paper_table
    from stiff_bench.paper.paper_tables import FITTED_HERE, build
    from stiff_protocols.errors import ConfigError

    found = None
    if int(number) in FITTED_HERE:
        if results is not None:
            raise ConfigError(f"--results {results}: table {number} is fitted here and reads none")
    else:
        found = paper_results(PAPER_RESULTS if results is None else results)
    print_text(render_paper_table(build(int(number), found), fmt, command_line()))
