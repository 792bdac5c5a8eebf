"""The `bench data` commands: words in, one function of `api/` called."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stiff_bench import api
from stiff_bench.cli.click_options import (
    FILE,
    FiniteRange,
    WholeRange,
    file_options,
    output_option,
    plugin_option,
    robot_of_data,
    robot_option,
    robot_options,
    seed_option,
    settings_option,
    urdf_options,
)
from stiff_bench.cli.help_pages import group
from stiff_bench.console import print_markdown, print_prose, warnings_on_stderr
from stiff_datasets.measured.file_options import FileOptions

if TYPE_CHECKING:
    from stiff_protocols.contract.types import Robot


@group(
    epilog="bench data plan --robot ur5 --output plan.csv\nbench data validate my.csv --robot ur5"
)
def data() -> None:
    """Plan, check, simulate and inspect data sets."""


@data.command(epilog="bench data info fanuc-r2000ic")
@click.argument("key", metavar="KEY|FILE")
@robot_of_data
@file_options
@click.option(
    "--output",
    type=FILE,
    default=Path("results/info"),
    metavar="DIR",
    help="Folder for the picture KEY.png.",
)
@settings_option
@plugin_option
def info(
    key: str, robot: Robot | None, output: Path, settings: tuple[str, ...], **stated: Any
) -> None:
    """Print statistics and the card of a data set, and draw an overview.

    KEY may be your own FILE.csv, .xlsx or .parquet, with --urdf or --robot.
    """
    dataset = api.data_sets.dataset_of_word(key, robot, FileOptions(**stated), settings)
    card = dataset.card
    print_prose(dataset.describe(output))
    if card:
        print_markdown(f"\n{card}")


@data.command(epilog="bench data plan --robot ur5 --poses 60 --output plan.csv")
@robot_options
@click.option(
    "--poses",
    type=WholeRange(1, 10_000),
    help="Number of poses.  [default: 151; the paper's number for the KR10; 10 with --after]",
)
@click.option(
    "--criterion",
    type=click.Choice(["d-optimal", "i-optimal"]),
    help="What poses are chosen for: joint compliances (d-optimal) or predictions (i-optimal).  "
    "[default: d-optimal; i-optimal with --after]",
)
@click.option(
    "--candidates",
    type=WholeRange(1, 100_000),
    help="Number of random poses to choose from.  [default: 2000, or ten per pose]",
)
@click.option(
    "--payload",
    type=FiniteRange(0, min_open=True),
    metavar="KG",
    help="Rated payload, which sets the forces.  [default: the shipped robot's]",
)
@click.option(
    "--clearance",
    type=FiniteRange(0),
    default=0.2,
    metavar="M",
    help="Smallest distance between arm and base column.",
)
@click.option(
    "--after",
    type=FILE,
    metavar="FILE",
    help="Your measurement so far (.csv, .xlsx or .parquet); the plan has the next poses.",
)
@click.option(
    "--model",
    metavar="KEY",
    help="Model to choose poses for, with --after; gp-springs, gp, vjm-gp and mf-gp use their own "
    "intervals.  [default: vjm]",
)
@click.option(
    "--workspace",
    type=FILE,
    metavar="FILE.csv",
    help="Poses and wrenches that predictions are needed for, with --after.  [default: all that "
    "the robot can reach]",
)
@file_options
@plugin_option
@seed_option
@output_option("FILE.csv")
def plan(**words: Any) -> None:
    """Write a measurement plan to fill in.

    Without a robot, the plan is for the KR10. With --after, it continues a measurement and
    estimates what more poses gain.
    """
    print_prose(api.measuring.plan_poses(**words))


@data.command(epilog="bench data validate my.csv --robot ur5")
@click.argument("file", type=FILE)
@robot_options
@file_options
def validate(file: Path, robot: Robot | None, **stated: Any) -> int:
    """Check a measured file and name the likeliest mistake in it.

    Exit status: 0 ok; 1 suspicious, see the report; 2 invalid, other commands refuse the file.
    """
    report = api.measuring.validate(file, robot=robot, **stated)
    print_prose(repr(report))
    if robot is None:
        print_prose(
            f"Robot: {api.measuring.DEFAULT_ROBOT}, the default; name yours: --robot or --urdf"
        )
    return ("ok", "suspicious", "invalid").index(report.verdict)


@data.command(epilog="bench data simulate --twin ur5 --samples 1000 --output simulated.csv")
@click.option(
    "--twin",
    default="kr10-r1100-2",
    metavar="NAME|FILE.toml",
    help="Simulated robot: kr10-r1100-2, kr10-rough, kr10-beam, ur5, an arm such as gp12, or a "
    "file with your own constants.",
)
@click.option("--samples", type=WholeRange(1), default=10_000, help="Number of samples.")
@click.option(
    "--loads",
    type=click.Choice(["line", "line-hook", "omni"]),
    default="omni",
    help="The paper's wrenches (line), its forces at a hook (line-hook), or forces in all "
    "directions at a hook (omni).",
)
@click.option(
    "--loads-per-pose", type=WholeRange(1, 1000), default=1, help="Number of loads per pose."
)
@click.option(
    "--specimen", type=WholeRange(0, 9), default=0, help="Number of the simulated robot, 0 to 9."
)
@click.option(
    "--effects",
    default="none",
    metavar="LIST",
    help="Effects separated by commas: hysteresis, links, kinematics, sensor; or none.",
)
@click.option(
    "--physics",
    type=click.Choice(["tilting", "rigid"]),
    default="tilting",
    help="Tilting bearings as in the twin's file, or rigid bearings and links that bend.",
)
@seed_option
@output_option("FILE.csv|FILE.parquet")
def simulate(**words: Any) -> None:
    """Write a simulated data set of any size."""
    print_prose(api.measuring.simulate(**words))


@data.command(
    epilog="bench data register my.csv --robot ur5 --licence CC-BY-4.0\n"
    "bench data register my.csv --dataset kr10-measured"
)
@click.argument("file", type=FILE)
@robot_option
@urdf_options
@file_options
@click.option(
    "--dataset",
    type=click.Choice(["kr10-measured"]),
    metavar="KEY",
    help="Name that the file gets in other commands; only kr10-measured.",
)
@click.option("--licence", metavar="TEXT", help="SPDX identifier or URL, for a new card.")
@click.option("--citation", metavar="TEXT", help="Reference to cite, for a new card.")
@click.option("--source", metavar="URL", help="Place of publication, for a new card.")
def register(
    file: Path,
    robot: str | None,
    urdf: Path | None,
    tip: str | None,
    tcp: tuple[float, ...] | None,
    dataset: str | None,
    licence: str | None,
    citation: str | None,
    source: str | None,
    **stated: Any,
) -> None:
    """Describe your own CSV file for others.

    Writes a Croissant and a Frictionless descriptor next to the file, from its data card. A file
    without a card gets one to fill in.
    """
    facts = {"Licence": licence, "Citation": citation, "Source": source}
    with warnings_on_stderr():
        report = api.data_files.register(
            file,
            dataset=dataset,
            robot=robot,
            urdf=urdf,
            tip=tip,
            tcp=tcp,
            options=FileOptions(**stated),
            facts={row: text for row, text in facts.items() if text},
        )
    print_prose(report)


@data.command(epilog="bench data export kr10-twin@plan=wide --output shared")
@click.argument("key", metavar="KEY|FILE")
@robot_of_data
@file_options
@output_option("DIR", "Folder for the files; existing files are not overwritten.")
@settings_option
@plugin_option
def export(
    key: str, robot: Robot | None, output: Path, settings: tuple[str, ...], **stated: Any
) -> None:
    """Write a data set as CSV, URDF, data card and descriptors.

    KEY may be your own FILE.csv, .xlsx or .parquet, with --urdf or --robot.
    """
    with warnings_on_stderr():
        dataset = api.data_sets.dataset_of_word(key, robot, FileOptions(**stated), settings)
        report = dataset.export(output)
    print_prose(report)
