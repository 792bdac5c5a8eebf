"""`bench pack`."""

from __future__ import annotations

from pathlib import Path

import click

from stiff_bench.cli_options import debug_option


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(file_okay=False, path_type=Path))
@debug_option
def pack(folder: Path) -> None:
    """Pack the finished cells of a results folder, so that a large one is read sooner.

    Nothing changes in what it holds. `bench run` packs by itself where there are many cells.
    """
    from stiff_bench import packing
    from stiff_bench.words import counted

    click.echo(f"packed: {counted(packing.pack(folder), 'cell')} of {folder}")
