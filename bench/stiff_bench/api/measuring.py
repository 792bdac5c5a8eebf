"""Before and after a measurement: plan it, check its file, simulate one."""

from __future__ import annotations

import time
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Literal

import numpy as np

from stiff_bench.analysis import pose_plans
from stiff_bench.api.model import model_choice
from stiff_bench.api.robots import as_robot, payload_of, robot_words, shipped_name
from stiff_bench.api.tables import Text
from stiff_bench.console import say
from stiff_bench.plan.options import measured_file
from stiff_bench.plan.request import loaded
from stiff_bench.run.progress import display
from stiff_datasets.measured import validation_report as validation
from stiff_datasets.measured.file_options import DEFAULTS, POSE_TOLERANCE, FileOptions
from stiff_datasets.planning.design import Criterion
from stiff_datasets.planning.plan import check_plan_file, write_plan
from stiff_datasets.robots.shipped_robots import DEFAULT_ROBOT as DEFAULT_ROBOT
from stiff_datasets.twin import simulate as simulation
from stiff_datasets.twin.constants import (
    TwinConstants,
    TwinPhysics,
    read_constants,
    shipped_constants,
    shipped_twins,
)
from stiff_datasets.twin.twin import TwinExperiment
from stiff_datasets.twin.twin_effects import parse_effects
from stiff_models.model_catalog import REFERENCE_MODEL, model_info
from stiff_protocols.contract.errors import ConfigError, ModelError, StiffBenchWarning
from stiff_protocols.contract.types import FloatArray, Robot, Samples


def plan_poses(
    output: Path | str,
    *,
    poses: int | None = None,
    criterion: Criterion | None = None,
    candidates: int | None = None,
    payload: float | None = None,
    clearance: float = 0.2,
    seed: int = 0,
    robot: str | Robot | None = None,
    after: Path | str | None = None,
    model: str | None = None,
    workspace: Path | str | None = None,
    no_torque: bool = False,
    sheet: str | None = None,
    pose_tolerance: float = POSE_TOLERANCE,
) -> Text:
    """Write a measurement plan to fill in, and return what it gains over random plans.

    Args:
        output: a new FILE.csv.
        poses: how many to choose; None: the paper's 151 poses of the KR10, or 151 chosen ones; 10
            with `after`.
        criterion: what chosen poses are best in: "d-optimal" (joint compliances; None stands for
            it) or "i-optimal" (predictions; None stands for it with `after`).
        candidates: random poses to choose from; None: 2000, or ten a pose.
        payload: kg; None: the shipped robot's.
        clearance: smallest distance of the arm from the base column, m.
        seed: of all random numbers.
        robot: that will be measured: the name of a shipped one, or a `Robot`; None: the KR10.
        after: file of the poses that are measured already; the plan goes on from them, and their
            learning curve says what more poses would gain. None: there are none.
        model: that will be fitted to all poses, with `after`; None: "vjm". The poses are chosen
            for its predictions if it is a Gaussian process, else for those of joint springs.
        workspace: file of poses and wrenches where predictions are to be good, with `after`; None:
            all that the robot can reach.
        no_torque: no torques were measured in `after`.
        sheet: of `after`, an Excel file; None: the only one that holds a table.
        pose_tolerance: rows of `after` without `pose_id` whose joint positions differ by no more
            are of one pose, deg and mm.

    Raises:
        ConfigError: an argument is wrong, or the payload is unknown.
        DataError: a file cannot be read, or is of another robot.
        StoreError: the file cannot be written, or exists.
    """
    output, arm = Path(output), as_robot(robot)
    check_plan_file(output)
    options = FileOptions(no_torque, sheet, pose_tolerance)
    if after is None:
        given = {"model": model, "workspace": workspace, **asdict(options)}
        for name, value in given.items():
            if value != vars(DEFAULTS).get(name):
                needed = "requires a measurement to go on from: --after FILE"
                raise ConfigError(needed, name.replace("_", "-"))
    payload = payload_of(arm) if payload is None else payload
    if payload is None:
        raise ConfigError(f"of {arm.name} is not known; give it, in kg", "payload")
    how = pose_plans.PlanOptions(poses, criterion, candidates, payload, clearance, seed)
    if after is None:
        with display():
            found = pose_plans.first_plan(
                arm, how, is_paper_robot=shipped_name(arm) == DEFAULT_ROBOT
            )
        measured, curve = None, []
    else:
        file = measured_file(Path(after), arm, options)
        fitted = model_choice(model or REFERENCE_MODEL, {})
        measured = pose_plans.Measured(str(after), loaded(file).samples, arm, fitted)
        with display():
            found = pose_plans.next_plan(measured, how, workspace)
            curve = pose_plans.curve_text(measured, len(found.plan.q), seed)
    write_plan(output, found.plan, arm)
    return Text(found.report(output, arm, robot_words(arm), measured, curve))


def validate(
    file: Path | str,
    *,
    robot: str | Robot | None = None,
    no_torque: bool = False,
    sheet: str | None = None,
    pose_tolerance: float = POSE_TOLERANCE,
) -> validation.ValidationReport:
    """Check a measured file and name the likeliest mistake in it.

    Args:
        file: CSV, Excel or Parquet.
        robot: that was measured: the name of a shipped one, or a `Robot`; None: the KR10.
        no_torque: no torques were measured: their columns may be missing, or zero.
        sheet: of an Excel file; None: the only one that holds a table.
        pose_tolerance: rows without `pose_id` whose joint positions differ by no more are of one
            pose, deg and mm; poses of two names that differ by no more are suspicious.

    Returns:
        A report that prints itself; its `verdict` is "ok", "suspicious" or "invalid".

    Raises:
        ConfigError: there is no robot of this name.
    """
    options = FileOptions(no_torque, sheet, pose_tolerance)
    return validation.validate(Path(file), as_robot(robot), options, _left_out_errors)


def _left_out_errors(samples: Samples, robot: Robot) -> FloatArray:
    """Return (n, 3) errors [m] of `gp-springs` at samples that it did not learn from; or NaN."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)  # the report says the same
        try:
            model = model_info("gp-springs").load()().fit(samples, robot=robot)
        except ModelError:
            return np.full((len(samples), 3), np.nan)
    return np.asarray(model.left_out_errors_at_)


def simulate(
    output: Path | str,
    *,
    twin: str = "kr10-r1100-2",
    samples: int = 10_000,
    loads: Literal["line", "line-hook", "omni"] = "omni",
    loads_per_pose: int = 1,
    specimen: int = 0,
    seed: int = 0,
    effects: str = "none",
    physics: TwinPhysics = "tilting",
) -> Text:
    """Write a simulated data set of any size; return how many samples, and how fast.

    Args:
        output: a new FILE.csv or FILE.parquet.
        twin: a key such as "kr10-r1100-2" or "ur5", or FILE.toml with your own constants.
        samples: how many.
        loads: the paper's, its forces at a hook, or every direction at a hook.
        loads_per_pose: how many at each pose.
        specimen: which of ten robots of the type.
        seed: draws poses, loads and noise.
        effects: "hysteresis", "links", "kinematics" and "sensor", separated by commas, or "none".
        physics: "tilting": bearings as the twin's file has them; "rigid": no bearing tilts, and
            the links bend.

    Raises:
        DataError: the links are to bend, and the twin's file has no sections of them.
        ConfigError: there is no such twin or effect, or the file's ending is another one.
        StoreError: the file exists, or cannot be written.
    """
    asked, start = parse_effects(effects), time.perf_counter()
    experiment = TwinExperiment(
        _constants(twin),
        loads=loads,
        specimen=specimen,
        seed=seed,
        loads_per_pose=loads_per_pose,
        physics=physics,
        effects=asked,
    )
    with display():
        simulation.simulate(Path(output), experiment, samples)
    seconds = time.perf_counter() - start
    return Text(
        f"{output}: {samples} SIMULATED samples of {twin}, specimen {specimen}, in "
        f"{seconds:.1f} s ({samples / seconds:.0f} samples/s)"
    )


def _constants(twin: str) -> TwinConstants:
    """Read a shipped twin's constants or those of a TOML file."""
    shipped = shipped_twins()
    if twin in shipped:
        return shipped_constants(shipped[twin])
    if not twin.endswith(".toml"):
        raise ConfigError(f"{twin!r} (valid: {', '.join(shipped)}, or FILE.toml)", "twin")
    constants = read_constants(Path(twin))
    for note in constants.chain().notes:
        say(f"note: {note}")
    return constants
