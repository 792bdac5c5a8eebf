"""Choose the poses to measure, first or next, and compare them with random poses."""

from __future__ import annotations

import shlex
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from stiff_bench.plan.options import Choice
from stiff_bench.run.final_fit import final_fit
from stiff_bench.tables.table import Column, Entry, Table
from stiff_bench.tables.units import counted
from stiff_bench.tables.writers import plain_text
from stiff_datasets.measured.identifiability import DEFLECTION_NOISE, regressor
from stiff_datasets.measured.query_file import Loads, read_loads
from stiff_datasets.measured.sample_columns import Criterion
from stiff_datasets.planning.design import Design, ProcessDesign, SpringDesign
from stiff_datasets.planning.plan import (
    FORCE_SHARE,
    MeasurementPlan,
    candidate_plan,
    chosen_plan,
    unmeasured,
)
from stiff_datasets.planning.plan_gain import (
    N_RANDOM,
    PlanGain,
    VarianceGain,
    plan_gain,
    variance_gain,
)
from stiff_datasets.planning.reading_plan import (
    ReadingPlan,
    axis_directions,
    candidate_readings,
    chosen_readings,
    force_directions,
)
from stiff_models.model_catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    ModelError,
)
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.contract.types import Robot, Samples, read_along
from stiff_protocols.springs.unseen_joints import unseen_joints_texts

PLANNING_MODEL = "bayes-springs"
"""Model that the next poses are chosen for, by default; its priors hold for any number of poses."""
FIRST_POSES, NEXT_POSES = 60, 10
"""Default numbers of planned poses."""
FEWEST_CANDIDATES, CANDIDATES_A_POSE = 2000, 10
WORKSPACE_POSES = 500
"""Number of random loads that represent the reachable workspace."""
POSES_A_READING = 2
"""Random poses to choose from, per reading. More leave the extreme ones, where friction and curves
of the springs are badly seen."""
FEWEST_FOR_KERNELS = 10
"""Fewest poses to plan with a Gaussian process: with fewer its length scales are meaningless."""


@dataclass(frozen=True)
class PlanOptions:
    """Options of the choice of poses: the arguments of `stiffbench.plan_poses`."""

    poses: int | None
    criterion: Criterion | None
    candidates: int | None
    payload_kg: float
    clearance: float
    seed: int
    weights: bool = False

    def draw_candidates(self, robot: Robot, n_poses: int, further: int = 0) -> MeasurementPlan:
        """Draw candidates for a choice of `n_poses` poses, and further random loads."""
        n = further + (self.candidates or max(FEWEST_CANDIDATES, CANDIDATES_A_POSE * n_poses))
        return candidate_plan(
            robot,
            n,
            seed=self.seed,
            payload_kg=self.payload_kg,
            clearance=self.clearance,
            weights=self.weights,
        )


@dataclass(frozen=True, eq=False)
class PosePlan:
    """A plan, and its gain over random plans.

    Attributes:
        plan: planned poses.
        gain: gain over random plans.
        findings: lines on the gain.
    """

    plan: MeasurementPlan
    gain: PlanGain | VarianceGain
    findings: list[str]

    def report(
        self,
        file: Path,
        robot: Robot,
        option_words: str,
        measured: Measured | None = None,
    ) -> str:
        """Return a text on the plan's gain and the next steps with its `file`.

        `option_words` are command line options that name the robot and describe the file.
        """
        sizes = np.linalg.norm(self.plan.wrench[:, :3], axis=1)
        size = f"{sizes.max():.1f}"
        if sizes.max() - sizes.min() > 1.0:  # drawn
            size = f"{sizes.min():.1f} to {size}"
        after = f" after {measured.file}" if measured else ""
        file_to_check = measured.file if measured else str(file)
        append = f", and append the rows to {measured.file}" if measured else ""
        lines = [
            f"{file}: {counted(len(self.plan.q), 'pose')} of {robot.name}{after}, one suggested "
            f"force each ({size} N at the TCP, {FORCE_SHARE:.0%} of the payload)",
            "",
            *self.findings,
            "Checked: joint limits, the arm's centre line against base column and ground.",
            "Not checked: shape of links and tool, surroundings. Approach each pose slowly.",
            "",
            "Next: measure, fill in dx_mm, dy_mm, dz_mm, replace the suggested wrench by the "
            f"actual one{append}; then",
            f"  bench data validate {shlex.quote(file_to_check)}{option_words}",
        ]
        return "\n".join(lines)


def first_plan(robot: Robot, how: PlanOptions) -> PosePlan:
    """Return a plan for a robot without measurements.

    Raises:
        ConfigError: an argument is out of range.
    """
    n_poses = FIRST_POSES if how.poses is None else how.poses
    pool = how.draw_candidates(robot, n_poses)
    regressors = regressor(robot, pool.q, pool.wrench)
    design = SpringDesign(regressors, how.criterion or "d-optimal")
    plan, chosen = chosen_plan(pool, n_poses, design)
    gain = plan_gain(regressors[chosen], regressors, robot.joint_names, seed=how.seed)
    compared_plans = (gain.plan, gain.random_mean, gain.random_best)
    rows: list[Sequence[Entry]] = [
        ["condition number", *(plan_numbers.condition for plan_numbers in compared_plans)],
        ["log det of information", *(plan_numbers.log_det for plan_numbers in compared_plans)],
    ]
    names = (f"chosen, {design.criterion}", f"mean of {N_RANDOM} random", "best random")
    columns = [Column("poses", "text"), *(Column(name, format=".2f") for name in names)]
    worse = ": worse than random poses" * (gain.efficiency < 1.0)
    findings = [
        plain_text(Table("", columns, rows)),
        "",
        f"D-efficiency {gain.efficiency:.2f} relative to the mean random plan, "
        f"{gain.efficiency_over_best:.2f} relative to the best one{worse}.",
    ]
    unseen_texts = unseen_joints_texts(robot, plan.q, plan.wrench, np.empty(0))
    findings += [f"{text[0].upper()}{text[1:]}." for text in unseen_texts]
    if unseen := [joint for joint in robot.joint_names if joint not in gain.joints]:
        loads = "these weights" if how.weights else "this TCP"
        findings.append(f"Not identifiable with {loads}: {', '.join(unseen)}.")
    return PosePlan(plan, gain, findings)


@dataclass(frozen=True, eq=False)
class ReadingChoice:
    """A plan of a gauge's readings.

    Attributes:
        plan: planned readings.
        unseen: texts on joints that no force turns, or whose turn no axis shows.
    """

    plan: ReadingPlan
    unseen: list[str]

    def report(self, file: Path, robot: Robot, option_words: str) -> str:
        """Return a text on the plan and the next steps with its `file`; see `PosePlan.report`."""
        plan = self.plan
        sizes = np.linalg.norm(plan.force, axis=1)
        n_poses = len(np.unique(plan.pose_id))
        lines = [
            f"{file}: {counted(len(plan.q), 'reading')} at {counted(n_poses, 'pose')} of "
            f"{robot.name}, forces of {sizes.min():.1f} to {sizes.max():.1f} N",
            "",
            *(f"{text[0].upper()}{text[1:]}." for text in self.unseen),
            "Checked: joint limits, the arm's centre line against base column and ground.",
            "Not checked: room for the weight, the rope and the gauge's stand; shape of links and "
            "tool; surroundings. Approach each pose slowly.",
            "",
            "Next: measure, fill in reading0_mm (unloaded) and reading1_mm (loaded), replace "
            "masses and pulls by the actual ones; then",
            f"  bench data validate {shlex.quote(str(file))}{option_words}",
        ]
        return "\n".join(lines)


def reading_plan(
    robot: Robot,
    how: PlanOptions,
    readings: int,
    forces: str,
    axes: str,
    hook: Sequence[float] | None,
) -> ReadingChoice:
    """Return a plan of readings of a dial gauge.

    Args:
        robot: robot to measure.
        how: options of the choice; `candidates` is the number of random poses.
        readings: number of readings.
        forces: such as "weight,pull:0,1,0"; directions in the base frame.
        axes: axes of the gauge, such as "z,y".
        hook: (3,) where the forces act, frame of the last link, m; None: at the TCP.

    Raises:
        ConfigError: an argument is wrong.
    """
    pool = candidate_readings(
        robot,
        how.candidates or POSES_A_READING * readings,
        force_directions(forces, robot),
        axis_directions(axes),
        seed=how.seed,
        payload_kg=how.payload_kg,
        clearance=how.clearance,
        hook=robot.tcp_on_flange if hook is None else np.array(hook),
    )
    rows = read_along(pool.direction[:, None], regressor(robot, pool.q, pool.wrench))
    design = SpringDesign(rows, how.criterion or "d-optimal")
    plan = chosen_readings(pool, readings, design)
    texts = unseen_joints_texts(robot, plan.q, plan.wrench, plan.direction[:, None])
    return ReadingChoice(plan, texts)


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured samples, and the model to plan for.

    Attributes:
        file: name of the measured file.
        samples: samples of the file.
        robot: measured robot.
        model: model that the poses are chosen for.
    """

    file: str
    samples: Samples
    robot: Robot
    model: Choice[ModelInfo]

    @property
    def n_poses(self) -> int:
        """Return the number of measured poses."""
        return len(np.unique(self.samples.pose_id))

    @property
    def is_process(self) -> bool:
        """Return True if the model predicts the covariance of unknown deflections."""
        return offers(self.model.cls, "covariance")

    @cached_property
    def fitted(self) -> Any:
        """Return the model fitted to the samples; DataError: it cannot be fitted."""
        try:
            with warnings.catch_warnings(action="ignore"):
                return final_fit(self.model, self.samples, self.robot)[0]
        except ModelError as error:
            raise DataError(f"{self.file}: {error}") from error

    def design(self, pool: MeasurementPlan, workspace: Loads, criterion: Criterion) -> Design:
        """Return the design that chooses among candidates for predictions in the workspace."""
        if self.is_process:
            return ProcessDesign(self.fitted, pool, workspace)
        samples, robot = self.samples, self.robot
        residuals = samples.deflection - self.fitted.predict(samples.q, samples.wrench)
        free = max(samples.deflection.size - robot.n_joints, 1)
        return SpringDesign(
            regressor(robot, pool.q, pool.wrench),
            criterion,
            regressor(robot, workspace.q, workspace.wrench),
            regressor(robot, samples.q, samples.wrench),
            max(float((residuals**2).sum()) / free, DEFLECTION_NOISE**2),
        )

    def check(self, criterion: Criterion) -> None:
        """Check that the model can choose poses by a criterion.

        Raises:
            ConfigError: the model does not predict how well it knows a pose, or not by the
                criterion.
            DataError: the poses are too few for the model.
        """
        model = self.model
        if not (self.is_process or model.info.key == REFERENCE_MODEL):
            raise ConfigError(
                f"{model.name!r} cannot tell how much a pose would teach it (valid: "
                f"{PLANNING_MODEL}, gp, vjm-gp, {REFERENCE_MODEL} for joint springs, or a plug-in "
                "with `covariance`)",
                "model",
            )
        if self.samples.directions.size and not self.is_process:
            raise ConfigError(
                f"{model.name} plans from deflections along x, y and z, not from single readings "
                f"(valid: {PLANNING_MODEL})",
                "model",
            )
        if self.is_process and criterion != "i-optimal":
            raise ConfigError(
                f"{criterion}: only for joint springs (valid with {model.name}: i-optimal)",
                "criterion",
            )
        has_kernels = self.is_process and model.info.key != PLANNING_MODEL
        if has_kernels and self.n_poses < FEWEST_FOR_KERNELS:
            raise DataError(
                f"{self.file}: {self.n_poses} poses; {model.name} needs at least "
                f"{FEWEST_FOR_KERNELS} poses to plan (with fewer use --model {PLANNING_MODEL})"
            )


def next_plan(
    measured: Measured, how: PlanOptions, workspace: Path | str | None = None
) -> PosePlan:
    """Return a plan that continues a measurement.

    `workspace` is a file of poses and wrenches at which predictions should be accurate; None: the
    reachable workspace.

    Raises:
        ConfigError: an argument is wrong, or the model does not support the criterion.
        DataError: a file cannot be read, or has too few poses for the model.
    """
    robot, samples = measured.robot, measured.samples
    n_new = NEXT_POSES if how.poses is None else how.poses
    criterion = how.criterion or "i-optimal"
    measured.check(criterion)
    if workspace is None:
        drawn = how.draw_candidates(robot, n_new, WORKSPACE_POSES)
        where: Loads = drawn.take(slice(WORKSPACE_POSES))
        pool = drawn.take(slice(WORKSPACE_POSES, None))
        place = f"{WORKSPACE_POSES} random reachable poses, the suggested force in any direction"
    else:
        where, pool = read_loads(Path(workspace), robot), how.draw_candidates(robot, n_new)
        place = f"{counted(len(where.q), 'row')} of {workspace}"
    pool = unmeasured(pool, samples, robot)
    design = measured.design(pool, where, criterion)
    plan, chosen = chosen_plan(pool, n_new, design, measured=samples)
    gain = variance_gain(design, chosen, len(pool.q), seed=how.seed)
    return PosePlan(plan, gain, _findings(measured, gain, place))


def _findings(measured: Measured, gain: VarianceGain, place: str) -> list[str]:
    """Return sentences on a plan's gain, one per line."""
    lines = [f"Chosen for predictions of {measured.model.name} over the workspace: {place}."]
    if 0.0 < gain.before < np.inf:
        lines.append(
            f"They inform the model {gain.ratio:.2f} times as much as random poses (decrease of "
            "its variance)."
        )
    if not measured.is_process and (unknown := measured.fitted.springs_.unidentifiable):
        lines.append(f"Not identifiable from the measured poses: {', '.join(unknown)}.")
    return lines
