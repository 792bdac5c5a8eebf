"""Define the options that several commands share: what makes a model, a robot, data or results.

The parameters of such a function, with the texts of its "Args:", are the options.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import stiffbench as sb
from stiff_bench.api import RESULTS
from stiff_bench.console import SCREEN
from stiff_bench.parameter_types import (
    Bounds,
    Bytes,
    FilePath,
    Folder,
    Form,
    HeldJoints,
    Point,
)
from stiff_datasets.measured.file_options import DEFAULTS, FileOptions
from stiff_protocols.contract.errors import ConfigError

AtMost1024 = Annotated[int, Bounds(at_least=1, at_most=1024)]
Seconds = Annotated[float, Form("SECONDS"), Bounds(above=0.0, at_most=1e7)]


def read_model(model: FilePath) -> sb.Model:
    """Read a fitted model.

    Args:
        model: file of a fitted model, written by `bench fit`.
    """
    return sb.load_model(model)


def name_robot(
    robot: str | None = None,
    urdf: FilePath | None = None,
    tip: str | None = None,
    base: str | None = None,
    hold: HeldJoints | None = None,
    tcp: Point | None = None,
) -> sb.Robot | None:
    """Return the named robot; None without any option.

    Args:
        robot: shipped robot: kr10-r1100-2 (the default, except for your own data), ur5,
            fanuc-r2000ic, or an arm of `arm-family` such as gp12.
        urdf: URDF of your own robot, in place of --robot.
        tip: last link of the robot in the URDF; by default the end of the longest chain, without
            fingers.
        base: first link of the robot in the URDF, and the base frame; by default the URDF's.
        hold: joint of the URDF that does not move, such as a rail, at a value in deg or mm, by name
            or number (rail, J3, 3); may be repeated.
        tcp: tool centre point in the frame of the last link, in m; by default the shipped robot's,
            or 0,0,0 with --urdf.
    """
    if urdf is not None:
        if robot is not None:
            raise ConfigError(f"{robot} and --urdf {urdf}: give only one of them", "robot")
        return sb.read_robot(urdf, tcp=tcp, tip=tip, base=base, hold=hold)
    for option, value in (("tip", tip), ("base", base), ("hold", ", ".join(hold or ()))):
        if value:
            raise ConfigError(f"{value} requires --urdf", option)
    if robot is not None:
        return sb.load_robot(robot, tcp=tcp)
    if tcp is not None:
        raise ConfigError("requires --urdf or --robot", "tcp")
    return None


def find_dataset(
    key: str, robot: sb.Robot | None, options: FileOptions, settings: Sequence[str] = ()
) -> sb.Dataset:
    """Return the data set of a key or of a file.

    Args:
        key: data set of `bench list datasets`; or your own .csv, .xlsx or .parquet file, with
            --urdf or --robot.
        settings: option of the data set, KEY.OPTION=VALUE; may be repeated.
    """
    from stiff_bench.plan.options import chosen_dataset
    from stiff_bench.plan.registry import registry

    path = Path(key)
    if path.suffix.lower() in (".csv", ".xlsx", ".parquet"):
        if settings:
            raise ConfigError(f"--set {settings[0]!r}: the file {key} has no options")
        return sb.Dataset.of_file(path, robot, options)
    if robot is not None or options != DEFAULTS or path.is_file():
        raise ConfigError(
            f"{key}: not a file of samples (valid: .csv, .xlsx or .parquet; a KEY takes no "
            "--robot, --urdf, --tip, --base, --hold, --tcp, --no-torque, --sheet, "
            "--pose-tolerance, --register or --hook)"
        )
    return sb.Dataset(chosen_dataset(key, settings, registry()))


def find_own_data(
    robot: sb.Robot | None, options: FileOptions, data: Sequence[Path] = ()
) -> list[sb.Dataset]:
    """Return the data sets of files.

    Args:
        data: your measurement (.csv, .xlsx or .parquet); requires --urdf or --robot; may be
            repeated.
    """
    if not data and (robot is not None or options != DEFAULTS):
        raise ConfigError(
            "--robot, --urdf, --no-torque, --sheet, --pose-tolerance, --register and --hook "
            "require --data FILE"
        )
    return [sb.Dataset.of_file(file, robot, options) for file in data]


def select(
    models: Sequence[str] = (),
    datasets: Sequence[str] = (),
    protocols: Sequence[str] = (),
    conditions: Sequence[str] = (),
) -> sb.Selection:
    """Select models, data sets, protocols and conditions.

    Args:
        models: only this model, or all variants of a key; may be repeated.
        datasets: only this data set, or all variants of a key; may be repeated.
        protocols: only this protocol, or all variants of a key; may be repeated.
        conditions: only this condition of a protocol, such as "n = 40"; may be repeated.
    """
    return sb.Selection((*models,), (*datasets,), (*protocols,), (*conditions,))


def open_results(
    selection: Annotated[sb.Selection, select], results: Folder = RESULTS
) -> sb.Results:
    """Return selected results of a folder.

    Args:
        results: folder of results: the --output of `bench run`.
    """
    return sb.Results(Path(results), command=command_line(), selection=selection)


def use_plugins(plugin: Sequence[Path] = ()) -> None:
    """Use the models, data sets and protocols of plugins.

    Args:
        plugin: Python file with your MODELS, DATASETS or PROTOCOLS; may be repeated.
    """
    from stiff_bench.plan.registry import use_only

    use_only(plugin)


def choose_format(fmt: Literal["github", "latex", "csv", "html", "json"] | None = None) -> str:
    """Choose the format of tables.

    Args:
        fmt: format of tables; by default github, and on a terminal tables that fit it.
    """
    return fmt or (SCREEN if sys.stdout.isatty() else "github")


@dataclass(frozen=True)
class Execution:
    """Execution of the fits of a run.

    Attributes:
        jobs: number of parallel fits, each in its own process; by default 1, and for `bench
            reproduce` the number of cores.
        isolate: run each fit in its own process; by default only with several jobs, a limit, a
            cluster or a model of a plugin.
        timeout: time limit of each fit; by default none.
        memory: memory limit of each fit, such as 2GiB or 500MB; by default none.
        threads: threads of each fit; by default OMP_NUM_THREADS, or 1.
        dask: compute on a Dask cluster; give its scheduler, tcp://HOST:PORT.
        rerun: fits to run: those without a stored result, the failed ones too, or all.
    """

    jobs: AtMost1024 | None = None
    isolate: bool | None = None
    timeout: Seconds | None = None
    memory: Bytes | None = None
    threads: AtMost1024 | None = None
    dask: Annotated[str, Form("CLUSTER")] = ""
    rerun: Literal["missing", "failed", "all"] = "missing"

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of a run, with the number of threads, which is set here."""
        from stiff_bench.run.machine import pinned

        return {**vars(self), "threads": pinned(self.threads)}


@dataclass(frozen=True)
class Limits:
    """Limits of the fits that a submission needs.

    Attributes:
        jobs: number of parallel fits.
        timeout: time limit of each fit.
        memory: memory limit of each fit; by default 4GiB.
    """

    jobs: AtMost1024 = 1
    timeout: Seconds = 600.0
    memory: Bytes = 4 * 2**30


MAKERS: dict[str, Callable[..., Any]] = {
    "Dataset": find_dataset,
    "Execution": Execution,
    "FileOptions": FileOptions,
    "Limits": Limits,
    "Model": read_model,
    "Results": open_results,
    "Robot": name_robot,
}
"""Type of a parameter -> function or class whose parameters are its options."""


def command_line(without: str = "") -> str:
    """Return the user's command for the record, without an option `without` and its value."""
    words = sys.argv[1:]
    if without:
        words = [word for word in words if not word.startswith(f"{without}=")]
        if without in words:
            place = words.index(without)
            del words[place : place + 2]
    return shlex.join(["bench", *words])
