"""Options that several commands share."""

from __future__ import annotations

import inspect
import math
import shlex
import sys
from collections.abc import Callable
from functools import partial, reduce, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from stiff_bench import api
from stiff_bench.api import LARGEST_POSE_TOLERANCE, POSE_TOLERANCE, RESULTS
from stiff_bench.console import print_text
from stiff_bench.run.machine import pinned
from stiff_bench.tables.picture_file import check_suffix
from stiff_bench.tables.table import SCREEN
from stiff_datasets.measured.file_options import DEFAULTS, FileOptions
from stiff_protocols.contract.errors import ConfigError

if TYPE_CHECKING:
    from stiff_bench.tables.writers import Tables
    from stiff_protocols.contract.types import Robot

Command = TypeVar("Command", bound=Callable[..., Any])
Context = click.Context | None
Parameter = click.Parameter | None


class FilePath(click.Path):
    """A file or folder; an empty word, such as an unset variable of a script, would be "."."""

    def convert(self, value: Any, param: Parameter, ctx: Context) -> Any:
        """Return the path, or refuse an empty one."""
        if str(value) == "":
            self.fail("'' (valid: the name of a file or folder)", param, ctx)
        return super().convert(value, param, ctx)


FILE = FilePath(path_type=Path)


class PicturePath(FilePath):
    """A picture to write; its suffix is checked before anything is computed."""

    def convert(self, value: Any, param: Parameter, ctx: Context) -> Any:
        """Return the path, or refuse a suffix that names no format."""
        path = super().convert(value, param, ctx)
        check_suffix(path)
        return path


PICTURE = PicturePath(path_type=Path)


class Bounded(click.ParamType[float]):
    """A number within bounds that errors name and help does not.

    click's own also accepts "nan", and "inf" without a bound.
    """

    kind, unit = "a number", ""
    min: Any
    max: Any
    min_open: bool
    max_open: bool

    def convert(self, value: Any, param: Parameter, ctx: Context) -> Any:
        """Return the number, or refuse it naming what is valid."""
        try:
            number = super().convert(str(value).removesuffix(self.unit), param, ctx)
            if math.isfinite(number):
                return number
        except click.BadParameter:
            pass
        self.fail(f"{value!r} (valid: {self.kind}, {self._bounds()})", param, ctx)

    def _describe_range(self) -> str:
        """Return nothing: bounds such as 1<=x<=10000 do not help to choose a number."""
        return ""

    def _bounds(self) -> str:
        """Return the bounds as words: "at least 1 and at most 10000"."""
        lower = "above" if self.min_open else "at least"
        upper = "below" if self.max_open else "at most"
        bounds = ((lower, self.min), (upper, self.max))
        return " and ".join(f"{word} {bound:.15g}" for word, bound in bounds if bound is not None)


class WholeRange(Bounded, click.IntRange):
    """A whole number within bounds."""

    name, kind = "n", "a whole number"


class FiniteRange(Bounded, click.FloatRange):
    """A number within bounds."""

    name = "number"


class Fraction(FiniteRange):
    """A number within bounds in 0 to 1."""

    name = "fraction"


class Millimetres(FiniteRange):
    """A length within bounds, such as 0.01 or 0.01mm."""

    name = unit = "mm"
    kind = "a length in mm such as 0.5 or 0.5mm"


class Numbers(click.ParamType[tuple[float, ...]]):
    """Numbers with commas between, such as 0.06,0,0.08."""

    name = "numbers"

    def __init__(self, what: str, *counts: int) -> None:
        """Remember what they are, and how many there may be; without counts at least one."""
        self.what, self.counts = what, counts

    def convert(self, value: Any, param: Parameter, ctx: Context) -> tuple[float, ...]:
        """Return the numbers, or refuse a text that is none of them."""
        try:
            numbers = tuple(float(word) for word in str(value).split(","))
        except ValueError:
            numbers = (math.nan,)
        if not all(map(math.isfinite, numbers)) or (
            self.counts and len(numbers) not in self.counts
        ):
            self.fail(f"{value!r} (valid: {self.what})", param, ctx)
        return numbers


SMALLEST_SIZE = 2**20
"""Bytes; smaller numbers are refused, because their unit is probably missing."""


class Size(click.ParamType[int]):
    """A number of bytes, such as 2GiB."""

    name = "size"

    def convert(self, value: Any, param: Parameter, ctx: Context) -> int:
        """Return the bytes, or refuse a text without a size."""
        from pydantic import ByteSize, TypeAdapter, ValidationError

        try:
            size = int(TypeAdapter(ByteSize).validate_python(value))
        except ValidationError:
            size = 0
        if size < SMALLEST_SIZE:
            self.fail(
                f"{value!r} (valid: a size with its unit, such as 2GiB or 500MB, at least 1MiB)",
                param,
                ctx,
            )
        return size


PROBABILITY = Fraction(0, 1, min_open=True, max_open=True)


def coverage_option(text: str) -> Callable[[Command], Command]:
    """Return the option of the coverage of prediction intervals."""
    return click.option("--coverage", type=PROBABILITY, help=text)


several_keys = partial(click.option, multiple=True, metavar="KEY")


def together(*options: Callable[[Any], Any]) -> Callable[[Command], Command]:
    """Return one decorator that adds several options, in this order."""
    return lambda command: reduce(lambda made, option: option(made), reversed(options), command)


def output_option(metavar: str, text: str = "A new file.") -> Callable[[Command], Command]:
    """Return the required option that names what is written."""
    return click.option("--output", type=FILE, required=True, metavar=metavar, help=text)


sheet_option = click.option(
    "--sheet",
    metavar="NAME",
    help="Sheet of an Excel file.  [default: the only one with a table]",
)
file_options = together(
    click.option(
        "--no-torque",
        is_flag=True,
        help="Torques were not measured: tx_Nm, ty_Nm and tz_Nm may be missing or zero.",
    ),
    sheet_option,
    click.option(
        "--pose-tolerance",
        type=FiniteRange(0, LARGEST_POSE_TOLERANCE),
        default=POSE_TOLERANCE,
        metavar="DEG",
        help="Rows without pose_id are one pose if their joint positions differ by at most this, "
        "in deg (prismatic joints: mm).",
    ),
)


plugin_option = click.option(
    "--plugin",
    multiple=True,
    expose_value=False,
    callback=lambda _, __, files: api.registered.use_only(files),
    type=FILE,
    metavar="FILE.py",
    help="Python file with your MODELS, DATASETS or PROTOCOLS; may be repeated.",
)
settings_option = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY.OPTION=VALUE",
    help="Set an option that `bench show KEY` lists; may be repeated.",
)
results_option = click.option(
    "--results",
    type=FILE,
    default=RESULTS,
    metavar="DIR",
    help="Folder of results: the --output of `bench run`.",
)
seed_option = click.option(
    "--seed",
    type=WholeRange(0, 2**32 - 20_000),  # a split's is this one and its number
    default=0,
    help="Seed of all random numbers.",
)
device_option = click.option(
    "--device",
    type=click.Choice(["auto", "cpu", "cuda"]),
    default="auto",
    help="Device that networks run on.",
)
FORMATS = click.Choice(["github", "latex", "csv", "html", "json"])
format_option = click.option(
    "--format",
    "fmt",
    type=FORMATS,
    metavar="FORMAT",
    callback=lambda _, __, fmt: fmt or (SCREEN if sys.stdout.isatty() else "github"),
    help="Format of tables: github, latex, csv, html or json.  [default: on a terminal, tables "
    "that fit it; else github]",
)


def print_tables(tables: Tables, fmt: str) -> None:
    """Print tables in a format of `format_option`."""
    print_text(tables.text_as(fmt), laid_out=fmt == SCREEN)


def gathered(
    name: str, make: Callable[..., Any], *options: Callable[[Any], Any]
) -> Callable[[Command], Command]:
    """Return a decorator that adds options; `make` gets them, the command its result as `name`."""
    parameters = inspect.signature(make).parameters

    def decorated(command: Command) -> Command:
        @wraps(command)
        def call(**words: Any) -> Any:
            values = {key: words.pop(key) for key in parameters if key in words}
            return command(**{name: make(**values)}, **words)

        return cast(Command, together(*options)(call))

    return decorated


def _selection(
    datasets: tuple[str, ...],
    protocols: tuple[str, ...],
    conditions: tuple[str, ...],
    models: tuple[str, ...] = (),
) -> api.pictures.Selection:
    return api.pictures.Selection(models, datasets, protocols, conditions)


_VARIANTS = "Only this {}, or all variants of a key; may be repeated."
case_options = gathered(
    "selection",
    _selection,
    several_keys("--dataset", "datasets", help=_VARIANTS.format("data set")),
    several_keys("--protocol", "protocols", help=_VARIANTS.format("protocol")),
    several_keys(
        "--condition", "conditions", help='Only this condition of a protocol, such as "n = 40".'
    ),
)
"""Options that choose among stored results, of a command that names its models itself."""
selection_options = together(
    several_keys("--model", "models", help=_VARIANTS.format("model")), case_options
)
ranking_options = together(
    selection_options,
    click.option("--metric", default="norm", metavar="KEY", help="Metric to rank by."),
    click.option(
        "--axis",
        type=click.Choice(["x", "y", "z"]),
        help="Axis of the metric.  [default: mean over axes]",
    ),
    seed_option,
)
urdf_options = together(
    click.option("--urdf", type=FILE, metavar="FILE.urdf", help="URDF of your own robot."),
    click.option(
        "--tip",
        metavar="LINK",
        help="Last link of the robot in the URDF.  [default: end of the longest chain, without "
        "fingers]",
    ),
    click.option(
        "--tcp",
        type=Numbers("three finite lengths in m, x,y,z", 3),
        metavar="X,Y,Z",
        help="Tool centre point in the frame of the last link, in m.  [default: the shipped "
        "robot's, or 0,0,0 with --urdf]",
    ),
)


def _robot_of_data(
    robot: str | None, urdf: Path | None, tip: str | None, tcp: tuple[float, ...] | None
) -> Robot | None:
    """Return the robot that is named; None without any option."""
    if urdf is not None and robot is not None:
        raise ConfigError(f"{robot} and --urdf {urdf}: give only one of them", "robot")
    if urdf is not None:
        return api.robots.read_robot(urdf, tcp=tcp, tip=tip)
    if tip is not None:
        raise ConfigError(f"{tip} requires --urdf", "tip")
    if robot is not None:
        return api.robots.load_robot(robot, tcp=tcp)
    if tcp is not None:
        raise ConfigError("requires --urdf or --robot", "tcp")
    return None


def _robot(
    robot: str | None, urdf: Path | None, tip: str | None, tcp: tuple[float, ...] | None
) -> Robot | None:
    """The same of a command with a default robot, whose TCP may be another one."""
    if urdf is None and tcp is not None:
        robot = robot or api.robots.DEFAULT_ROBOT
    return _robot_of_data(robot, urdf, tip, tcp)


robot_option = click.option(
    "--robot",
    metavar="NAME",
    help="A shipped robot: kr10-r1100-2 (the default, except with --data), ur5, fanuc-r2000ic, "
    "or an arm of `arm-family` such as gp12.",
)
robot_options = gathered("robot", _robot, robot_option, urdf_options)
robot_of_data = gathered("robot", _robot_of_data, robot_option, urdf_options)
"""The same of a file of samples, whose robot must be named."""


def _data(
    data: tuple[Path, ...],
    robot: Robot | None,
    no_torque: bool,
    sheet: str | None,
    pose_tolerance: float,
) -> list[api.data_sets.Dataset]:
    """Return the data sets of files."""
    options = FileOptions(no_torque, sheet, pose_tolerance)
    if not data and (robot is not None or options != DEFAULTS):
        raise ConfigError(
            "--robot, --urdf, --no-torque, --sheet and --pose-tolerance require --data FILE"
        )
    return [api.data_sets.Dataset.of_file(file, robot, options) for file in data]


data_options = gathered(
    "data",
    _data,
    click.option(
        "--data",
        type=FILE,
        multiple=True,
        metavar="FILE",
        help="Your measurement (.csv, .xlsx or .parquet); requires --urdf or --robot; may be "
        "repeated.",
    ),
    file_options,
    robot_of_data,
)


def command_line(without: str = "") -> str:
    """Return the user's command for the record, without an option `without` and its value."""
    words = sys.argv[1:]
    if without:
        words = [word for word in words if not word.startswith(f"{without}=")]
        if without in words:
            place = words.index(without)
            del words[place : place + 2]
    return shlex.join(["bench", *words])


def execution_options(usual_jobs: str) -> Callable[[Command], Command]:
    """Return the options that say how fits are computed, and how many at once by default."""
    return together(
        click.option(
            "--jobs",
            type=WholeRange(1, 1024),
            help=f"Number of parallel fits, each in its own process.  [default: {usual_jobs}]",
        ),
        click.option(
            "--isolate/--no-isolate",
            default=None,
            help="Run each fit in its own process.  [default: only with several jobs, a limit, a "
            "cluster or a model of a plugin]",
        ),
        click.option(
            "--timeout",
            type=FiniteRange(0, 1e7, min_open=True),
            metavar="SECONDS",
            help="Time limit of each fit.  [default: none]",
        ),
        click.option(
            "--memory",
            type=Size(),
            metavar="SIZE",
            help="Memory limit of each fit, such as 2GiB or 500MB.  [default: none]",
        ),
        click.option(
            "--threads",
            type=WholeRange(1, 1024),
            callback=lambda _, __, number: pinned(number),  # before a library reads it
            help="Threads of each fit.  [default: OMP_NUM_THREADS, or 1]",
        ),
        click.option(
            "--dask",
            default="",
            show_default=False,
            metavar="CLUSTER",
            help="Compute on a Dask cluster; give its scheduler, tcp://HOST:PORT.",
        ),
        click.option(
            "--rerun",
            type=click.Choice(["missing", "failed", "all"]),
            default="missing",
            help="Fits to run: those without a stored result, the failed ones too, or all.",
        ),
        click.option(
            "--plan",
            "plan_only",
            is_flag=True,
            help="Only estimate: print how many fits are missing and how long they take. One fit "
            "per new model is timed.",
        ),
    )
