"""Plan measurements, check measured files, and simulate measurements."""

from __future__ import annotations

import shlex
import time
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from stiff_bench.analysis import pose_plans
from stiff_bench.api.data_sets import Dataset, path_of
from stiff_bench.api.model import model_choice
from stiff_bench.api.robots import as_robot, payload_of, robot_words
from stiff_bench.console import say
from stiff_bench.parameter_types import Bounds, Count, FilePath, Form, Point, PoseTolerance, Seed
from stiff_bench.plan.fits import loaded
from stiff_bench.plan.options import measured_file
from stiff_bench.run.progress import display
from stiff_bench.tables.writers import Text
from stiff_datasets.measured import validation_report as validation
from stiff_datasets.measured.file_options import DEFAULTS, POSE_TOLERANCE, FileOptions
from stiff_datasets.measured.sample_columns import Criterion
from stiff_datasets.measured.table_reader import Sheet, sheet_of
from stiff_datasets.planning.plan import check_plan_file, write_plan
from stiff_datasets.planning.reading_plan import write_readings
from stiff_datasets.robots.shipped_robots import DEFAULT_ROBOT as DEFAULT_ROBOT
from stiff_datasets.robots.urdf_writer import robot_urdf
from stiff_datasets.twin import simulate as simulation
from stiff_datasets.twin.effects import World
from stiff_datasets.twin.experiment import Approach
from stiff_datasets.twin.fresh_arms import FRESH_ARM, fresh_arm
from stiff_datasets.twin.robot_twin import TwinData
from stiff_datasets.twin.twin_file import (
    TwinConstants,
    read_constants,
    shipped_constants,
    shipped_twins,
)
from stiff_models.model_catalog import model_info
from stiff_protocols.contract.errors import ConfigError, ModelError, StiffBenchWarning
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.types import AXES, FloatArray, Robot, Samples
from stiff_protocols.springs.identification import contributions


def plan_poses(
    output: FilePath,
    *,
    poses: Annotated[int, Bounds(at_least=1, at_most=10_000)] | None = None,
    criterion: Criterion | None = None,
    candidates: Annotated[int, Bounds(at_least=1, at_most=100_000)] | None = None,
    payload: Annotated[float, Form("KG"), Bounds(above=0.0)] | None = None,
    clearance: Annotated[float, Form("M"), Bounds(at_least=0.0)] = 0.2,
    seed: Seed = 0,
    robot: str | Robot | None = None,
    after: FilePath | None = None,
    model: str | None = None,
    workspace: FilePath | None = None,
    loads: Literal["any", "weights"] = "any",
    readings: Count | None = None,
    forces: Annotated[str, Form("FORCES")] = "weight,pull:0,1,0",
    axes: Annotated[str, Form("AXES")] = "z,y",
    no_torque: bool = False,
    sheet: str | None = None,
    pose_tolerance: PoseTolerance = POSE_TOLERANCE,
    register: bool = False,
    hook: Point | None = None,
) -> Text:
    """Write a measurement plan to fill in.

    Without a robot, the plan is for the KR10. With `after`, it continues a measurement.

    Args:
        output: new .csv file.
        poses: number of poses; by default 60, and 10 with `after`. Joints keep 2 deg (10 mm)
            from their limits.
        criterion: criterion of the choice: joint compliances (d-optimal) or predictions
            (i-optimal); by default d-optimal, and i-optimal with `after`.
        candidates: number of random poses to choose from; by default 2000, or ten per pose.
        payload: rated payload in kg, which sets the forces; by default the shipped robot's.
        clearance: smallest distance between arm and base column, in m.
        seed: seed of all random numbers.
        robot: robot to measure: a shipped name or a `Robot`; by default the KR10.
        after: measurement so far (.csv, .xlsx or .parquet); the plan has the next poses.
        model: model to choose poses for, with `after`: bayes-springs (the default), gp, vjm-gp
            or a plug-in by its own posterior, or vjm by joint springs.
        workspace: file (.csv) of poses and wrenches that predictions are needed for, with `after`;
            by default all that the robot can reach.
        loads: forces in any direction, or drawn weights that hang at the TCP, of 25 to 100 % of
            80 % of the payload.
        readings: number of a dial gauge's readings, in place of poses: each is a pose, a force of
            `forces` in a drawn size, and an axis of `axes`.
        forces: forces of readings, at the hook: weight, pull:X,Y,Z along a direction of the base
            frame, or several with commas.
        axes: axes of the base frame that the gauge can stand along, with commas.
        no_torque: torques were not measured: their columns may be missing, or zero.
        sheet: sheet of an Excel file; by default the only one with a table.
        pose_tolerance: rows without `pose_id` are one pose if their joint positions differ by at
            most this, in deg (prismatic joints: mm).
        register: positions are in a tracker's frame: turn the deflections to the base frame, by the
            unloaded positions and the joint angles.
        hook: where weights hang and ropes pull (`mass_kg`, `pull_N`), in the frame of the last
            link, in m; by default the TCP.

    Raises:
        ConfigError: an argument is wrong, or the payload is unknown.
        DataError: a file cannot be read, or belongs to another robot.
        StoreError: the file cannot be written, or exists.
    """
    output, arm = Path(output), as_robot(robot)
    check_plan_file(output)
    options = FileOptions(no_torque, sheet, pose_tolerance, register, hook)
    if readings is None and (forces, axes) != ("weight,pull:0,1,0", "z,y"):
        raise ConfigError("requires a number of readings; add --readings N", "forces")
    if readings is not None and (poses is not None or after is not None or loads != "any"):
        raise ConfigError(
            f"{readings}: a plan of readings has no --poses, --after and --loads", "readings"
        )
    if after is None:
        of_file = asdict(options) | ({"hook": None} if readings else {})
        given = {"model": model, "workspace": workspace, **of_file}
        for name, value in given.items():
            if value != vars(DEFAULTS).get(name):
                needed = "requires measured poses; add --after FILE"
                raise ConfigError(needed, name.replace("_", "-"))
    payload = payload_of(arm) if payload is None else payload
    if payload is None:
        raise ConfigError(f"is unknown for {arm.name}; give a payload in kg", "payload")
    how = pose_plans.PlanOptions(
        poses, criterion, candidates, payload, clearance, seed, loads == "weights"
    )
    if readings is not None:
        with display():
            choice = pose_plans.reading_plan(arm, how, readings, forces, axes, hook)
        write_readings(output, choice.plan, arm)
        words = f"{robot_words(arm)} {shlex.join(options.words)}".rstrip()
        return Text(choice.report(output, arm, words))
    if after is None:
        with display():
            plan = pose_plans.first_plan(arm, how)
        measured = None
    else:
        file = measured_file(Path(after), arm, options)
        fitted = model_choice(model or pose_plans.PLANNING_MODEL, {})
        measured = pose_plans.Measured(str(after), loaded(file).samples, arm, fitted)
        with display():
            plan = pose_plans.next_plan(measured, how, workspace)
    write_plan(output, plan.plan, arm)
    words = f"{robot_words(arm)} {shlex.join(options.words)}".rstrip()
    return Text(plan.report(output, arm, words, measured))


def validate(
    file: FilePath | object,
    *,
    robot: str | Robot | None = None,
    no_torque: bool = False,
    sheet: str | None = None,
    pose_tolerance: PoseTolerance = POSE_TOLERANCE,
    register: bool = False,
    hook: Point | None = None,
) -> validation.ValidationReport:
    """Check a measured file and name the likeliest mistake in it.

    Exit status of the command: 0 ok; 1 suspicious, see the report; 2 invalid, other commands refuse
    the file.

    Args:
        file: your measurement (.csv, .xlsx or .parquet); in Python also a data set, or a DataFrame
            with the columns of a file.
        robot: measured robot: a shipped name or a `Robot`; by default the KR10.
        no_torque: torques were not measured: their columns may be missing, or zero.
        sheet: sheet of an Excel file; by default the only one with a table.
        pose_tolerance: rows without `pose_id` are one pose if their joint positions differ by at
            most this, in deg (prismatic joints: mm); two poses this near are suspicious.
        register: positions are in a tracker's frame: turn the deflections to the base frame, by the
            unloaded positions and the joint angles.
        hook: where weights hang and ropes pull (`mass_kg`, `pull_N`), in the frame of the last
            link, in m; by default the TCP.

    Returns:
        A printable report; its `verdict` is "ok", "suspicious" or "invalid". Rows of a data set
        or a DataFrame count from 0.

    Raises:
        ConfigError: `file` is neither a path nor a table, the robot's name is unknown, or a data
            set gets another robot.
    """
    from pandas import DataFrame

    options = FileOptions(no_torque, sheet, pose_tolerance, register, hook)
    source: Path | Sheet
    if isinstance(file, Dataset):
        if robot is not None:
            raise ConfigError("is part of the data set; only a file or DataFrame needs it", "robot")
        robot, source = file.robot, sheet_of(Path(file.name), file.frame(), first_row=0)
    elif isinstance(file, DataFrame):
        source = sheet_of(Path("own-data"), file, first_row=0)
    else:
        source = path_of(file)
    return validation.validate(source, as_robot(robot), options, _identified_parts)


MOST_PARTS, LEAST_OFFSET_MM, LEAST_WEIGHT_CHANGE = 2, 5.0, 15.0
"""Parts that `validate` names; mm and % from which force point and weights are named."""


def _identified_parts(samples: Samples, robot: Robot) -> tuple[FloatArray, dict[str, str]]:
    """Return (n, 3) errors [m] of `bayes-springs` at left-out readings, and facts on its parts.

    Without a fit the errors are NaN, and the facts are empty.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)  # the report has the same message
        try:
            model = model_info("bayes-springs").load()().fit(samples, robot=robot)
        except ModelError:
            return np.full(samples.deflection.shape, np.nan), {}
    numbers = model.diagnostics_
    sizes = {name: size for name, (size, *_) in contributions(numbers).items() if size}
    largest = sorted(sizes, key=sizes.__getitem__, reverse=True)[:MOST_PARTS]
    parts = ", ".join(f"{name} {sizes[name]:.2g}" for name in largest)
    facts = {"what moves the tool": f"{parts} mm"} if parts else {}
    point = np.array([numbers[f"force point from the TCP, {axis} [mm]"] for axis in AXES])
    if np.linalg.norm(point) > LEAST_OFFSET_MM:
        place = ", ".join(f"{length:.0f}" for length in point)
        facts["force point"] = f"({place}) mm from the TCP, in the frame of the last joint"
    weights = {name: numbers[f"weights on {name} [%]"] for name in robot.joint_names}
    changed = {n: share for n, share in weights.items() if abs(share - 100) > LEAST_WEIGHT_CHANGE}
    if changed:
        facts["weights"] = ", ".join(
            f"{share:.0f} % of the description's on {name}" for name, share in changed.items()
        )
    return model.fold_errors_, facts


def simulate(
    output: FilePath,
    *,
    twin: str = "kr10-r1100-2",
    samples: Count = 10_000,
    loads: Literal["line", "line-hook", "omni"] = "omni",
    loads_per_pose: Annotated[int, Bounds(at_least=1, at_most=1000)] = 1,
    specimen: Annotated[int, Bounds(at_least=0, at_most=9)] = 0,
    seed: Seed = 0,
    world: World = "clean",
    approach: Approach = "random",
    all_columns: bool = False,
) -> Text:
    """Write a simulated data set of any size.

    Args:
        output: new .csv or .parquet file.
        twin: simulated robot: kr10-r1100-2, ur5, an arm such as gp12, fresh-arm-17 of `fresh-arms`
            (its .urdf is written, too), or a .toml file with your own constants.
        samples: number of samples.
        loads: the paper's wrenches (line), its forces at a hook (line-hook), or forces in all
            directions at a hook (omni).
        loads_per_pose: number of loads per pose.
        specimen: number of the simulated robot, 0 to 9.
        seed: seed of poses, loads and noise.
        world: what robot and measurement have beyond gear curves, tilting bearings and noise:
            friction, structure, a workshop's errors, all of these, or unseen by any model.
        approach: how a pose is reached in a world with friction.
        all_columns: also write approach and the unloaded reading after each load.

    Raises:
        DataError: bending links need sections, which the twin's file does not have.
        ConfigError: the twin is unknown, or the file's extension is not supported.
        StoreError: the file exists, or cannot be written.
    """
    start = time.perf_counter()
    options = TwinData(specimen=specimen, seed=seed, world=world, approach=approach)
    constants = _constants(twin)
    experiment = options.experiment(constants, loads=loads, loads_per_pose=loads_per_pose)
    urdf = Path(output).with_suffix(".urdf")
    if is_fresh := twin.startswith(FRESH_ARM):
        check_new_file(urdf)
    with display():
        simulation.simulate(Path(output), experiment, samples, all_columns=all_columns)
    if is_fresh:
        urdf.write_text(robot_urdf(constants.robot()), encoding="utf-8")
    seconds = time.perf_counter() - start
    return Text(
        f"{output}: {samples} SIMULATED samples of {twin}, specimen {specimen}, in "
        f"{seconds:.1f} s ({samples / seconds:.0f} samples/s)"
    )


def _constants(twin: str) -> TwinConstants:
    """Read the constants of a shipped twin or of a TOML file."""
    shipped = shipped_twins()
    if twin in shipped:
        return shipped_constants(shipped[twin])
    if twin.startswith(FRESH_ARM) and (seed := twin.removeprefix(FRESH_ARM)).isdecimal():
        return fresh_arm(int(seed))
    if not twin.endswith(".toml"):
        valid = f"{', '.join(shipped)}, {FRESH_ARM}0 and further numbers, or FILE.toml"
        raise ConfigError(f"{twin!r} (valid: {valid})", "twin")
    constants = read_constants(Path(twin))
    for note in constants.chain().notes:
        say(f"note: {note}")
    return constants
