"""Correct tool paths for the deflection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from stiff_apply.expected_error import ExpectedError, expected_error
from stiff_apply.tool_task import LoadFrame, ToolTask, check_word, tool_task
from stiff_bench.analysis.extrapolation import extrapolation_details
from stiff_bench.api.model import Model, wrap_model_errors
from stiff_bench.console import printable, say
from stiff_bench.parameter_types import (
    FilePath,
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
from stiff_datasets.measured.sample_columns import MM_PER_M
from stiff_protocols.contract.errors import ConfigError, ModelError, warn
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.stiffness_model import offers
from stiff_protocols.contract.types import FloatArray
from stiff_protocols.paths.compensation import (
    MAX_ITERATIONS,
    TOLERANCE_M,
    Compensation,
    compensate,
)
from stiff_protocols.paths.inverse import Followed, follow, judged
from stiff_protocols.scoring.cross_validated import ErrorLengths

if TYPE_CHECKING:
    from stiff_apply.path_file import PathTable
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
            the model's TCP with the axes of the last link. For a program, a tool that it
            does not hold, in the controller's flange frame; several by number or name.
        workpiece: frame of the path or program in the base frame: x, y, z in mm and a, b, c in deg;
            by default the base frame. For a program, a frame that it does not hold, in the
            controller's world frame; several by number or name.
        load: (3,) or (6,) process load on the tool at every point, in N and N m.
        frame: frame of the loads: base (of the robot) or tool. For a program: world (of the
            controller; the default), base or tool (of each target).
        start: (n_joints,) joint positions near the first point, in deg or mm; they choose the
            configuration. By default the one nearest to the training poses.
        hold: joint of a robot with more than six joints that is held at a value in deg or mm, by
            name or number (rail, J3, 3); without a value at the position in `start` or in the path.
            For a program, an external axis that does not move, such as E1=250. May be repeated.
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
    # pandas takes half a second, and robot programs do without
    from stiff_apply.path_file import corrected_table, path_problems, read_path
    from stiff_datasets.measured.row_checks import problems_error
    from stiff_datasets.measured.table_reader import write_table

    check_word("on-failure", on_failure, ("stop", "keep"))
    task = tool_task(
        model,
        tool=tool,
        frame=frame,
        hold=hold,
        start=start,
        coverage=coverage,
        files=(output,),
        figure=figure,
    )
    file, arm, fitted = Path(path), task.robot, model.fitted
    table = read_path(
        file,
        arm,
        task.tool,
        sheet_name=sheet,
        load=load,
        frame=frame,
        workpiece=workpiece,
    )
    training_range, wrench = model.training_range, table.path.wrench

    with display():
        held, driven = _driven(table, task)
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
        rows = corrected_table(table, arm, compensation, extrapolates, *lengths, interval)
        write_table(Path(output), [rows])
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


def _driven(table: PathTable, task: ToolTask) -> tuple[FloatArray, Followed]:
    """Return positions of held joints, and joint positions along the path."""
    if table.q is None:
        held = task.held(task.start)
        position, rotation = table.path.position, table.path.rotation
        return held, follow(task.robot, position, rotation, task.start, near=task.near, held=held)
    if task.start is not None:
        raise ConfigError("is not used: the path has joint angles; leave it out", "start")
    for name, value in task.hold.items():
        if value is not None:
            raise ConfigError(
                f"{name}={value:g}: the path's joint angles determine the value (use {name} "
                "without a value)",
                "hold",
            )
    held = task.held(table.q[0])
    return held, judged(task.robot, table.q, held)


def _failures(
    file: Path, table: PathTable, robot: Robot, compensation: Compensation, valid: str
) -> str:
    """Return a text on points that were not corrected; "" if there are none."""
    from stiff_datasets.measured.row_checks import Problem

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
