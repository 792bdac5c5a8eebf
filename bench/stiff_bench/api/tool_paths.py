"""Tool paths: an example to begin with, and commands that correct one for the deflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stiff_bench.api.model import Model, blamed_on
from stiff_bench.api.remaining_error import ExpectedError, expected_error
from stiff_bench.api.robots import as_robot, payload_of
from stiff_bench.api.tables import Text
from stiff_bench.console import say
from stiff_bench.run.progress import display
from stiff_bench.tables.picture_file import check_suffix
from stiff_datasets.measured.path_file import (
    LoadFrame,
    PathTable,
    corrected_table,
    path_problems,
    read_path,
    six_numbers,
    tool_of,
    write_path,
)
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
from stiff_protocols.paths.example import drivable_path
from stiff_protocols.paths.inverse import Followed, follow, joint_number, judged
from stiff_protocols.paths.near_training import path_near_training, training_load
from stiff_protocols.paths.path import SHAPES

if TYPE_CHECKING:
    from stiff_bench.figures.prepared_figure import Prepared


@dataclass(frozen=True, eq=False)
class CorrectedPath:
    """A path and the commands that correct it; its file has more columns.

    Attributes:
        name: name of the path.
        found: points, commands and predicted deflections.
        prediction_error: expected error of the predictions at the commands.
        extrapolates: (n,) words for what of a point is beyond the training range, "" for nothing.
        beyond: details of the points that are beyond it, with numbers; "" if none is.
    """

    name: str
    found: Compensation
    prediction_error: ExpectedError
    extrapolates: Sequence[str]
    beyond: str

    @property
    def removed(self) -> FloatArray:
        """(n,) length of the predicted deflection that the commands take out, m."""
        return np.asarray(np.linalg.norm(self.found.removed, axis=1))

    @property
    def expected_error(self) -> FloatArray | None:
        """(n,) expected remaining distance from the path, m; None: not known.

        It is the expected error of the prediction. The predicted deflection of a point that was not
        corrected is added.
        """
        errors = self.prediction_error.values
        if errors is None:
            return None
        return np.asarray(errors + np.linalg.norm(self.found.residual, axis=1))

    @property
    def training_text(self) -> str:
        """Share of points beyond the training range, and how far they are."""
        n_beyond, n = sum(map(bool, self.extrapolates)), len(self.extrapolates)
        text = f"{n_beyond} of {n} points are beyond the training range"
        return f"{text}: {self.beyond}" if self.beyond else text

    def plot(self) -> Prepared:
        """Return the picture of the path, its removed deflection and expected remaining error."""
        from stiff_bench.figures.corrected_path import path_picture

        source = self.prediction_error.source
        return path_picture(
            self.name, self.found, self.expected_error, source, list(self.extrapolates)
        )

    def __repr__(self) -> str:
        """Return the share beyond the training range, what is removed, and what may remain."""
        removed, errors = self.removed, self.expected_error
        source, n = self.prediction_error.source, len(removed)
        lines = [
            self.training_text,
            f"{self.found.converged.sum()} of {n} points corrected",
            f"removed (predicted deflection): {_mean_and_largest(removed)}",
        ]
        if errors is None:
            return "\n".join([*lines, f"expected remaining error: {source}"])
        lines.append(f"expected remaining error: {_mean_and_largest(errors)} ({source})")
        if n_larger := int((errors >= removed).sum()):
            lines.append(f"at {n_larger} of {n} points more may remain than is removed")
        return "\n".join(lines)


def example_path(
    shape: str,
    output: Path | str,
    *,
    size: float = 200.0,
    points: int = 401,
    load: Sequence[float] | None = None,
    robot: str | Robot | None = None,
    model: Model | None = None,
    hold: Mapping[str, float | None] | None = None,
) -> Text:
    """Write a path that a robot can drive, and return a description of it.

    It is in front of the robot; with a model it is about a training pose, inside the training range
    if the robot can drive such a path.

    Args:
        shape: "square", "circle", "line" or "iso9283", horizontal.
        output: a new file.
        size: edge, diameter or length; of iso9283 the edge of the cube, mm.
        points: number of points.
        load: (3,) or (6,) process load, N and N m, base frame; None: a quarter of the payload
            downwards; or with a model half of the training load that pulls downwards most.
        robot: that drives it: the name of a shipped one, or a `Robot`; None: the model's, or the
            KR10.
        model: fitted, whose robot drives it.
        hold: of a robot with more than six joints: name or number of each other one -> deg or mm at
            which it is held.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: the shape, robot or joint is unknown, the load or a held joint is needed, or
            both a robot and a model are given.
        DataError: no place was found where the robot can drive the path.
        StoreError: the file cannot be written, or exists.
    """
    output = Path(output)
    check_new_file(output)
    if model is not None:
        model.check_fitted()
    if shape not in SHAPES:
        raise unknown_name("shape", shape, SHAPES)
    if model is not None and robot is not None:
        raise ConfigError("is given, and the model has its own robot (valid: one of both)", "robot")
    arm = as_robot(robot) if model is None else model.fitted.robot_
    if load is None and model is not None:
        default_load = training_load(model.training_range)
        load = None if default_load is None else default_load.tolist()
    if load is None:
        if (payload := payload_of(arm)) is None:
            raise ConfigError(f"of {arm.name} is not known; give one, in N and N m", "load")
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
            share += " (a smaller size may lie inside)"
    write_path(output, path, tool_of(arm, None))
    return Text(f"{output}: {shape} of {points} points for {arm.name}, base frame{share}")


def compensate_path(
    model: Model,
    path: Path | str,
    output: Path | str,
    *,
    tool: Sequence[float] | None = None,
    workpiece: Sequence[float] | None = None,
    load: Sequence[float] | None = None,
    frame: LoadFrame = "base",
    start: Sequence[float] | None = None,
    hold: Mapping[str, float | None] | None = None,
    tolerance: float = MM_PER_M * TOLERANCE_M,
    iterations: int = MAX_ITERATIONS,
    on_failure: Literal["stop", "keep"] = "stop",
    coverage: float | None = None,
    sheet: str | None = None,
    figure: Path | str | None = None,
) -> CorrectedPath:
    """Correct a path for the deflection that a model predicts, and write the commands.

    The command p_cmd is the fixed point of p_cmd = p - d(q(p_cmd), w): with it, the loaded tool is
    predicted to be at p. The orientation is held, along one configuration of the arm.

    Args:
        model: fitted.
        path: file of the points, see "Correct a tool path" in the docs.
        output: a new file.
        tool: x, y, z [mm], a, b, c [deg] of the tool in the frame of the robot description's last
            link; None: the model's TCP with the orientation of that link.
        workpiece: x, y, z [mm], a, b, c [deg] of the path's frame in the base frame; None: the
            base frame.
        load: (3,) or (6,) process load at every point, N and N m, for a file without loads.
        frame: "base" or "tool", in which loads are expressed.
        start: (n_joints,) joint positions near the first point, deg or mm, which choose the
            configuration; None: the one that is nearest to the training poses.
        hold: of a robot with more than six joints: name or number of each other one -> deg or mm at
            which it is held along the path; None: where `start` or the path's own joint angles have
            it.
        tolerance: largest last step of the iteration, mm.
        iterations: predictions of a point at most.
        on_failure: "stop" with an error at a point that cannot be corrected, or "keep" it
            uncorrected and warn.
        coverage: of intervals that are written, too, and from which the expected remaining error
            follows (0..1); None: none are written, see `expected_error`.
        sheet: of an Excel file; None: the only one that holds a table.
        figure: a new picture of the path, what is removed and what may remain.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or the coverage needs more training poses.
        DataError: the path cannot be read, or not be driven.
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
    known, wrench = model.training_range, table.path.wrench

    with display():
        held, driven = _driven(table, arm, hold or {}, start, 0.5 * (known.lower + known.upper))
        if problems := path_problems(table, arm, driven):
            raise problems_error(file, problems)
        found = compensate(
            model.predict_at_tcp,
            arm,
            table.path,
            driven.q,
            held=held,
            tolerance_m=tolerance / MM_PER_M,
            max_iterations=iterations,
        )
        failures = _failures(file, table, arm, found, f"{tolerance:g} mm within {iterations}")
        if failures and on_failure == "stop":
            raise ModelError(f"{failures}; on-failure keep leaves such points uncorrected")
        extrapolates = known.extrapolates(found.q, wrench)
        carried = 0.0
        if offers(fitted, "predict_at_tcp"):
            with blamed_on(model.file):
                own = fitted.predict(found.q, wrench)
            carried = np.linalg.norm(found.deflection - own, axis=1).max()
        corrected = CorrectedPath(
            table.path.name,
            found,
            expected_error(model, found.q, wrench, coverage),
            extrapolates,
            extrapolation_details(known, arm, found.q, wrench, extrapolates),
        )
        interval = None if coverage is None else corrected.prediction_error.interval
        errors = corrected.expected_error
        write_table(output, [corrected_table(table, arm, found, extrapolates, errors, interval)])
    if not wrench.any():
        say(f"warning: {file}: every load is zero, so there is nothing to correct")
    if carried:
        say(
            f"warning: {file}: the model was fitted to another point of the tool than the TCP; the "
            f"rotation of the tool, which was not measured, changes the deflections by up to "
            f"{MM_PER_M * carried:.3g} mm on the way to the TCP"
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
    """Return mean and largest of (n,) lengths, m, in mm."""
    return f"{MM_PER_M * lengths.mean():.3g} mm mean, {MM_PER_M * lengths.max():.3g} mm largest"


def _driven(
    table: PathTable,
    robot: Robot,
    hold: Mapping[str, float | None],
    start: Sequence[float] | None,
    near: FloatArray,
) -> tuple[FloatArray, Followed]:
    """Return the held joints as of `held_positions`, and joint positions along the path."""
    if table.q is None:
        begin = None if start is None else given_positions(robot, start, "start")
        held = held_positions(robot, hold, begin)
        position, rotation = table.path.position, table.path.rotation
        return held, follow(robot, position, rotation, begin, near=near, held=held)
    if start is not None:
        raise ConfigError("the path has joint angles, which choose the configuration", "start")
    for name, value in hold.items():
        if value is not None:
            raise ConfigError(
                f"{name}={value:g}: the path has joint angles, which say where the joint is held "
                f"(valid: {name} without a value)",
                "hold",
            )
    held = held_positions(robot, hold, table.q[0])
    return held, judged(robot, table.q, held)


def _failures(file: Path, table: PathTable, robot: Robot, found: Compensation, valid: str) -> str:
    """Say how many points were not corrected, and why not the first; "" where all were."""
    if found.converged.all():
        return ""
    first = np.argmin(found.converged)
    problem = Problem(
        f"{found.problem[first]} after {found.iterations[first]} iterations, contraction "
        f"{found.contraction[first]:.3g}",
        f"below 1, and {valid} iterations",
        int(table.lines[first]),
        table.pose_columns,
    )
    points = f"{(~found.converged).sum()} of {len(table.lines)} points"
    text = f"{file}: {points} cannot be corrected, first {problem}"
    if robot.n_joints < 6:
        text += f"; {robot.name} has {robot.n_joints} joints, too few for every pose of a tool"
    return text


def held_positions(
    robot: Robot, hold: Mapping[str, float | None], own: FloatArray | None = None
) -> FloatArray:
    """Return (n_joints,) rad or m at which joints are held along a path, NaN for the others.

    Args:
        robot: whose joints these are.
        hold: joint by name or number -> deg or mm; None: where `own` has it.
        own: (n_joints,) rad or m.

    Raises:
        ConfigError: other than six joints of a larger robot are left, a joint is unknown, or a
            value is missing or beyond the joint's limits.
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
        elif own is not None:
            held[number] = own[number]
        else:
            raise ConfigError(f"{name}: at which value? {name}=VALUE, in {unit}", "hold")
    return held


def given_positions(robot: Robot, positions: Sequence[float], option: str) -> FloatArray:
    """Return the (n_joints,) joint positions, rad or m, of an option in deg or mm."""
    if len(positions) != robot.n_joints:
        raise ConfigError(
            f"{len(positions)} joint positions (valid: the {robot.n_joints} of {robot.name})",
            option,
        )
    return np.asarray(positions, dtype=np.float64) / file_units(robot)
