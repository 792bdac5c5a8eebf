"""The `bench posture` command: words in, one function of `api/postures.py` called."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from stiff_bench import api
from stiff_bench.cli.click_options import (
    FILE,
    PICTURE,
    FiniteRange,
    Numbers,
    WholeRange,
    coverage_option,
    plugin_option,
    sheet_option,
)
from stiff_bench.cli.help_pages import command
from stiff_bench.cli.model_commands import model_file_option
from stiff_bench.cli.path_commands import (
    FRAME,
    hold_option,
    load_frame_option,
    load_option,
    tool_option,
)
from stiff_bench.console import print_text, warnings_on_stderr


@command(
    epilog="bench posture --model my.stiff --point 900,0,800,0,90,0 --load 0,0,-50,0,0,0\n"
    "bench posture --model my.stiff --path holes.csv --output postures.csv"
)
@model_file_option
@click.option(
    "--point",
    type=FRAME,
    metavar="X,Y,Z,A,B,C",
    help="Pose of the tool at the task point, in mm and deg.  [default: where --given is]",
)
@click.option("--path", type=FILE, metavar="FILE", help="Task of several points: a tool path.")
@sheet_option
@click.option(
    "--workpiece",
    type=FRAME,
    metavar="X,Y,Z,A,B,C",
    help="Frame of the point or path in the base frame, in mm and deg.  [default: the base frame]",
)
@tool_option
@click.option(
    "--tool-axis",
    type=Numbers("three finite numbers, x,y,z", 3),
    default="0,0,1",
    metavar="X,Y,Z",
    help="Axis that the tool may turn about, in the tool frame.",
)
@load_option
@load_frame_option
@click.option(
    "--direction",
    type=click.Choice(["along", "across"]),
    default="along",
    help="Part of the deflection to rank by: along or across the axis.",
)
@click.option(
    "--given",
    type=Numbers("one finite number per joint, deg or mm"),
    metavar="Q1,Q2,...",
    help="Joint angles to compare with, at the (first) point, in deg.  [default: the orientation "
    "of the point, in the configuration nearest to the training poses]",
)
@click.option(
    "--turns",
    type=WholeRange(1, 3600),
    default=72,
    help="Number of turns over 360 deg, counted from the given posture.",
)
@click.option(
    "--turn",
    type=click.Choice(["one", "smooth"]),
    default="one",
    help="Along a path: one turn for all points, or a turn that changes along it.",
)
@click.option(
    "--turn-step",
    type=FiniteRange(0, 180, min_open=True),
    metavar="DEG",
    help="Largest change of a smooth turn between two points.  [default: 360 deg / --turns]",
)
@click.option(
    "--place",
    type=Numbers("six finite lengths in mm, x0,x1,y0,y1,z0,z1", 6),
    metavar="X0,X1,Y0,Y1,Z0,Z1",
    help="Box in the base frame, in mm: the workpiece may be moved so that its (first) point lies "
    "inside.",
)
@hold_option
@coverage_option("Add the model's uncertainty: prediction intervals of this coverage.")
@click.option(
    "--output",
    type=FILE,
    metavar="FILE.csv",
    help="New file: all postures at a point, or the best one along the path.",
)
@click.option(
    "--figure", type=PICTURE, metavar="FILE.png", help="Draw the deflection over the turn."
)
@plugin_option
def posture(model: Path, **words: Any) -> None:
    """Rank the postures of the arm at a point of a task by the predicted deflection.

    The turn of the tool about its axis and the branch of the arm (shoulder, elbow, wrist) are free,
    with --place the position of the workpiece, too. Postures beyond joint limits or near
    singularities are left out. Collisions are not checked.
    """
    fitted = api.model.load_model(model)
    with warnings_on_stderr():
        ranked = api.postures.rank_postures(fitted, **words)
    print_text(repr(ranked))
