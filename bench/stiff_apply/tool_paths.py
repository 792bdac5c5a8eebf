"""Write example tool paths, and correct tool paths for the deflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from stiff_apply.example_path import drivable_path
from stiff_apply.expected_error import ExpectedError, expected_error
from stiff_apply.near_training import path_near_training, training_load
from stiff_apply.path_file import (
    LoadFrame,
    PathTable,
    corrected_table,
    path_problems,
    read_path,
    six_numbers,
    tool_of,
    write_path,
)
from stiff_bench.api.model import Model, wrap_model_errors
from stiff_bench.api.robots import as_robot, payload_of
from stiff_bench.console import printable, say
from stiff_bench.parameter_types import (
    Bounds,
    FilePath,
    Form,
    Fraction,
    Frame,
    HeldJoints,
    Iterations,
    JointPositions,
    Load,
    Picture,
    Tolerance,
)
from stiff_bench.run.progress import display
from stiff_bench.tables.picture_file import check_suffix
from stiff_bench.tables.writers import Text
from stiff_datasets.measured.row_checks import Problem, problems_error
from stiff_datasets.measured.rows_beyond_training import extrapolation_details
from stiff_datasets.measured.sample_columns import MM_PER_M, file_units
from stiff_datasets.measured.sheet_files import write_table
from stiff_protocols.contract.errors import ConfigError, ModelError, unknown_name, warn
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.robot import STANDARD_GRAVITY, Robot
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.paths.compensation import (
    MAX_ITERATIONS,
    TOLERANCE_M,
    Compensation,
    compensate,
)
from stiff_protocols.paths.inverse import Followed, follow, joint_number, judged
from stiff_protocols.paths.path import SHAPES
from stiff_protocols.scoring.cross_validated import ErrorLengths

if TYPE_CHECKING:
    from stiff_bench.figures.prepared_figure import Prepared


@dataclass(frozen=True, eq=False)
class CorrectedPath:
    """A path and the commands that correct it; its file has more columns.

    Attributes:
        name: name of the path.
        compensation: points, commands and predicted deflections.
        prediction_error: expected errors of the predictions at the commands.
        extrapolates: (n,) words for the quantities beyond the training range, "" for none.
        beyond: details of the points beyond the training range, with numbers; "" for none.
    """

    name: str
    compensation: Compensation
    prediction_error: ExpectedError
    extrapolates: Sequence[str]
    beyond: str

    @property
    def removed(self) -> FloatArray:
        """Return (n,) lengths of the predicted deflection that the commands correct, m."""
        return np.asarray(np.linalg.norm(self.compensation.removed, axis=1))

    @property
    def expected_error(self) -> FloatArray | None:
        """Return (n,) expected remaining distances from the path, m; None: unknown.

        This is the mean error of predictions at left-out poses, plus the predicted deflection of
        points that were not corrected.
        """
        return self.errors[0].values

    @property
    def half_width(self) -> FloatArray | None:
        """Return (n,) half widths of the interval of the distance from the path, m; None: unknown.

        They are lengths over the three axes, plus the predicted deflection of points that were not
        corrected.
        """
        return self.errors[1].values

    @cached_property
    def errors(self) -> tuple[ErrorLengths, ErrorLengths]:
        """Expected mean error and half width, with the deflection that was not corrected."""
        residual = np.linalg.norm(self.compensation.residual, axis=1)
        mean, half = (
            lengths
            if lengths.values is None
            else replace(lengths, values=lengths.values + residual)
            for lengths in (self.prediction_error.mean, self.prediction_error.half_width)
        )
        return mean, half

    @property
    def training_text(self) -> str:
        """Return the share of points beyond the training range, with details."""
        n_beyond, n = sum(map(bool, self.extrapolates)), len(self.extrapolates)
        text = f"{n_beyond} of {n} points are beyond the training range"
        return f"{text}: {self.beyond}" if self.beyond else text

    def plot(self) -> Prepared:
        """Return the picture of the path, its removed deflection and expected errors."""
        from stiff_apply.figures.corrected_path import path_picture

        return path_picture(self.name, self.compensation, *self.errors, list(self.extrapolates))

    def __repr__(self) -> str:
        """Return the share beyond the training range, and removed and expected errors."""
        removed, errors, n = self.removed, self.expected_error, len(self.removed)
        lines = [
            self.training_text,
            f"{self.compensation.converged.sum()} of {n} points corrected",
            f"removed (predicted deflection): {_mean_and_largest(removed)}",
        ]
        for lengths in self.errors:
            text = lengths.source
            if lengths.values is not None:
                text = f"{_mean_and_largest(lengths.values)} ({text})"
            lines.append(f"{lengths.name}: {text}")
        if errors is not None and (n_larger := int((errors >= removed).sum())):
            lines.append(
                f"at {n_larger} of {n} points the expected error is at least the correction"
            )
        return printable("\n".join(lines))


def example_path(
    output: FilePath,
    *,
    shape: Literal["square", "circle", "line", "iso9283"] = "square",
    size: Annotated[float, Form("MM"), Bounds(at_least=1.0, at_most=1e4)] = 200.0,
    points: Annotated[int, Bounds(at_least=2, at_most=1_000_000)] = 401,
    load: Load | None = None,
    robot: str | Robot | None = None,
    model: Model | None = None,
    hold: HeldJoints | None = None,
) -> Text:
    """Write an example path for `bench path compensate`.

    The path is horizontal and in front of the robot. With a model it is for the model's robot,
    near a training pose, and inside the training range if the robot can drive such a path.

    Args:
        output: new .csv file.
        shape: shape of the path; iso9283 passes through the five test points of ISO 9283.
        size: edge, diameter or length of the shape; for iso9283 the edge of the cube, in mm.
        points: number of points.
        load: (3,) or (6,) process load on the tool at every point, in N and N m, base frame; by
            default a quarter of the payload downwards, and with a model half of the training load
            that pulls downwards most.
        robot: robot that drives the path: a shipped name or a `Robot`; by default the model's
            robot, or the KR10.
        model: fitted model; its robot drives the path.
        hold: joint of a robot with more than six joints that is held at a value in deg or mm, by
            name or number (rail, J3, 3); may be repeated.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: the shape, robot or joint is unknown, the load or a held joint is needed, or
            both a robot and a model are given.
        DataError: the robot cannot drive the path at any tried place.
        StoreError: the file cannot be written, or exists.
    """
    output = Path(output)
    check_new_file(output)
    if model is not None:
        model.check_fitted()
    if shape not in SHAPES:
        raise unknown_name("shape", shape, SHAPES)
    if model is not None and robot is not None:
        raise ConfigError("is given, but the model has its own robot; give only one", "robot")
    arm = as_robot(robot) if model is None else model.fitted.robot_
    if load is None and model is not None:
        default_load = training_load(model.training_range)
        load = None if default_load is None else default_load.tolist()
    if load is None:
        if (payload := payload_of(arm)) is None:
            raise ConfigError(f"is unknown for {arm.name}; give a load in N and N m", "load")
        load = (0.0, 0.0, -0.25 * payload * STANDARD_GRAVITY, 0.0, 0.0, 0.0)
    load = six_numbers(load)
    held = held_positions(arm, hold or {})
    path_options: dict[str, Any] = {"wrench": load, "held": held}
    if model is None:
        path, share = drivable_path(arm, shape, size / MM_PER_M, points, **path_options), ""
    else:
        training_range = model.training_range
        near = path_near_training(
            arm, training_range, shape, size / MM_PER_M, points, **path_options
        )
        path, n_beyond = near.path, near.n_beyond
        share = f"; {n_beyond} of {points} points are beyond the training range of {model.name}"
        if n_beyond:
            share += " (a smaller size may be inside)"
    write_path(output, path, tool_of(arm, None))
    return Text(f"{output}: {shape} of {points} points for {arm.name}, base frame{share}")


def compensate_path(
    model: Model,
    path: FilePath,
    output: FilePath,
    *,
    tool: Frame | None = None,
    workpiece: Frame | None = None,
    load: Load | None = None,
    frame: LoadFrame = "base",
    start: JointPositions | None = None,
    hold: HeldJoints | None = None,
    tolerance: Tolerance = MM_PER_M * TOLERANCE_M,
    iterations: Iterations = MAX_ITERATIONS,
    on_failure: Literal["stop", "keep"] = "stop",
    coverage: Fraction | None = None,
    sheet: str | None = None,
    figure: Picture | None = None,
) -> CorrectedPath:
    """Write the commands that put the loaded tool on a path.

    The command p_cmd is the fixed point of p_cmd = p - d(q(p_cmd), w): the predicted deflection at
    the commanded pose is subtracted. Orientation and configuration of the arm do not change. The
    output says what is removed, and what error is expected to remain on the robot.

    Args:
        model: fitted model.
        path: tool path: a file of points.
        output: new file: the commands of the path, or the corrected program with the suffix of
            `program`.
        tool: tool frame in the frame of the last link: x, y, z in mm and a, b, c in deg; by default
            the model's TCP with the axes of the last link. For a program without tool data it is
            in the controller's flange frame.
        workpiece: frame of the path or program in the base frame: x, y, z in mm and a, b, c in deg;
            by default the base frame, or the program's own.
        load: (3,) or (6,) process load on the tool at every point, in N and N m.
        frame: frame that loads are expressed in.
        start: (n_joints,) joint positions near the first point, in deg or mm; they choose the
            configuration. By default the one nearest to the training poses.
        hold: joint of a robot with more than six joints that is held at a value in deg or mm, by
            name or number (rail, J3, 3); without a value at the position in `start` or in the path.
            May be repeated.
        tolerance: largest last step of the iteration, in mm.
        iterations: largest number of predictions per point.
        on_failure: if a point of a path cannot be corrected: stop, or keep it uncorrected and name
            it.
        coverage: coverage (0..1) of prediction intervals, per axis; the output then has their
            bounds. By default 0.9, without bounds.
        sheet: sheet of an Excel file; by default the only one with a table.
        figure: new picture of the path, with removed and expected errors.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or the coverage needs more training poses.
        DataError: the path cannot be read or driven.
        ModelError: a point cannot be corrected.
        StoreError: a file cannot be written, or exists.
    """
    for kind, word, valid in (
        ("frame", frame, ("base", "tool")),
        ("on-failure", on_failure, ("stop", "keep")),
    ):
        if word not in valid:
            raise unknown_name(kind, word, valid)
    file, output, fitted = Path(path), Path(output), model.fitted
    model.check_fitted()
    check_new_file(output)
    if figure is not None:
        check_suffix(Path(figure))
        check_new_file(Path(figure))
    model.check_coverage(coverage)
    arm: Robot = fitted.robot_
    table = read_path(
        file,
        arm,
        tool_of(arm, tool),
        sheet_name=sheet,
        load=load,
        frame=frame,
        workpiece=workpiece,
    )
    for oddity in table.oddities:
        say(f"warning: {oddity}")
    training_range, wrench = model.training_range, table.path.wrench

    with display():
        held, driven = _driven(
            table, arm, hold or {}, start, 0.5 * (training_range.lower + training_range.upper)
        )
        if problems := path_problems(table, arm, driven):
            raise problems_error(file, problems)
        compensation = compensate(
            model.predict_at_tcp,
            arm,
            table.path,
            driven.q,
            held=held,
            tolerance_m=tolerance / MM_PER_M,
            max_iterations=iterations,
        )
        failures = _failures(
            file, table, arm, compensation, f"{tolerance:g} mm within {iterations}"
        )
        if failures and on_failure == "stop":
            raise ModelError(f"{failures}; use on-failure keep to leave such points uncorrected")
        extrapolates = training_range.extrapolates(compensation.q, wrench)
        carried = 0.0
        if offers(fitted, "predict_at_tcp"):
            with wrap_model_errors(model.file):
                measured_point_deflection = fitted.predict(compensation.q, wrench)
            carried = np.linalg.norm(
                compensation.deflection - measured_point_deflection, axis=1
            ).max()
        corrected = CorrectedPath(
            table.path.name,
            compensation,
            expected_error(model, compensation.q, wrench, coverage),
            extrapolates,
            extrapolation_details(training_range, arm, compensation.q, wrench, extrapolates),
        )
        interval = None if coverage is None else corrected.prediction_error.interval
        lengths = (corrected.expected_error, corrected.half_width)
        write_table(
            output, [corrected_table(table, arm, compensation, extrapolates, *lengths, interval)]
        )
    if not wrench.any():
        say(f"warning: {file}: all loads are zero, so there is nothing to correct")
    if carried > TOLERANCE_M:  # less is rounding: commands are not more exact
        say(
            f"warning: {file}: the model was fitted at a tool point other than the TCP; the "
            f"unmeasured rotation of the tool changes the deflections at the TCP by up to "
            f"{MM_PER_M * carried:.3g} mm"
        )
    beyond = corrected.training_text if corrected.beyond else ""
    for warning, column in ((failures, "uncorrected"), (beyond, "extrapolates")):
        if warning:
            text = f"{warning}; see the column {column}"
            warn(text)
    if figure is not None:
        corrected.plot().save(Path(figure))
    return corrected


def _mean_and_largest(lengths: FloatArray) -> str:
    """Return mean and largest of (n,) lengths [m] in mm."""
    return f"{MM_PER_M * lengths.mean():.3g} mm mean, {MM_PER_M * lengths.max():.3g} mm largest"


def _driven(
    table: PathTable,
    robot: Robot,
    hold: Mapping[str, float | None],
    start: Sequence[float] | None,
    near: FloatArray,
) -> tuple[FloatArray, Followed]:
    """Return positions of held joints, and joint positions along the path."""
    if table.q is None:
        begin = None if start is None else given_positions(robot, start, "start")
        held = held_positions(robot, hold, begin)
        position, rotation = table.path.position, table.path.rotation
        return held, follow(robot, position, rotation, begin, near=near, held=held)
    if start is not None:
        raise ConfigError("is not used: the path has joint angles; leave it out", "start")
    for name, value in hold.items():
        if value is not None:
            raise ConfigError(
                f"{name}={value:g}: the path's joint angles determine the value (use {name} "
                "without a value)",
                "hold",
            )
    held = held_positions(robot, hold, table.q[0])
    return held, judged(robot, table.q, held)


def _failures(
    file: Path, table: PathTable, robot: Robot, compensation: Compensation, valid: str
) -> str:
    """Return a text on points that were not corrected; "" if there are none."""
    if compensation.converged.all():
        return ""
    first = np.argmin(compensation.converged)
    problem = Problem(
        f"{compensation.problem[first]} after {compensation.iterations[first]} iterations, "
        f"contraction {compensation.contraction[first]:.3g}",
        f"below 1, and {valid} iterations",
        int(table.lines[first]),
        table.pose_columns,
    )
    points = f"{(~compensation.converged).sum()} of {len(table.lines)} points"
    text = f"{file}: {points} cannot be corrected, first {problem}"
    if robot.n_joints < 6:
        text += f"; {robot.name} has {robot.n_joints} joints, too few for every pose of a tool"
    return text


def held_positions(
    robot: Robot, hold: Mapping[str, float | None], path_positions: FloatArray | None = None
) -> FloatArray:
    """Return (n_joints,) positions of held joints, rad or m, NaN for the others.

    Args:
        robot: robot with these joints.
        hold: deg or mm by joint name or number; None: the value from `path_positions`.
        path_positions: (n_joints,) rad or m.

    Raises:
        ConfigError: the free joints of a larger robot are not six, a joint is unknown, or a value
            is missing or beyond the joint's limits.
    """
    held, factors = np.full(robot.n_joints, np.nan), file_units(robot)
    units = ["deg" if turns else "mm" for turns in robot.turns]
    try:
        numbers = {name: joint_number(robot, name) for name in hold}
    except ConfigError as error:
        raise ConfigError(str(error), "hold") from error
    spare = max(robot.n_joints - 6, 0)
    if hold and not spare:
        raise ConfigError(f"{', '.join(hold)}: {robot.name} has no joint to hold", "hold")
    if not len({*numbers.values()}) == len(hold) == spare:
        pairs = zip(robot.joint_names, units, strict=True)
        joints = ", ".join(f"{name} [{unit}]" for name, unit in pairs)
        raise ConfigError(
            f"{', '.join(hold) or 'none'} (valid: {spare} of {joints}, each once as JOINT=VALUE; "
            f"a pose of the tool determines the other joints of {robot.name})",
            "hold",
        )
    for name, number in numbers.items():
        value, unit = hold[name], units[number]
        low, high = factors[number] * robot.lower[number], factors[number] * robot.upper[number]
        if value is not None:
            if not low <= value <= high:
                raise ConfigError(f"{name}={value:g} (valid: {low:g}..{high:g} {unit})", "hold")
            held[number] = value / factors[number]
        elif path_positions is not None:
            held[number] = path_positions[number]
        else:
            raise ConfigError(f"{name}: the value is missing; use {name}=VALUE, in {unit}", "hold")
    return held


def given_positions(robot: Robot, positions: Sequence[float], option: str) -> FloatArray:
    """Return the (n_joints,) joint positions, rad or m, of an option in deg or mm."""
    if len(positions) != robot.n_joints:
        raise ConfigError(
            f"{len(positions)} joint positions (valid: the {robot.n_joints} of {robot.name})",
            option,
        )
    return np.asarray(positions, dtype=np.float64) / file_units(robot)
