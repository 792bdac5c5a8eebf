"""Plan measurements, check measured files, and simulate measurements."""

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
from stiff_bench.console import say
from stiff_bench.plan.options import measured_file
from stiff_bench.plan.request import loaded
from stiff_bench.run.progress import display
from stiff_bench.tables.writers import Text
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
    """Write a measurement plan to fill in, and return its gain over random plans.

    Args:
        output: new FILE.csv.
        poses: number of poses to choose; None: the paper's 151 poses of the KR10, or 151 chosen
            poses; 10 with `after`.
        criterion: criterion of the choice: "d-optimal" (joint compliances; the default) or
            "i-optimal" (predictions; the default with `after`).
        candidates: number of random poses to choose from; None: 2000, or ten per pose.
        payload: payload, kg; None: the shipped robot's payload.
        clearance: smallest distance of the arm from the base column, m.
        seed: seed of all random numbers.
        robot: robot to measure: a shipped name or a `Robot`; None: the KR10.
        after: file of measured poses; the plan continues them, and their learning curve predicts
            the gain of more poses. None: nothing is measured.
        model: model to fit to all poses, with `after`; None: "vjm". The poses are chosen for the
            predictions of a Gaussian process, otherwise for predictions of joint springs.
        workspace: file of poses and wrenches at which predictions should be accurate, with `after`;
            None: the reachable workspace.
        no_torque: True if torques were not measured in `after`.
        sheet: sheet of `after`, an Excel file; None: the only sheet with a table.
        pose_tolerance: largest difference of joint positions within a pose, for rows of `after`
            without `pose_id`, deg and mm.

    Raises:
        ConfigError: an argument is wrong, or the payload is unknown.
        DataError: a file cannot be read, or belongs to another robot.
        StoreError: the file cannot be written, or exists.
    """
    output, arm = Path(output), as_robot(robot)
    check_plan_file(output)
    options = FileOptions(no_torque, sheet, pose_tolerance)
    if after is None:
        given = {"model": model, "workspace": workspace, **asdict(options)}
        for name, value in given.items():
            if value != vars(DEFAULTS).get(name):
                needed = "requires measured poses; add --after FILE"
                raise ConfigError(needed, name.replace("_", "-"))
    payload = payload_of(arm) if payload is None else payload
    if payload is None:
        raise ConfigError(f"is unknown for {arm.name}; give a payload in kg", "payload")
    how = pose_plans.PlanOptions(poses, criterion, candidates, payload, clearance, seed)
    if after is None:
        with display():
            plan = pose_plans.first_plan(
                arm, how, is_paper_robot=shipped_name(arm) == DEFAULT_ROBOT
            )
        measured, curve = None, []
    else:
        file = measured_file(Path(after), arm, options)
        fitted = model_choice(model or REFERENCE_MODEL, {})
        measured = pose_plans.Measured(str(after), loaded(file).samples, arm, fitted)
        with display():
            plan = pose_plans.next_plan(measured, how, workspace)
            curve = pose_plans.curve_text(measured, len(plan.plan.q), seed)
    write_plan(output, plan.plan, arm)
    return Text(plan.report(output, arm, robot_words(arm), measured, curve))


def validate(
    file: Path | str,
    *,
    robot: str | Robot | None = None,
    no_torque: bool = False,
    sheet: str | None = None,
    pose_tolerance: float = POSE_TOLERANCE,
) -> validation.ValidationReport:
    """Check a measured file and name its most likely mistake.

    Args:
        file: CSV, Excel or Parquet file.
        robot: measured robot: a shipped name or a `Robot`; None: the KR10.
        no_torque: True if torques were not measured: their columns may be missing, or zero.
        sheet: sheet of an Excel file; None: the only sheet with a table.
        pose_tolerance: largest difference of joint positions within a pose, for rows without
            `pose_id`, deg and mm; poses of two names within this difference are suspicious.

    Returns:
        A printable report; its `verdict` is "ok", "suspicious" or "invalid".

    Raises:
        ConfigError: the robot's name is unknown.
    """
    options = FileOptions(no_torque, sheet, pose_tolerance)
    return validation.validate(Path(file), as_robot(robot), options, _left_out_errors)


def _left_out_errors(samples: Samples, robot: Robot) -> FloatArray:
    """Return (n, 3) errors [m] of `gp-springs` at left-out samples; NaN if it cannot be fitted."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffBenchWarning)  # the report has the same message
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
    """Write a simulated data set of any size, and return its size and speed.

    Args:
        output: new FILE.csv or FILE.parquet.
        twin: key such as "kr10-r1100-2" or "ur5", or FILE.toml with your own constants.
        samples: number of samples.
        loads: loads of the paper, its forces at a hook, or all directions at a hook.
        loads_per_pose: number of loads per pose.
        specimen: number of the specimen, one of ten robots of the type.
        seed: seed of poses, loads and noise.
        effects: "hysteresis", "links", "kinematics" and "sensor", separated by commas, or "none".
        physics: "tilting": bearings tilt as in the twin's file; "rigid": bearings do not tilt, and
            the links bend.

    Raises:
        DataError: bending links need sections, which the twin's file does not have.
        ConfigError: the twin or an effect is unknown, or the file's extension is not supported.
        StoreError: the file exists, or cannot be written.
    """
    chosen_effects, start = parse_effects(effects), time.perf_counter()
    experiment = TwinExperiment(
        _constants(twin),
        loads=loads,
        specimen=specimen,
        seed=seed,
        loads_per_pose=loads_per_pose,
        physics=physics,
        effects=chosen_effects,
    )
    with display():
        simulation.simulate(Path(output), experiment, samples)
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
    if not twin.endswith(".toml"):
        raise ConfigError(f"{twin!r} (valid: {', '.join(shipped)}, or FILE.toml)", "twin")
    constants = read_constants(Path(twin))
    for note in constants.chain().notes:
        say(f"note: {note}")
    return constants
