"""`bench merge` and `bench cache`."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench.cli.options import FILE, output_option
from stiff_bench.cli.refusals import Commands
from stiff_bench.console import print_text, say


@click.command()
@click.argument("folders", metavar="DIR...", type=FILE, nargs=-1, required=True)
@output_option("DIR", "Folder to merge into, new or with results.")
def merge(folders: tuple[Path, ...], output: Path) -> None:
    """Merge the results of several machines into one folder.

    Folders that have different numbers of one fit are refused. The given folders are not changed.
    """
    from stiff_bench.api import results

    for line in results.merge(folders, output).report:
        say(line)


@click.group(cls=Commands)
def cache() -> None:
    """Show or empty the cache of pre-trained networks."""


@cache.command()
def info() -> None:
    """Print folder and content of the cache."""
    from stiff_bench.api.process import cache_info

    print_text(str(cache_info()))


@cache.command()
def clear() -> None:
    """Delete every pre-trained network; the next run trains anew."""
    from stiff_bench.api.process import clear_cache

    deleted = clear_cache()
    print_text(f"deleted: {deleted}" if deleted.entries else f"nothing to delete: {deleted}")
