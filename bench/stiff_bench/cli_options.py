"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from stiff_bench.robot_words import RobotWords

FILE = click.Path(path_type=Path)

debug_option = click.option(
    "--debug", is_flag=True, expose_value=False, help="Show the traceback of an error."
)
plugin_option = click.option(
    "--plugin",
    "plugins",
    multiple=True,
    type=FILE,
    metavar="FILE.py",
    help="A file that defines MODELS, DATASETS or PROTOCOLS; may be repeated.",
)
settings_option = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY.OPTION=VALUE",
    help="An option of a model, data set or protocol; `bench show KEY` lists them.",
)


def robot_options(command: Any) -> Any:
    """Add the three options that name a robot."""
    for option in (
        click.option(
            "--tcp",
            default="",
            metavar="X,Y,Z",
            help="Tool centre point in the frame of the last link, in m.  [default: the shipped "
            "robot's, or 0,0,0 with --urdf]",
        ),
        click.option("--urdf", type=FILE, metavar="FILE.urdf", help="Your own robot."),
        click.option(
            "--robot",
            metavar="NAME",
            help="A shipped robot: kr10-r1100-2, ur5 or fanuc-r2000ic.  [default: kr10-r1100-2]",
        ),
    ):
        command = option(command)
    return command


def robot_words(words: dict[str, Any]) -> RobotWords:
    """Take the three options out of a command's words."""
    from stiff_bench.robot_words import RobotWords

    return RobotWords(*(words.pop(name) for name in ("robot", "urdf", "tcp")))
