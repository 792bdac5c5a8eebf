"""The `bench path` commands: words in, one function of `api/path.py` called."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

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
from stiff_bench.cli.help_pages import group
from stiff_bench.cli.model_commands import model_file_option
from stiff_bench.console import print_prose, warnings_on_stderr
from stiff_protocols.contract.errors import ConfigError

ONLY_PATH = ("sheet", "hold", "on_failure")
ONLY_PROGRAM = ("loads", "every", "strict")
"""Options that only go with `--path`, or with `--program`."""
FRAME = Numbers("six finite numbers, x,y,z in mm and a,b,c in deg", 6)
load_option = click.option(
    "--load",
    type=Numbers("three or six finite numbers, fx,fy,fz in N and tx,ty,tz in N m", 3, 6),
    metavar="FX,FY,FZ[,TX,TY,TZ]",
    help="Process load on the tool at every point, in N and N m.",
)

load_frame_option = click.option(
    "--frame",
    type=click.Choice(["base", "tool"]),
    default="base",
    help="Frame that loads are expressed in.",
)

tool_option = click.option(
    "--tool",
    type=FRAME,
    metavar="X,Y,Z,A,B,C",
    help="Tool frame in the frame of the last link, in mm and deg.  [default: the model's TCP with "
    "the axes of the last link]",
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
    help="Hold a joint, by name or number (rail, J3, 3), at a value in deg or mm, for robots with "
    "more than six joints; may be repeated.",
)


@group(
    epilog="bench path example --model my.stiff --output square.csv\n"
    "bench path compensate --model my.stiff --path square.csv --output new.csv"
)
def path() -> None:
    """Correct tool paths for the deflection under load."""


@path.command(
    epilog="bench path example --shape circle --size 300mm --output circle.csv\n"
    "bench path example --model my.stiff --output square.csv"
)
@click.option(
    "--shape",
    type=click.Choice(["square", "circle", "line", "iso9283"]),
    default="square",
    help="Shape of the path; iso9283 passes through the five test points of ISO 9283.",
)
@click.option(
    "--size",
    type=Millimetres(1, 1e4),
    default=200.0,
    metavar="MM",
    help="Edge, diameter or length of the shape; for iso9283 the edge of the cube.",
)
@click.option("--points", type=WholeRange(2, 1_000_000), default=401, help="Number of points.")
@load_option
@hold_option
@click.option(
    "--model",
    type=FILE,
    metavar="FILE",
    help="Model file of `bench fit`: the path is for its robot, inside its training range.",
)
@robot_options
@plugin_option
@output_option("FILE.csv")
def example(model: Path | None, **words: Any) -> None:
    """Write an example path for `bench path compensate`.

    Without --load, a quarter of the robot's payload pulls downwards. For a model it is half of the
    training load that pulls downwards most, and the path is about a training pose.
    """
    fitted = None if model is None else api.model.load_model(model)
    print_prose(api.tool_paths.example_path(model=fitted, **words))


@path.command(epilog="bench path compensate --model my.stiff --path circle.csv --output new.csv")
@model_file_option
@click.option(
    "--path",
    "points",
    type=FILE,
    metavar="FILE",
    help="Tool path: a file of points.",
)
@click.option(
    "--program",
    type=FILE,
    metavar="FILE",
    help="In place of --path a robot program, written back with corrected targets: KUKA .src (with "
    "its .dat), ABB .mod, FANUC .ls or URScript .script.",
)
@sheet_option
@output_option(
    "FILE", "New file: commands of the path, or the corrected program with the suffix of --program."
)
@click.option(
    "--tool",
    type=FRAME,
    metavar="X,Y,Z,A,B,C",
    help="Tool frame in the frame of the last link, in mm and deg; for a program that does not "
    "hold it, in the controller's flange frame.  [default: the model's TCP with the axes of the "
    "last link]",
)
@click.option(
    "--workpiece",
    type=FRAME,
    metavar="X,Y,Z,A,B,C",
    help="Frame of the path or program in the base frame, in mm and deg.  [default: the base "
    "frame, or the program's own]",
)
@load_option
@click.option(
    "--loads",
    type=FILE,
    metavar="FILE",
    help="Loads of a program by line: columns line, fx_N, fy_N, fz_N and torques.",
)
@load_frame_option
@click.option(
    "--start",
    type=Numbers("one finite number a joint, deg or mm"),
    metavar="Q1,Q2,...",
    help="Joint angles near the first point, in deg; they choose the configuration.  [default: the "
    "configuration nearest to the model's training poses]",
)
@hold_option
@click.option(
    "--every",
    type=Millimetres(0.01, 1e4),
    metavar="MM",
    help="Put points between the targets of straight motions of a program, at most so far apart.",
)
@click.option("--strict", is_flag=True, help="Stop if a motion of a program cannot be corrected.")
@click.option(
    "--tolerance",
    type=Millimetres(1e-5, 10),
    default=1e-3,
    metavar="MM",
    help="Largest last step of the iteration.",
)
@click.option(
    "--iterations",
    type=WholeRange(1, 1000),
    default=20,
    help="Largest number of predictions per point.",
)
@click.option(
    "--on-failure",
    type=click.Choice(["stop", "keep"]),
    default="stop",
    help="If a point of a path cannot be corrected: stop, or keep it uncorrected and name it.",
)
@coverage_option("Expected remaining error from prediction intervals of this coverage, per axis.")
@click.option(
    "--figure",
    type=PICTURE,
    metavar="FILE.png",
    help="Draw the path, what is removed and what may remain.",
)
@plugin_option
def compensate(
    model: Path, points: Path | None, program: Path | None, output: Path, **words: Any
) -> None:
    """Write the commands that put the loaded tool on a path.

    The predicted deflection at the commanded pose is subtracted. The orientation of the tool does
    not change. The output says what is removed, and what error may remain on the robot. A robot
    program is corrected in place: every other character stays as it was.
    """
    if (points is None) == (program is None):
        raise ConfigError("needed once: a file of points, or else --program", "path")
    context = click.get_current_context()
    for name in ONLY_PROGRAM if program is None else ONLY_PATH:
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT:
            kind = "--path" if name in ONLY_PATH else "--program"
            raise ConfigError(f"only goes with {kind}", name.replace("_", "-"))
        del words[name]
    fitted = api.model.load_model(model)
    with warnings_on_stderr():
        warnings.filterwarnings("ignore", r".* beyond the training range")  # printed below
        corrected: object
        files = str(output)
        if points is not None:
            corrected = api.tool_paths.compensate_path(fitted, points, output, **words)
        elif program is not None:
            done = api.robot_programs.compensate_program(fitted, program, output, **words)
            corrected, files = done, ", ".join(map(str, done.files))
    print_prose(f"{corrected!r}\n{files}: {fitted.name}, robot {fitted.fitted.robot_.name}")
