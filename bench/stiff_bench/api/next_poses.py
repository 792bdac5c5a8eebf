"""Which poses to measure after those that are measured, and what more of them would gain."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from stiff_bench.analysis.learning_curve import (
    LEVEL,
    CurveErrors,
    learning_curve,
)
from stiff_bench.api.data import Dataset, choice_of
from stiff_bench.api.model import fitted, model_choice
from stiff_bench.plan.options import Choice
from stiff_bench.plan.words import RobotWords, measured_file
from stiff_bench.tables.render import plain_text
from stiff_bench.tables.table import Cell, Column, Table
from stiff_bench.tables.units import MM, counted, percent
from stiff_datasets.measured.identifiability import (
    DEFLECTION_NOISE,
    identifiability,
    regressor,
)
from stiff_datasets.measured.load_file import Loads, read_loads
from stiff_datasets.planning.design import Criterion, Design, ProcessDesign, SpringDesign
from stiff_datasets.planning.plan import (
    MeasurementPlan,
    candidate_plan,
    chosen_plan,
    unmeasured,
)
from stiff_datasets.planning.plan_gain import N_RANDOM, VarianceGain, variance_gain
from stiff_models.catalog import REFERENCE_MODEL
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    StiffBenchError,
    StiffBenchWarning,
)
from stiff_protocols.contract.interfaces import PredictsCovariance
from stiff_protocols.contract.plugin import ModelInfo
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.types import BenchmarkData, Robot, Samples
from stiff_protocols.scoring.sanity import check_prediction
from stiff_protocols.splits.sample_efficiency import SampleEfficiency

WORKSPACE_POSES = 500
"""Random loads that stand for all that the robot can reach."""
FEWEST_FOR_PROCESS = 10
"""Poses; the length scales of a kernel that was fitted to fewer mean nothing."""
LEAST_EXPLAINED = 0.5
"""Share of the squared deflection that joint springs explain of a file of the robot named."""

DRAWS, SIZES = 10, 6
SMALLEST_SIZE, FEWEST_FOR_CURVE = 5, 15
"""Poses that are learned from at least; and those that there must be for a learning curve."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What is measured already.

    Attributes:
        file: its name.
        samples: of it.
        robot: that was measured.
        model: that will be fitted to all poses in the end.
    """

    file: str
    samples: Samples
    robot: Robot
    model: Choice[ModelInfo]

    @property
    def data(self) -> BenchmarkData:
        """Samples and robot."""
        return BenchmarkData(self.samples, self.robot)

    @property
    def n_poses(self) -> int:
        """How many poses are measured."""
        return len(np.unique(self.samples.pose_id))

    @property
    def is_process(self) -> bool:
        """Whether the model says itself how unknown deflections go together."""
        return issubclass(self.model.cls, PredictsCovariance)

    @cached_property
    def springs(self) -> tuple[float, float]:
        """Variance [m²] of what joint springs leave, an axis; and the share that they explain.

        Raises:
            DataError: the samples identify no spring.
        """
        samples = self.samples
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                model, _ = fitted(choice_of("model", REFERENCE_MODEL, {}), self.data)
        except StiffBenchError as error:
            raise DataError(f"{self.file}: {error}") from error
        left = samples.deflection - model.predict(samples.q, samples.wrench)
        degrees = max(left.size - self.robot.n_joints, 1)
        variance = max(float((left**2).sum()) / degrees, DEFLECTION_NOISE**2)
        return variance, 1.0 - float((left**2).sum() / max((samples.deflection**2).sum(), 1e-30))


def read_measured(
    file: Path, words: RobotWords, model: str, *, no_torque: bool = False
) -> Measured:
    """Read the samples that are there; arguments as `plan_poses`.

    Raises:
        ConfigError: the model or the robot is unknown.
        DataError: the file cannot be read, or its robot has other joints or limits.
    """
    chosen, (robot, *_) = model_choice(model, {}), words.read()
    samples = Dataset(measured_file(file, robot, no_torque=no_torque)).samples
    return Measured(str(file), samples, robot, chosen)


@dataclass(frozen=True, eq=False)
class NextPoses:
    """A plan that goes on where a measurement ended.

    Attributes:
        plan: the new poses.
        gain: over random ones.
        noise: variance [m²] of a measured deflection about its prediction.
        workspace: where the predictions are, in words.
    """

    plan: MeasurementPlan
    gain: VarianceGain
    noise: float
    workspace: str


def choose_next(
    measured: Measured,
    n_poses: int,
    *,
    n_candidates: int,
    criterion: Criterion,
    workspace: Path | None,
    payload_kg: float,
    clearance: float,
    seed: int,
) -> NextPoses:
    """Choose the next poses; arguments as `plan_poses`.

    Raises:
        ConfigError: an argument is wrong, or the criterion is not one of the model.
        DataError: a file cannot be read, or holds too few poses for the model.
    """
    if measured.is_process and criterion != "i-optimal":
        raise ConfigError(
            f"{criterion}: of joint springs (valid with {measured.model.name}: i-optimal)",
            "criterion",
        )
    if measured.is_process and measured.n_poses < FEWEST_FOR_PROCESS:
        raise DataError(
            f"{measured.file}: {measured.n_poses} poses; {measured.model.name} plans from "
            f"{FEWEST_FOR_PROCESS} poses on (valid before: --model {REFERENCE_MODEL})"
        )
    file_loads = None if workspace is None else read_loads(workspace, measured.robot)
    n_drawn = 0 if file_loads is not None else WORKSPACE_POSES
    drawn = candidate_plan(
        measured.robot,
        n_candidates + n_drawn,
        seed=seed,
        payload_kg=payload_kg,
        clearance=clearance,
    )
    pool = unmeasured(drawn.take(slice(n_drawn, None)), measured.samples, measured.robot)
    if file_loads is None:
        where: Loads = drawn.take(slice(n_drawn))
        name = f"{n_drawn} random reachable poses, the suggested force in any direction"
    else:
        where = file_loads
        name = f"{counted(len(where.q), 'row')} of {workspace}"
    design = _design(measured, pool, where, criterion, seed)
    plan, rows = chosen_plan(pool, n_poses, design, measured=measured.samples)
    gain = variance_gain(design, rows, len(pool.q), seed=seed)
    return NextPoses(plan, gain, design.noise, name)


def _design(
    measured: Measured, pool: MeasurementPlan, where: Loads, criterion: Criterion, seed: int
) -> Design:
    if measured.is_process:
        model, _ = fitted(measured.model, measured.data, seed=seed)
        return ProcessDesign(model, pool, where)
    robot, samples = measured.robot, measured.samples
    return SpringDesign(
        regressor(robot, pool.q, pool.wrench),
        criterion,
        regressor(robot, where.q, where.wrench),
        regressor(robot, samples.q, samples.wrench),
        measured.springs[0],
    )


def curve_errors(choice: Choice[ModelInfo], data: BenchmarkData, seed: int) -> CurveErrors:
    """Fit a model to nested subsets of the poses, and test it on poses that are in none of them.

    The splits are those of the protocol `sample-efficiency`: in each draw a fifth of the poses is
    the test part of every size.

    Raises:
        DataError: there are too few poses.
        StiffBenchError: the model cannot be fitted.
    """
    samples = data.samples
    poses, pose_of_row = np.unique(samples.pose_id, return_inverse=True)
    if len(poses) < FEWEST_FOR_CURVE:
        raise DataError(f"{len(poses)} poses, it needs at least {FEWEST_FOR_CURVE}")
    protocol = SampleEfficiency()
    most = len(poses) - int(protocol.test_fraction * len(poses))
    least = max(SMALLEST_SIZE, most / 8)
    sizes = np.unique(np.geomspace(least, most, SIZES).round().astype(np.int64))
    protocol.sizes = ",".join(map(str, sizes))
    totals = np.zeros((DRAWS, len(sizes), len(poses)))
    counts = np.zeros((DRAWS, len(poses)), dtype=np.int64)
    splits = protocol.splits(samples, n_splits=DRAWS, seed=seed)
    for number, split in enumerate(splits):
        report("learning curve", number, len(splits))
        draw, size = divmod(number, len(sizes))
        train = samples.take(np.sort(np.concatenate([split.train, split.validation])))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StiffBenchWarning)  # few poses identify little
            model, _ = fitted(choice, BenchmarkData(train, data.robot), seed=seed)
        predicted = model.predict(samples.q[split.test], samples.wrench[split.test])
        check_prediction(predicted, len(split.test))
        errors = np.linalg.norm(predicted - samples.deflection[split.test], axis=1)
        tested = pose_of_row[split.test]
        totals[draw, size] = np.bincount(tested, errors, len(poses))
        counts[draw] = np.bincount(tested, minlength=len(poses))
    return CurveErrors(sizes, totals, counts)


def gain_table(measured: Measured, found: NextPoses) -> Table:
    """Return the predictions' uncertainty as it is, with the plan and with random poses."""
    n_new, variances = len(found.plan.q), np.array(found.gain)
    deviation = np.sqrt(variances) * MM
    half = ndtri(0.5 + LEVEL / 2.0) * np.sqrt(variances + found.noise) * MM
    rows: list[list[Cell]] = [
        ["standard error of a prediction [mm]", *map(_finite, deviation)],
        [f"half width of its {percent(LEVEL)} interval [mm]", *map(_finite, half)],
    ]
    names = (
        f"{measured.n_poses} measured",
        f"+ {n_new} chosen, {found.plan.group[0]}",
        f"+ {n_new} random, mean of {N_RANDOM}",
        f"+ {n_new} random, best",
    )
    return Table("", [Column("", "text"), *(Column(name, format=".4f") for name in names)], rows)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def gain_text(measured: Measured, found: NextPoses) -> list[str]:
    """Return what the table says, and of which predictions, a line each."""
    gain = found.gain
    springs = not measured.is_process
    model = REFERENCE_MODEL if springs else measured.model.name
    lines = [f"Predictions of {model}, an axis, over the workspace: {found.workspace}."]
    if np.isfinite(gain.before):
        lowered = 1.0 - gain.plan / gain.before
        lines.append(
            f"The plan lowers their mean variance by {lowered:.0%}, {gain.ratio:.2f} times as much "
            "as random poses."
        )
    else:
        regressors = regressor(measured.robot, measured.samples.q, measured.samples.wrench)
        unknown = identifiability(regressors, measured.robot.joint_names).unidentifiable
        lines.append(f"Not identifiable from the measured poses: {', '.join(unknown)}.")
    if springs and measured.model.info.key != REFERENCE_MODEL:
        lines.append(
            f"{measured.model.name} does not say what it would learn from a pose: the poses are "
            "chosen for joint springs."
        )
    share = measured.springs[1]
    if share < LEAST_EXPLAINED:
        lines.append(
            f"warning: joint springs of {measured.robot.name} explain {share:.0%} of the squared "
            f"deflection in {measured.file}: is it this robot's, with this TCP?"
        )
    return lines


def curve_text(measured: Measured, n_new: int, seed: int) -> list[str]:
    """Return the learning curve as a table and a sentence, a line each; or why there is none.

    Args:
        measured: whose curve it is.
        n_new: number of poses that are to be measured next.
        seed: of the subsets, the model and the resampling.
    """
    name = f"{measured.model.name} on {measured.file}"
    try:
        errors = curve_errors(measured.model, measured.data, seed)
    except StiffBenchError as error:
        return [f"No learning curve of {name}: {error}."]
    curve, now = learning_curve(errors, seed=seed), measured.n_poses
    law, more = curve.law, sorted({now + n_new, 2 * now})
    columns = [
        *(Column(str(size), format=".4f") for size in errors.sizes),
        *(Column(f"{size}*", format=".4f") for size in (now, *more)),
    ]
    values = [*errors.mean, *map(law, (now, *more))]
    row: list[Cell] = ["mean 3-D error [mm]", *(float(value) * MM for value in values)]
    table = Table("", [Column("training poses", "text"), *columns], [row])
    steps = ", ".join(
        f"with {size - now} more poses about {law(size) * MM:.3f} mm ({low:.3f} to {high:.3f} mm)"
        for size in more
        for low, high in [[MM * end for end in curve.interval(size, now)]]
    )
    told = "" if curve.told else " (assumed, the errors do not tell it)"
    return [
        f"Learning curve of {name}, tested on poses held out; * of the fitted curve:",
        "",
        plain_text(table),
        "",
        f"The mean error is {law(now) * MM:.3f} mm now, {steps}: an extrapolation by a + b n^-c "
        f"with {percent(LEVEL)} intervals, c = {law.c:.2f}{told}, for poses like the measured "
        "ones.",
    ]
