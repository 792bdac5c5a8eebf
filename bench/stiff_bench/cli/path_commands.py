"""The `bench path` commands: words in, one function of `api/path.py` called."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from stiff_bench import api
from stiff_bench.cli.click_options import (
    FILE,
    PICTURE,
    Millimetres,
    Numbers,
    WholeRange,
    coverage_option,
    output_option,
    plugin_option,
    robot_options,
    sheet_option,
)
from stiff_bench.cli.model_commands import model_file_option
from stiff_bench.cli.refusals import Commands
from stiff_bench.console import print_text, warnings_said

FRAME = Numbers("six finite numbers, x,y,z in mm and a,b,c in deg", 6)
load_option = click.option(
    "--load",
    type=Numbers("six finite numbers, fx,fy,fz in N and tx,ty,tz in N m", 6),
    metavar="FX,FY,FZ,TX,TY,TZ",
    help="Process load on the tool at every point, N and N m.",
)


def _held(
    _: click.Context, parameter: click.Parameter, words: tuple[str, ...]
) -> dict[str, float | None]:
    """Return the value of each joint that is held, deg or mm, by the name that was typed."""
    held: dict[str, float | None] = {}
    for word in words:
        name, equals, text = word.partition("=")
        try:
            held[name] = float(text) if equals else None
        except ValueError:
            held[name] = math.nan
        if not name or not math.isfinite(held[name] or 0.0):
            expected = "JOINT=VALUE with a number in deg or mm"
            raise click.BadParameter(f"{word!r}: expected {expected}", param=parameter)
    return held


hold_option = click.option(
    "--hold",
    multiple=True,
    callback=_held,
    metavar="JOINT=VALUE",
    help="Of a robot with more than six joints: hold one, by its name or number (rail, J3, 3), at "
    "this value, deg or mm; may be repeated.",
)


@click.group(cls=Commands)
def path() -> None:
    """Correct tool paths for the deflection under load."""


@path.command()
@click.option(
    "--shape",
    type=click.Choice(["square", "circle", "line", "iso9283"]),
    default="square",
    help="Its shape; iso9283 passes through the five test points of ISO 9283.",
)
@click.option(
    "--size",
    type=Millimetres(1, 1e4),
    default=200.0,
    metavar="MM",
    help="Edge, diameter or length; of iso9283 the edge of the cube.",
)
@click.option("--points", type=WholeRange(2, 1_000_000), default=401, help="Number of points.")
@load_option
@hold_option
@robot_options
@output_option("FILE.csv")
def example(**words: Any) -> None:
    """Write a path that a robot can drive, to try `bench path compensate` on.

    Without --load, a quarter of the robot's payload pulls downwards.
    """
    print_text(api.tool_paths.example_path(**words))


@path.command()
@model_file_option
@click.option(
    "--path", "points", type=FILE, required=True, metavar="FILE", help="Points of the tool."
)
@sheet_option
@output_option("FILE.csv", "New file: commanded poses and joint angles, predicted errors.")
@click.option(
    "--tool",
    type=FRAME,
    metavar="X,Y,Z,A,B,C",
    help="Tool frame in the frame of the last link, mm and deg.  [default: the model's TCP, turned "
    "as the last link]",
)
@click.option(
    "--frame",
    type=FRAME,
    metavar="X,Y,Z,A,B,C",
    help="Frame of the path in the base frame, mm and deg.  [default: the base frame]",
)
@load_option
@click.option(
    "--load-frame",
    type=click.Choice(["base", "tool"]),
    default="base",
    help="Frame that loads are expressed in.",
)
@click.option(
    "--start",
    type=Numbers("one finite number a joint, deg or mm"),
    metavar="Q1,Q2,...",
    help="Joint angles near the first point, deg: they choose the configuration.  [default: the "
    "one nearest to the model's training poses]",
)
@hold_option
@click.option(
    "--tolerance",
    type=Millimetres(1e-5, 10),
    default=1e-3,
    metavar="MM",
    help="Predicted error that may remain.",
)
@click.option(
    "--iterations", type=WholeRange(1, 1000), default=20, help="Predictions of a point at most."
)
@click.option(
    "--on-failure",
    type=click.Choice(["stop", "keep"]),
    default="stop",
    help="At a point that cannot be corrected: stop, or keep it uncorrected and name it.",
)
@coverage_option("Add prediction intervals of this coverage, of each axis.")
@click.option(
    "--figure",
    type=PICTURE,
    metavar="FILE.png",
    help="Draw the path and its errors.",
)
@plugin_option
def compensate(model: Path, points: Path, output: Path, **words: Any) -> None:
    """Write the commands that put the loaded tool on a path.

    The predicted deflection is subtracted at the pose that is commanded, until the loaded tool is
    predicted to be on the path; its orientation is held.
    """
    found = api.model.load_model(model)
    with warnings_said():
        corrected = api.tool_paths.compensate_path(found, points, output, **words)
    print_text(f"{output}: {corrected!r} ({found.name}, robot {found.fitted.robot_.name})")
