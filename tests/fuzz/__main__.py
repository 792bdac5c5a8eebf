"""`PYTHONPATH=tests python -m fuzz [READER ...] --inputs N --seed S`: a row of counts a reader."""

from __future__ import annotations

import tempfile
from pathlib import Path

import click
from fuzz.fuzzing import fuzz
from fuzz.readers import READERS


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(sorted(READERS)), metavar="[READER]...")
@click.option("--inputs", type=click.IntRange(1), default=10_000, show_default=True)
@click.option("--seed", type=int, default=0, show_default=True)
def main(names: tuple[str, ...], inputs: int, seed: int) -> None:
    """Feed readers damaged input; without a name, all of them."""
    click.echo("| reader | inputs | accepted | refused | seconds |\n|---|---:|---:|---:|---:|")
    for name in names or READERS:
        with tempfile.TemporaryDirectory() as folder:
            n = fuzz(name, Path(folder), inputs, seed)
        click.echo(f"| {name} | {n.inputs} | {n.accepted} | {n.refused} | {n.seconds:.1f} |")


main()
