"""Options that several commands share."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable
from functools import partial, reduce, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from stiff_bench.api import LARGEST_POSE_TOLERANCE, POSE_TOLERANCE, RESULTS
from stiff_bench.run.machine import pinned
from stiff_protocols.contract.errors import ConfigError

if TYPE_CHECKING:
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


class Bounded(click.ParamType[float]):
    """A number within bounds; click's own takes "nan" for one, and "inf" where no bound is."""

    kind, unit = "a number", ""

    def convert(self, value: Any, param: Parameter, ctx: Context) -> Any:
        """Return the number, or refuse it naming what is valid."""
        try:
            number = super().convert(str(value).removesuffix(self.unit), param, ctx)
            if math.isfinite(number):
                return number
        except click.BadParameter:
            pass
        self.fail(f"{value!r} (valid: {self.kind} {self.bounds})", param, ctx)

    @property
    def bounds(self) -> str:
        """In words: "from 1 to 10", "above 0 and below 1" or "of at least 0"."""
        low, high, open_low, open_high = (
            getattr(self, name) for name in ("min", "max", "min_open", "max_open")
        )
        if None not in (low, high) and not open_low and not open_high:
            return f"from {low} to {high}"
        ends = (
            "" if low is None else f"{'above' if open_low else 'of at least'} {low:g}",
            "" if high is None else f"{'below' if open_high else 'of at most'} {high:g}",
        )
        return " and ".join(filter(None, ends))


class WholeRange(Bounded, click.IntRange):
    """A whole number within bounds."""

    kind = "a whole number"


class FiniteRange(Bounded, click.FloatRange):
    """A number within bounds."""


class Millimetres(FiniteRange):
    """A length within bounds, such as 0.01 or 0.01mm."""

    name = unit = "mm"
    kind = "a length such as 0.01mm or 0.01,"


class Numbers(click.ParamType[tuple[float, ...]]):
    """Numbers with commas between, such as 0.06,0,0.08."""

    name = "numbers"

    def __init__(self, what: str, count: int | None = None) -> None:
        """Remember what they are, and how many there must be; None: at least one."""
        self.what, self.count = what, count

    def convert(self, value: Any, param: Parameter, ctx: Context) -> tuple[float, ...]:
        """Return the numbers, or refuse a text that is none of them."""
        try:
            numbers = tuple(float(word) for word in str(value).split(","))
        except ValueError:
            numbers = (math.nan,)
        if not all(map(math.isfinite, numbers)) or self.count not in (None, len(numbers)):
            self.fail(f"{value!r}: expected {self.what}", param, ctx)
        return numbers


SMALLEST_SIZE = 2**20
"""Bytes; a smaller number lacks its unit."""


class Size(click.ParamType[int]):
    """A number of bytes, such as 2GiB."""

    name = "size"

    def convert(self, value: Any, param: Parameter, ctx: Context) -> int:
        """Return the bytes, or refuse a text that is no size."""
        from pydantic import ByteSize, TypeAdapter, ValidationError

        try:
            size = int(TypeAdapter(ByteSize).validate_python(value))
        except ValidationError:
            size = 0
        if size < SMALLEST_SIZE:
            self.fail(f"{value!r} is no size (valid: 2GiB, 500MB, ... from 1MiB)", param, ctx)
        return size


PROBABILITY = FiniteRange(0, 1, min_open=True, max_open=True)


def coverage_options(text: str) -> Callable[[Command], Command]:
    """Add --coverage, and --coverage-3d, which says the same of all three axes at once."""

    def decorated(command: Command) -> Command:
        @click.option("--coverage", type=PROBABILITY, help=text)
        @click.option(
            "--coverage-3d",
            type=PROBABILITY,
            help="In place of --coverage: that of X, Y and Z at once, a box.",
        )
        @wraps(command)
        def call(*, coverage: float | None, coverage_3d: float | None, **words: Any) -> Any:
            if coverage_3d is not None:
                from stiff_bench.api.model import coverage_of_each_axis

                if coverage is not None:
                    raise click.UsageError("give one of --coverage and --coverage-3d")
                coverage = coverage_of_each_axis(coverage_3d)
            try:
                return command(coverage=coverage, **words)
            except ConfigError as error:
                if coverage_3d is not None and error.argument == "coverage":
                    error.argument = f"coverage-3d {coverage_3d:g}, of each axis"  # what was typed
                raise

        return cast(Command, call)

    return decorated


def picture(_: click.Context, __: click.Parameter, file: Path | None) -> Path | None:
    """Refuse a file whose suffix names no picture's format."""
    if file is not None:
        from stiff_bench.tables.picture_file import check_suffix

        check_suffix(file)
    return file


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
    help="Sheet of an Excel file.  [default: the only one that holds a table]",
)
file_options = together(
    click.option(
        "--no-torque",
        is_flag=True,
        help="No torques were measured: the columns tx_Nm.. may be missing, or zero.",
    ),
    sheet_option,
    click.option(
        "--pose-tolerance",
        type=FiniteRange(0, LARGEST_POSE_TOLERANCE),
        default=POSE_TOLERANCE,
        metavar="DEG",
        help="Largest difference of the joint positions of one pose, in deg (mm of prismatic "
        "joints): rows without pose_id are grouped by it.",
    ),
)


def _used(_: click.Context, __: click.Parameter, files: tuple[Path, ...]) -> None:
    from stiff_bench.api.registered import use_only

    use_only(files)


plugin_option = click.option(
    "--plugin",
    multiple=True,
    expose_value=False,
    callback=_used,
    type=FILE,
    metavar="FILE.py",
    help="Python file that defines MODELS, DATASETS or PROTOCOLS; may be repeated.",
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
    help="Folder of results, the --output of `bench run`.",
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
    "--format", "fmt", type=FORMATS, default="github", help="Format of standard output."
)


def selection_options(command: Command, *, of_models: bool = True) -> Command:
    """Add the options that choose among stored results; the command gets a `Selection`."""
    text = "A {}, or a key for all its variants; may be repeated."

    @several_keys("--dataset", "datasets", help=text.format("data set"))
    @several_keys("--protocol", "protocols", help=text.format("protocol"))
    @several_keys("--condition", "conditions", help='Condition of a protocol: "n = 40".')
    @wraps(command)
    def call(
        *,
        datasets: tuple[str, ...],
        protocols: tuple[str, ...],
        conditions: tuple[str, ...],
        models: tuple[str, ...] = (),
        **words: Any,
    ) -> Any:
        from stiff_bench.analysis.selection import Selection

        return command(selection=Selection(models, datasets, protocols, conditions), **words)

    models = several_keys("--model", "models", help=text.format("model"))
    return cast(Command, models(call) if of_models else call)


case_options = partial(selection_options, of_models=False)
"""The same without the models, of a command that names them itself."""
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
tcp_option = click.option(
    "--tcp",
    type=Numbers("three finite lengths in m, x,y,z", 3),
    metavar="X,Y,Z",
    help="Tool centre point in the frame of the last link, in m.  [default: the shipped robot's, "
    "or 0,0,0 with --urdf]",
)
urdf_options = together(
    click.option("--urdf", type=FILE, metavar="FILE.urdf", help="URDF of your own robot."),
    click.option(
        "--tip",
        metavar="LINK",
        help="Last link of the robot in the URDF.  [default: the end of the longest chain, without "
        "fingers]",
    ),
    tcp_option,
)


def robot_options(command: Command, *, has_default: bool = True) -> Command:
    """Add the options that name a robot; the command gets it as `robot`, None without any.

    Without a default, --tcp alone is of no robot.
    """

    @click.option(
        "--robot",
        metavar="NAME",
        help="A shipped robot: kr10-r1100-2 (the default, except with --data), ur5, fanuc-r2000ic "
        "or an arm of `arm-family` such as gp12.",
    )
    @urdf_options
    @wraps(command)
    def call(
        *,
        robot: str | None,
        urdf: Path | None,
        tip: str | None,
        tcp: tuple[float, ...] | None,
        **words: Any,
    ) -> Any:
        from stiff_bench.api.robots import DEFAULT_ROBOT, load_robot, read_robot

        if urdf is not None and robot is not None:
            raise ConfigError(f"{robot} and urdf {urdf}: give one of them", "robot")
        if urdf is None and tip is not None:
            raise ConfigError(f"{tip}: names a link of a URDF; give --urdf too", "tip")
        found = None
        if urdf is not None:
            found = read_robot(urdf, tcp=tcp, tip=tip)
        elif robot is not None or (tcp is not None and has_default):
            found = load_robot(DEFAULT_ROBOT if robot is None else robot, tcp=tcp)
        elif tcp is not None:
            raise ConfigError(f"{tcp}: of which robot? Give --urdf or --robot too", "tcp")
        return command(robot=found, **words)

    return cast(Command, call)


robot_of_data = partial(robot_options, has_default=False)
"""The same of a file of samples, whose robot must be named."""


def data_options(command: Command) -> Command:
    """Add the options that name files of samples; the command gets data sets as `data`."""

    @click.option(
        "--data",
        type=FILE,
        multiple=True,
        metavar="FILE",
        help="Your own measurement (.csv, .xlsx or .parquet), with --urdf or --robot; may be "
        "repeated.",
    )
    @file_options
    @robot_of_data
    @wraps(command)
    def call(*, data: tuple[Path, ...], robot: Robot | None, **words: Any) -> Any:
        from stiff_bench.api.data_sets import Dataset
        from stiff_datasets.measured.file_options import DEFAULTS, FileOptions

        names = ("no_torque", "sheet", "pose_tolerance")
        options = FileOptions(**{name: words.pop(name) for name in names})
        if not data and robot is not None:
            raise ConfigError("--robot and --urdf name the robot of --data; give it too")
        if not data and options != DEFAULTS:
            raise ConfigError(
                "--no-torque, --sheet and --pose-tolerance are of a measured file; give --data too"
            )
        files = [Dataset.of_file(file, robot, options) for file in data]
        return command(data=files, **words)

    return cast(Command, call)


def command_line() -> str:
    """Return what the user typed, for the record."""
    return shlex.join(["bench", *sys.argv[1:]])


def _pinned(_: click.Context, __: click.Parameter, number: int | None) -> int:
    """Give the number to the libraries, which read it when they are loaded: before that."""
    return pinned(number)


def execution_options(usual_jobs: str) -> Callable[[Command], Command]:
    """Return the options that say how fits are computed, and how many at once by default."""
    return together(
        click.option(
            "--jobs",
            type=WholeRange(1, 1024),
            help=f"Number of fits at once, each in its own process.  [default: {usual_jobs}]",
        ),
        click.option(
            "--isolate/--no-isolate",
            default=None,
            help="Run each fit in its own process.  [default: with several jobs, a limit, a "
            "cluster or a plugin's model]",
        ),
        click.option(
            "--timeout",
            type=FiniteRange(0, 1e7, min_open=True),
            metavar="SECONDS",
            help="Limit on the wall time of a fit.  [default: none]",
        ),
        click.option(
            "--memory",
            type=Size(),
            metavar="SIZE",
            help="Limit on the memory of a fit, such as 2GiB or 500MB.  [default: none]",
        ),
        click.option(
            "--threads",
            type=WholeRange(1, 1024),
            callback=_pinned,
            help="Threads of each fit.  [default: OMP_NUM_THREADS, or 1]",
        ),
        click.option(
            "--dask",
            default="",
            show_default=False,
            metavar="CLUSTER",
            help="Compute on a Dask cluster: tcp://HOST:PORT of its scheduler.",
        ),
        click.option(
            "--rerun",
            type=click.Choice(["missing", "failed", "all"]),
            default="missing",
            help="Fits to run: those without a stored result or failure, the failed ones too, or "
            "all.",
        ),
        click.option(
            "--plan",
            "plan_only",
            is_flag=True,
            help="Only print how many fits are missing and how long they would take; a fit of each "
            "model without a stored one is timed.",
        ),
    )
