"""`bench merge` and `bench cache`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stiff_bench.cli.options import FILE, command_line, debug_option
from stiff_bench.console import print_text, say

if TYPE_CHECKING:
    from stiff_bench.store.merging import Disagreement, Merged
    from stiff_bench.tables.render import TextTable


def difference_table(found: Sequence[Disagreement]) -> TextTable:
    """Return a row for each folder and each thing of which folders say different things."""
    from stiff_bench.store.names import SHORT
    from stiff_bench.tables.render import TextTable

    return TextTable(
        title="What the folders have under one name",
        header=("differs", "folder", "has", "cells", "newest run", "stiffbench"),
        rows=[
            [
                f"{one.kind}: {_name(one)}",
                str(folder),
                claim.value if " " in claim.value else claim.value[:SHORT],
                str(claim.n_cells),
                claim.run_id,
                one.versions[folder],
            ]
            for one in found
            for folder, claim in one.claims.items()
        ],
        notes=(
            "of data and splits a hash of numbers and rows, cut to eight characters; of code the "
            "model's version and that of the scoring",
            "of each folder the newest run counts that has the thing",
        ),
    )


def _name(one: Disagreement) -> str:
    """Return what differs; of several splits the first stands in the table."""
    from stiff_bench.tables.units import counted

    if one.kind == "split" and one.n_subjects > 1:
        return f"{one.name} (the first of {counted(one.n_subjects, 'split')})"
    return one.name


MOST_LINES = 20
"""So many damaged rows are named."""


@click.command()
@click.argument("folders", metavar="DIR...", type=FILE, nargs=-1, required=True)
@click.option(
    "--output",
    type=FILE,
    required=True,
    metavar="DIR",
    help="Folder that takes all results: a new one, or one that holds some.",
)
@click.option(
    "--allow",
    multiple=True,
    type=click.Choice(["data", "split", "code"]),
    help="Merge though the folders differ in this; may be repeated.",
)
@debug_option
def merge(folders: tuple[Path, ...], output: Path, allow: tuple[str, ...]) -> int:
    """Join the results of several machines in one folder.

    Folders that differ in data, splits or versions of models (code) are refused, and it is shown
    what differs. The folders that are joined stay as they are.
    """
    from stiff_bench.store import merging

    try:
        merged = merging.merge(folders, output, frozenset(allow))  # type: ignore[arg-type]
    except merging.Disagreeing as error:
        _print(error.found)
        raise
    if merged.disagreements:
        _print(merged.disagreements)
    return _summed_up(merged, output)


def _print(found: Sequence[Disagreement]) -> None:
    from stiff_bench.tables.render import render_texts

    print_text(render_texts([difference_table(found)], "github", command_line()))


def _summed_up(merged: Merged, output: Path) -> int:
    """Say what was done, and return the exit status: 1 where damaged rows were left out."""
    for line in merged.damaged[:MOST_LINES]:
        say(f"left out: {line}")
    if len(merged.damaged) > MOST_LINES:
        say(f"left out: {len(merged.damaged) - MOST_LINES} more")
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
@debug_option
def info() -> None:
    """Say where the cache lies and what it holds."""
    from stiff_models.networks.cache import cache_info

    click.echo(str(cache_info()))


@cache.command()
@debug_option
def clear() -> None:
    """Delete every pre-trained network; the next run trains anew."""
    from stiff_models.networks.cache import clear_cache

    deleted = clear_cache()
    click.echo(f"deleted: {deleted}" if deleted.entries else f"nothing to delete: {deleted}")
