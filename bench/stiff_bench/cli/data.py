"""The `bench data` commands: words in, one function of `data_tools` called."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from stiff_bench.cli.options import (
    FILE,
    no_torque_option,
    output_option,
    plugin_option,
    robot_options,
    seed_option,
    settings_option,
    tcp_option,
)


@click.group()
def data() -> None:
    """Make, check, plan and look at data sets."""


@data.command()
@click.argument("key", metavar="KEY|FILE")
@robot_options
@no_torque_option
@click.option(
    "--output",
    type=FILE,
    default=Path("results/info"),
    metavar="DIR",
    help="Where the picture KEY.png goes.",
)
@settings_option
@plugin_option
def info(key: str, output: Path, **words: Any) -> None:
    """Print a data set's card and facts, and draw its picture.

    KEY may be your own FILE.csv, .xlsx or .parquet, with --urdf or --robot.
    """
    from stiff_bench.api.data import dataset_of_words

    click.echo(dataset_of_words(key, **words).describe(output))


@data.command()
@robot_options
@click.option(
    "--poses",
    type=click.IntRange(1, 10_000),
    help="How many to choose.  [default: the paper's 151 poses of the KR10, or 151 chosen ones]",
)
@click.option(
    "--criterion",
    type=click.Choice(["d-optimal", "condition"]),
    help="What chosen poses are best in.  [default: d-optimal]",
)
@click.option(
    "--candidates",
    type=click.IntRange(1, 100_000),
    help="Random poses to choose from.  [default: 2000, or ten a pose]",
)
@click.option("--payload", type=float, metavar="KG", help="[default: the shipped robot's]")
@click.option(
    "--clearance",
    type=float,
    default=0.2,
    metavar="M",
    help="Smallest distance of the arm from the base column.",
)
@seed_option
@output_option("FILE.csv")
def plan(**words: Any) -> None:
    """Write a measurement plan to fill in; without a robot, for the KR10."""
    from stiff_bench.api.measuring import plan_poses

    click.echo(plan_poses(**words))


@data.command()
@click.argument("file", type=FILE)
@robot_options
@no_torque_option
def validate(file: Path, no_torque: bool, **robot: Any) -> int:
    """Check a measured file and name the likeliest mistake in it.

    Exit status: 0 ok; 1 suspicious, the report says why; 2 invalid, no command can use the file.
    """
    from stiff_bench.api import measuring

    report = measuring.validate(file, no_torque=no_torque, **robot)
    click.echo(repr(report))
    if all(word is None for word in robot.values()):
        click.echo(f"No robot was named: {measuring.DEFAULT_ROBOT} was taken.")
    return ("ok", "suspicious", "invalid").index(report.verdict)


@data.command()
@click.option(
    "--twin",
    default="kr10-r1100-2",
    metavar="NAME|FILE.toml",
    help="kr10-r1100-2, ur5, or the constants of your own.",
)
@click.option("--samples", type=click.IntRange(1), default=10_000, help="How many.")
@click.option(
    "--loads",
    type=click.Choice(["line", "line-hook", "omni"]),
    default="omni",
    help="The paper's loads, its forces at a hook, or every direction at a hook.",
)
@click.option("--loads-per-pose", type=click.IntRange(1, 1000), default=1, help="How many.")
@click.option(
    "--specimen", type=click.IntRange(0, 9), default=0, help="Which of ten robots of the type."
)
@seed_option
@output_option("FILE.csv|FILE.parquet")
def simulate(**words: Any) -> None:
    """Write a simulated data set of any size, block by block."""
    from stiff_bench.api import measuring

    click.echo(measuring.simulate(**words))


@data.command()
@click.argument("key", type=click.Choice(["ur5-pose-error"]))
@click.option("--from", "source", type=FILE, metavar="DIR", help="A folder with the files.")
def fetch(key: str, source: Path | None) -> None:
    """Get and check the files of a data set that is not shipped."""
    from stiff_bench.api import measuring

    for path in measuring.fetch(source):
        click.echo(f"{key}: {path}")


@data.command()
@click.argument("key", type=click.Choice(["kr10-measured"]))
@click.argument("file", type=FILE)
@click.option("--urdf", type=FILE, metavar="FILE.urdf", help="[default: the shipped KR10]")
@tcp_option
@no_torque_option
def register(key: str, file: Path, **words: Any) -> None:
    """Make your own measurement a data set with a name."""
    from stiff_bench.api import measuring

    click.echo(measuring.register(key, file, **words))
