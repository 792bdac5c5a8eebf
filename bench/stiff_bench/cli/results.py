"""`bench merge` and `bench cache`."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench.cli.options import FILE, output_option
from stiff_bench.console import say


@click.command()
@click.argument("folders", metavar="DIR...", type=FILE, nargs=-1, required=True)
@output_option("DIR", "Folder that takes all results: a new one, or one that holds some.")
@click.option(
    "--allow",
    multiple=True,
    type=click.Choice(["data", "split", "code"]),
    help="Merge though the folders differ in this; may be repeated.",
)
def merge(folders: tuple[Path, ...], output: Path, allow: tuple[str, ...]) -> int:
    """Join the results of several machines in one folder.

    Folders that differ in data, splits or versions of models (code) are refused. The folders that
    are joined stay as they are. Exit status 1: damaged rows were left out.
    """
    from stiff_bench.api import results

    merged = results.merge(folders, output, allow=allow)  # type: ignore[arg-type]
    for line in merged.disagreements:
        say(f"merged all the same: {line}")
    for line in merged.damaged:
        say(f"left out: {line}")
    for folder, (n_cells, n_taken) in merged.taken.items():
        others = "" if n_taken == n_cells else "; the others are there, or newer in another folder"
        say(f"{folder}: {n_taken} of {n_cells} cells taken{others}")
    if merged.n_other_numbers:
        say(
            f"warning: {merged.n_other_numbers} cells have other numbers in another folder (other "
            "rounding?); those of the newest run count"
        )
    left_out = f", {len(merged.damaged)} damaged rows left out" if merged.damaged else ""
    say(f"{merged.n_cells} cells in {output}, {merged.n_there} of them were there{left_out}")
    return 1 if merged.damaged else 0


@click.group()
def cache() -> None:
    """Show or empty the cache of pre-trained networks."""


@cache.command()
def info() -> None:
    """Say where the cache lies and what it holds."""
    from stiff_bench.api.cache import cache_info

    click.echo(str(cache_info()))


@cache.command()
def clear() -> None:
    """Delete every pre-trained network; the next run trains anew."""
    from stiff_bench.api.cache import clear_cache

    deleted = clear_cache()
    click.echo(f"deleted: {deleted}" if deleted.entries else f"nothing to delete: {deleted}")
