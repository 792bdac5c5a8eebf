"""The `bench map` command: words in, `api.stiffness_maps.stiffness_map` called, the answer out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from stiff_bench import api
from stiff_bench.cli.click_options import FILE, PICTURE, Numbers, WholeRange, plugin_option
from stiff_bench.cli.help_pages import command
from stiff_bench.cli.model_commands import model_file_option
from stiff_bench.cli.path_commands import (
    hold_option,
    load_frame_option,
    load_option,
    tool_option,
)
from stiff_bench.console import print_prose, warnings_on_stderr


class Orientation(Numbers):
    """Three angles with commas between, or a word for some."""

    name = "orientation"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return the angles or the word, or refuse the text."""
        return value if value == "down" else super().convert(value, param, ctx)


@command("map", epilog="bench map --model my.stiff --load 0,0,-100 --plane xz --output map.png")
@model_file_option
@load_option
@load_frame_option
@click.option(
    "--quantity",
    type=click.Choice(["deflection", "compliance"]),
    default="deflection",
    help="Deflection under --load in mm, or compliance of the TCP in mm/kN.",
)
@click.option(
    "--axis",
    type=click.Choice(["x", "y", "z", "tool"]),
    help="Component along an axis of the base frame or the tool's z axis.  [default: length of the "
    "deflection, or largest principal compliance]",
)
@click.option(
    "--plane",
    type=click.Choice(["xy", "xz", "yz"]),
    default="xz",
    help="Plane of the map in the base frame.",
)
@click.option(
    "--at",
    type=Numbers("one finite number or several, in mm"),
    metavar="MM,...",
    help="Place of the plane, or of several planes, on the third axis.  [default: with --box its "
    "two ends and the middle, else the middle of the training poses]",
)
@click.option(
    "--box",
    type=Numbers("six finite numbers, x0,x1,y0,y1,z0,z1 in mm", 6),
    metavar="X0,X1,Y0,Y1,Z0,Z1",
    help="Region of the map, in mm.  [default: all that the robot reaches]",
)
@click.option(
    "--grid",
    type=WholeRange(2, 500),
    default=100,
    help="Number of points along the longer edge of a plane.",
)
@click.option(
    "--orientation",
    type=Orientation("down, or three finite numbers a,b,c in deg", 3),
    default="down",
    metavar="A,B,C",
    help="Orientation of the tool in the base frame, in deg; down is 0,0,180.",
)
@click.option(
    "--turn",
    type=click.Choice(["fixed", "best"]),
    default="fixed",
    help="Turn about the tool's z axis: none, or per point the best in steps of 30 deg.",
)
@tool_option
@hold_option
@click.option(
    "--output",
    type=FILE,
    metavar="FILE",
    help="New file: a row per point (.csv, .parquet) or the picture (.png, .svg, .pdf).",
)
@click.option(
    "--figure", type=PICTURE, metavar="FILE.png", help="Draw the map, with --output for the table."
)
@plugin_option
def map_(model: Path, **words: Any) -> None:
    """Map the predicted deflection or compliance over the workspace.

    Each point has the configuration of the arm that is nearest to the model's training poses.
    Points out of reach, beyond joint limits or at a singularity are blank; points far from the
    training poses are hatched.
    """
    fitted = api.model.load_model(model)
    with warnings_on_stderr():
        new_map = api.stiffness_maps.stiffness_map(fitted, **words)
    files = ", ".join(str(words[name]) for name in ("output", "figure") if words[name])
    lines = [
        new_map.answer,
        f"{new_map.model_name}, robot {new_map.robot.name}: {new_map.quantity_text}",
        f"{new_map.place_text}; blank: {new_map.blank_text}",
        *[f"written: {files}"] * bool(files),
    ]
    print_prose("\n".join(lines))
