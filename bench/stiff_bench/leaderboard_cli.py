"""`bench leaderboard`."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench.cli_options import (
    FILE,
    command_line,
    debug_option,
    format_option,
    ranking_options,
    results_option,
)
from stiff_bench.messages import print_text


@click.command()
@results_option
@ranking_options
@click.option(
    "--figure",
    type=FILE,
    default=None,
    metavar="FILE.png",
    help="Draw the critical-difference diagrams, too (.png, .pdf or .svg).",
)
@format_option("the tables")
@debug_option
def leaderboard(
    results: Path,
    models: tuple[str, ...],
    datasets: tuple[str, ...],
    protocols: tuple[str, ...],
    metric: str,
    axis: str | None,
    seed: int,
    figure: Path | None,
    fmt: str,
) -> None:
    """Rank models over data sets and protocols, and say where ranks mean nothing."""
    from stiff_bench.leaderboard_tables import render_leaderboard
    from stiff_bench.sort_key import sort_key
    from stiff_bench.stored_leaderboard import stored_leaderboard

    key = sort_key(metric, axis)
    board, provenance = stored_leaderboard(
        results, models=models, datasets=datasets, protocols=protocols, key=key, seed=seed
    )
    if figure is not None:
        from stiff_bench.critical_difference import save_diagrams

        first = board.sections[0]
        save_diagrams(first.analyses, key.text, first.kinds, figure)
    print_text(render_leaderboard(board, fmt, command_line(), provenance))
