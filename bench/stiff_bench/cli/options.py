"""Options that several commands share."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import click

from stiff_bench.api import RESULTS
from stiff_bench.api.process import pinned

Command = TypeVar("Command", bound=Callable[..., Any])
FILE = click.Path(path_type=Path)


class FiniteRange(click.FloatRange):
    """A number within bounds; click's own takes "nan" for one, and "inf" where no bound is."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number, or refuse it naming what is valid."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not finite (valid: {self._describe_range()}).", param, ctx)
        return number


class Millimetres(FiniteRange):
    """A length, such as 0.01 or 0.01mm."""

    name = "mm"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number of millimetres, or refuse it naming what is valid."""
        try:
            return super().convert(float(str(value).removesuffix("mm")), param, ctx)
        except ValueError:
            self.fail(f"{value!r} is no length (valid: 0.01mm, 0.01, ...)", param, ctx)


class Tcp(click.ParamType[tuple[float, ...]]):
    """A tool centre point, such as 0.06,0,0.08."""

    name = "tcp"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the lengths, or refuse a text that is no three of them."""
        try:
            x, y, z = (float(word) for word in value.split(","))
        except ValueError:
            x = y = z = math.nan
        if not math.isfinite(x + y + z):
            self.fail(f"{value!r}: expected three finite lengths in m, x,y,z", param, ctx)
        return x, y, z


class Picture(click.Path):
    """A file whose suffix names a picture's format."""

    def __init__(self) -> None:
        """Be a path."""
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path, or refuse it naming the formats."""
        from stiff_bench.api.figures import check_suffix

        path = Path(str(super().convert(value, param, ctx)))
        check_suffix(path)
        return path


class Size(click.ParamType[int]):
    """A number of bytes, such as 2GiB."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the bytes, or refuse a text that is no size."""
        from pydantic import ByteSize, TypeAdapter, ValidationError

        try:
            size = int(TypeAdapter(ByteSize).validate_python(value))
        except ValidationError:
            size = 0
        if size <= 0:
            self.fail(f"{value!r} is no size (valid: 2GiB, 500MB, ...)", param, ctx)
        return size


PROBABILITY = FiniteRange(0, 1, min_open=True, max_open=True)
several_keys = partial(click.option, multiple=True, metavar="KEY")


def together(*options: Callable[[Any], Any]) -> Callable[[Command], Command]:
    """Return one decorator that adds several options, in this order."""

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def output_option(metavar: str, text: str = "A new file.") -> Callable[[Command], Command]:
    """Return the required option that names what is written."""
    return click.option("--output", type=FILE, required=True, metavar=metavar, help=text)


no_torque_option = click.option(
    "--no-torque",
    is_flag=True,
    help="No torques were measured: the columns tx_Nm.. may be missing, or zero.",
)


def _used(_: click.Context, __: click.Parameter, files: tuple[Path, ...]) -> None:
    from stiff_bench.api.catalog import use_only

    use_only(files)


plugin_option = click.option(
    "--plugin",
    multiple=True,
    expose_value=False,
    callback=_used,
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
results_option = click.option(
    "--results",
    type=FILE,
    default=RESULTS,
    metavar="DIR",
    help="Folder of the results: the --output of `bench run`.",
)
seed_option = click.option(
    "--seed",
    type=click.IntRange(0, 2**32 - 20_000),  # a split's is this one and its number
    default=0,
    help="Of all random numbers.",
)
device_option = click.option(
    "--device",
    type=click.Choice(["auto", "cpu", "cuda"]),
    default="auto",
    help="Where networks run.",
)
FORMATS = click.Choice(["github", "latex", "csv", "html", "json"])
format_option = click.option(
    "--format", "fmt", type=FORMATS, default="github", help="Of standard output."
)
models_option = several_keys(
    "--model", "models", help="A model, or a key for all its variants; may be repeated."
)
case_options = together(
    several_keys(
        "--dataset", "datasets", help="A data set, or a key for all its variants; may be repeated."
    ),
    several_keys(
        "--protocol", "protocols", help="A protocol, or a key for all its variants; likewise."
    ),
)
ranking_options = together(
    models_option,
    case_options,
    click.option("--metric", default="norm", metavar="KEY", help="What to rank by."),
    click.option(
        "--axis", type=click.Choice(["x", "y", "z"]), help="Of the metric.  [default: their mean]"
    ),
    seed_option,
)
tcp_option = click.option(
    "--tcp",
    type=Tcp(),
    metavar="X,Y,Z",
    help="Tool centre point in the frame of the last link, in m.  [default: the shipped robot's, "
    "or 0,0,0 with --urdf]",
)
robot_options = together(
    click.option(
        "--robot",
        metavar="NAME",
        help="A shipped one: kr10-r1100-2 (the default, but for --data), ur5 or fanuc-r2000ic.",
    ),
    click.option("--urdf", type=FILE, metavar="FILE.urdf", help="Your own robot."),
    tcp_option,
)

data_options = together(
    click.option(
        "--data",
        type=FILE,
        multiple=True,
        metavar="FILE",
        help="Your own measurement (.csv, .xlsx or .parquet), with --urdf or --robot; may be "
        "repeated.",
    ),
    no_torque_option,
    robot_options,
)


def command_line() -> str:
    """Return what the user typed, for the record."""
    return shlex.join(["bench", *sys.argv[1:]])


def taken(words: dict[str, Any], *names: str) -> dict[str, Any]:
    """Take these options out of a command's words."""
    return {name: words.pop(name) for name in names if name in words}


def _pinned(_: click.Context, __: click.Parameter, number: int | None) -> int:
    """Give the number to the libraries, which read it when they are loaded: before that."""
    return pinned(number)


def execution_options(usual_jobs: str) -> Callable[[Command], Command]:
    """Return the options that say how cells are computed, and how many at once by default."""
    return together(
        click.option(
            "--jobs",
            type=click.IntRange(1, 1024),
            help=f"How many cells run at once, each in its own process.  [default: {usual_jobs}]",
        ),
        click.option(
            "--isolate/--no-isolate",
            default=None,
            help="Compute every cell in its own process.  [default: with several jobs, a limit, a "
            "cluster or a plugin's model]",
        ),
        click.option(
            "--timeout",
            type=FiniteRange(0, 1e7, min_open=True),
            metavar="SECONDS",
            help="Wall time that a cell may take.  [default: any]",
        ),
        click.option(
            "--memory",
            type=Size(),
            metavar="SIZE",
            help="Memory that a cell may take, such as 2GiB or 500MB.  [default: any]",
        ),
        click.option(
            "--threads",
            type=click.IntRange(1, 1024),
            callback=_pinned,
            help="Threads of a cell.  [default: OMP_NUM_THREADS, or 1]",
        ),
        click.option(
            "--dask",
            default="",
            show_default=False,
            metavar="CLUSTER",
            help="Compute on a Dask cluster: tcp://HOST:PORT of its scheduler, or local:N workers.",
        ),
        click.option(
            "--rerun",
            type=click.Choice(["missing", "failed", "all"]),
            default="missing",
            help="Cells to compute: those without a result or failure, the failed ones too, or "
            "all.",
        ),
        click.option(
            "--plan",
            "plan_only",
            is_flag=True,
            help="Compute nothing; print how many cells are missing, and how long they take.",
        ),
    )


EXECUTION = ("jobs", "isolate", "timeout", "memory", "threads", "dask", "rerun")
"""The words of `execution_options` that `chosen_execution` takes."""
