"""Options that several commands share."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from stiff_bench.plan.options import Chosen
    from stiff_bench.plan.registry import Registry
    from stiff_bench.plan.request import RunPlan
    from stiff_bench.plan.words import RobotWords
    from stiff_bench.run.execution import Execution


Decorated = TypeVar("Decorated", bound=Callable[..., Any])
FILE = click.Path(path_type=Path)
RESULTS = Path("results/runs")
"""Where results are stored, and read, unless the user says otherwise."""


class FiniteRange(click.FloatRange):
    """A number within bounds; click's own takes "nan" for one, and "inf" where no bound is."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number, or refuse it naming what is valid."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            valid = (
                f"{self.min} or more" if self.max is None else f"between {self.min} and {self.max}"
            )
            self.fail(f"{value} is not a finite number (valid: {valid}).", param, ctx)
        return number


debug_option = click.option(
    "--debug", is_flag=True, expose_value=False, help="Show the traceback of an error."
)
no_torque_option = click.option(
    "--no-torque",
    is_flag=True,
    help="No torques were measured: the columns tx_Nm.. may be missing, or zero.",
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
results_option = click.option(
    "--results",
    type=FILE,
    default=RESULTS,
    show_default=True,
    metavar="DIR",
    help="Folder of the results: the --output of `bench run`.",
)


def seed_option(of: str, most: int = 2**32 - 1) -> Callable[[Decorated], Decorated]:
    """Return the option --seed of something."""
    number = click.IntRange(0, most)
    return click.option("--seed", type=number, default=0, show_default=True, help=f"Of {of}.")


draws_seed_option = seed_option("the resampling of poses")


def device_option(what: str) -> Callable[[Decorated], Decorated]:
    """Return the option that says where networks run; `what` is its help."""
    devices = click.Choice(["auto", "cpu", "cuda"])
    return click.option("--device", type=devices, default="auto", show_default=True, help=what)


def format_option(of: str) -> Callable[[Decorated], Decorated]:
    """Return the option of a command that prints tables, or `of` something like them."""
    return click.option(
        "--format",
        "fmt",
        type=click.Choice(["github", "latex", "csv", "html", "json"]),
        default="github",
        show_default=True,
        help=f"Of {of} on standard output.",
    )


def output_option(what: str) -> Callable[[Decorated], Decorated]:
    """Return the option of a command that writes into a folder; `what` is its help."""
    return click.option(
        "--output", type=FILE, default=RESULTS, show_default=True, metavar="DIR", help=what
    )


def contest_options(command: Any) -> Any:
    """Add the two options that choose among stored results."""
    for name, thing in (("protocol", "A protocol"), ("dataset", "A data set")):
        command = click.option(
            f"--{name}",
            f"{name}s",
            multiple=True,
            metavar="KEY",
            help=f"{thing}, or a key that stands for all its variants; may be repeated.  "
            "[default: all]",
        )(command)
    return command


def models_option(more: str) -> Callable[[Decorated], Decorated]:
    """Return the option that chooses among the models of stored results."""
    text = "A model, or a key that stands for all its variants; may be repeated."
    return click.option("--model", "models", multiple=True, metavar="KEY", help=f"{text} {more}")


def ranking_options(command: Any) -> Any:
    """Add the options that say what is ranked, by what."""
    for option in (
        draws_seed_option,
        click.option(
            "--axis",
            type=click.Choice(["x", "y", "z"]),
            default=None,
            help="Of a metric that has axes.  [default: the mean over the three]",
        ),
        click.option(
            "--metric", default="norm", show_default=True, metavar="KEY", help="What to rank by."
        ),
        contest_options,
        models_option("Ranks are among those that are shown.  [default: all]"),
    ):
        command = option(command)
    return command


def command_line() -> str:
    """Return what the user typed, for the record."""
    return shlex.join(["bench", *sys.argv[1:]])


def data_options(command: Any) -> Any:
    """Add the options that name one's own measurements and their robot."""
    data = click.option(
        "--data",
        type=FILE,
        multiple=True,
        metavar="FILE",
        help="Your own measurement (.csv, .xlsx or .parquet), with --urdf or --robot; may be "
        "repeated.",
    )
    return data(robot_options(no_torque_option(command)))


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
            help="A shipped robot: kr10-r1100-2, ur5 or fanuc-r2000ic.  [default: kr10-r1100-2; "
            "--data needs --robot or --urdf]",
        ),
    ):
        command = option(command)
    return command


def chosen(words: dict[str, Any], registry: Registry) -> Chosen:
    """Take the options that choose models, data sets and protocols out of a command's words.

    Raises:
        ConfigError: a key, option or value is unknown or wrong.
    """
    from stiff_bench.plan.words import choices

    names = ("models", "datasets", "protocols", "settings", "data", "no_torque")
    given = {name: words.pop(name) for name in names if name in words}
    return choices(registry, robot=robot_words(words), **given)


def robot_words(words: dict[str, Any]) -> RobotWords:
    """Take the three options out of a command's words."""
    from stiff_bench.plan.words import RobotWords

    if words["robot"] == "":
        raise click.BadParameter("an empty word names no robot", param_hint="--robot")
    return RobotWords(*(words.pop(name) for name in ("robot", "urdf", "tcp")))


_OPTIONS = (
    click.option(
        "--isolate/--no-isolate",
        default=None,
        help="Compute every cell in a process of its own, so that it can end no other.  [default: "
        "with several jobs, a limit, a cluster or a plugin's model]",
    ),
    click.option(
        "--timeout",
        type=FiniteRange(0, 1e7, min_open=True),
        metavar="SECONDS",
        help="Wall time that a cell may take.  [default: any]",
    ),
    click.option(
        "--memory",
        metavar="SIZE",
        help="Memory that a cell's process may take, such as 2GiB or 500MB.  [default: any]",
    ),
    click.option(
        "--threads",
        type=click.IntRange(1, 1024),
        help="Threads of the linear algebra in a cell, whatever the number of jobs.  [default: "
        "OMP_NUM_THREADS, or 1]",
    ),
    click.option(
        "--dask",
        default="",
        metavar="CLUSTER",
        help="Compute on a Dask cluster: tcp://HOST:PORT of its scheduler, or local:N workers.",
    ),
    click.option(
        "--plan",
        is_flag=True,
        help="Compute nothing; print how many cells there are, how many of them are in --output, "
        "and the time that the others will take by the stored fits of the same models.",
    ),
    click.option(
        "--rerun",
        type=click.Choice(["missing", "failed", "all"]),
        default="missing",
        show_default=True,
        help="Which cells are computed: those without a result or failure in --output, those that "
        "failed too, or all.",
    ),
)


def execution_options(command: Any, *, usual_jobs: str = "") -> Any:
    """Add the options.

    Args:
        command: that gets them.
        usual_jobs: what the help says of how many cells run at once by default; "": one.
    """
    jobs = click.option(
        "--jobs",
        type=click.IntRange(1, 1024),
        default=1,
        show_default=usual_jobs or True,
        help="How many cells run at once, each in a process of its own.",
    )
    for option in reversed((jobs, *_OPTIONS)):
        command = option(command)
    return command


def begin_execution(words: dict[str, Any]) -> dict[str, Any]:
    """Take the options out of a command's words; the number of threads holds from here on.

    To be called before anything heavy is imported, since libraries read it when they are loaded.
    """
    from stiff_bench.run.machine import pin_threads, threads_asked_for

    names = ("jobs", "isolate", "timeout", "memory", "threads", "dask", "rerun", "plan")
    taken = {name: words.pop(name) for name in names}
    taken["threads"] = taken["threads"] or threads_asked_for()
    pin_threads(taken["threads"])
    return taken


def execution_of(taken: dict[str, Any], plan: RunPlan, registry: Registry) -> Execution:
    """Return what the options mean for a plan.

    Raises:
        ConfigError: one is wrong, or two contradict each other.
    """
    from stiff_bench.run.cell_process import Limits
    from stiff_bench.run.execution import chosen_execution

    limits = Limits(taken["threads"], taken["timeout"], _bytes(taken["memory"]))
    others = {name: taken[name] for name in ("jobs", "isolate", "dask", "rerun")}
    return chosen_execution(plan, registry, limits=limits, **others)


def _bytes(size: str | None) -> int | None:
    """Return a size in bytes.

    Raises:
        ConfigError: it is none.
    """
    from pydantic import ByteSize, TypeAdapter, ValidationError

    from stiff_protocols.contract.errors import ConfigError

    if size is None:
        return None
    try:
        found = int(TypeAdapter(ByteSize).validate_python(size))
    except ValidationError:
        found = 0
    if found <= 0:
        raise ConfigError(f"--memory {size!r}: no size (valid: 2GiB, 500MB, ...)")
    return found
