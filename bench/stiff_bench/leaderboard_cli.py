"""`bench leaderboard`."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench.cli_options import (
    FILE,
    command_line,
    contest_options,
    debug_option,
    draws_seed_option,
    format_option,
    results_option,
)
from stiff_bench.messages import print_text


@click.command()
@results_option
@click.option(
    "--model",
    "models",
    multiple=True,
    metavar="KEY",
    help="A model, or a key that stands for all its variants; may be repeated. Ranks are among "
    "those that are shown.  [default: all]",
)
@contest_options
@click.option(
    "--metric",
    default="norm",
    show_default=True,
    metavar="KEY",
    help="What to rank by.",
)
@click.option(
    "--axis",
    type=click.Choice(["x", "y", "z"]),
    default=None,
    help="Of a metric that has axes.  [default: the mean over the three]",
)
@draws_seed_option
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
