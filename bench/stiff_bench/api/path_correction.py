"""A tool path that is corrected for the deflection that a model predicts, block by block."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from stiff_bench.api.model import Model, blamed_on
from stiff_datasets.measured.path_file import PathTable, corrected_table, path_problems
from stiff_datasets.measured.row_checks import Problem, problems_error
from stiff_datasets.measured.rows_beyond_training import extrapolation_warning
from stiff_datasets.measured.sample_columns import MM_PER_M, file_units
from stiff_protocols.contract.errors import ConfigError, ModelError
from stiff_protocols.contract.progress import report
from stiff_protocols.contract.stiffness_model import interval_at_tcp, offers, optional
from stiff_protocols.contract.types import FloatArray, IntArray, Interval, Robot
from stiff_protocols.paths.compensation import Compensation, compensate
from stiff_protocols.paths.inverse import Branch, joint_number

if TYPE_CHECKING:
    from pandas import DataFrame

BLOCK = 2_000
"""Points that are corrected and written at once; progress is shown after each block."""


@dataclass(frozen=True, eq=False)
class CorrectedPath:
    """A path and the commands that put the loaded tool on it; its file has more columns.

    Attributes:
        name: of the path.
        found: points, commands and predicted deflections.
        interval: of the deflections at the commands; None where none was asked for.
    """

    name: str
    found: Compensation
    interval: Interval | None

    @property
    def error_before(self) -> FloatArray:
        """(n,) predicted distance from the path without correction, m."""
        return np.asarray(np.linalg.norm(self.found.before, axis=1))

    @property
    def error_after(self) -> FloatArray:
        """(n,) predicted distance from the path with the commands, m."""
        return np.asarray(np.linalg.norm(self.found.after, axis=1))

    def __repr__(self) -> str:
        """Return how many points were corrected, and the predicted errors."""
        before, after = MM_PER_M * self.error_before, MM_PER_M * self.error_after
        done = int(self.found.converged.sum())
        return (
            f"{done} of {len(before)} points corrected; predicted path error before "
            f"{before.mean():.4g} mm mean, {before.max():.4g} mm largest, after "
            f"{after.mean():.2g} mm mean, {after.max():.2g} mm largest"
        )


class _Block(NamedTuple):
    """Points that were corrected at once.

    Attributes:
        found: points and commands.
        interval: as of `CorrectedPath`.
        carried: largest change of a deflection from the measured point to the TCP, m.
        extrapolates: what of each row lies beyond the training range.
    """

    found: Compensation
    interval: Interval | None
    carried: float
    extrapolates: list[str]


@dataclass(frozen=True, eq=False)
class Correction:
    """How the points of a file are corrected; most as of `stiffbench.compensate_path`.

    Attributes:
        model: fitted.
        table: the points.
        seed: (n_joints,) positions that choose the configuration, rad or m; None: the model's.
        held: as of `inverse.free_joints`.
        blocks: what is corrected so far.
    """

    file: Path
    model: Model
    table: PathTable
    seed: FloatArray | None
    held: FloatArray
    tolerance: float
    iterations: int
    stops: bool
    coverage: float | None
    blocks: list[_Block] = field(default_factory=list)

    @property
    def robot(self) -> Robot:
        """That the model was fitted for."""
        robot: Robot = self.model.fitted.robot_
        return robot

    def tables(self) -> Iterator[DataFrame]:
        """Correct block after block, keep each in `blocks`, and yield its rows of the output."""
        robot, known = self.robot, self.model.training_range
        branch, n_points = Branch(robot, self.held, self.seed), len(self.table.lines)
        if self.seed is None and self.table.q is None:
            near = 0.5 * (known.lower + known.upper)
            branch = Branch.along(robot, self.table.some, near, self.held)
        for start in range(0, n_points, BLOCK):
            table = self.table.take(np.arange(start, min(start + BLOCK, n_points)))
            driven, wrench = branch.driven(table.path, table.q), table.path.wrench
            if problems := path_problems(table, robot, driven):
                raise problems_error(self.file, problems)
            found = compensate(
                self._predict,
                robot,
                table.path,
                driven.q,
                held=self.held,
                tolerance_m=self.tolerance / MM_PER_M,
                max_iterations=self.iterations,
            )
            if self.stops and (text := self._failures(found, table.lines)):
                raise ModelError(f"{text}; on-failure keep leaves such points uncorrected")
            extrapolates = known.extrapolates(found.q, wrench)
            interval = self._interval(found.q, wrench)
            carried = self._carried(found.q, wrench)
            self.blocks.append(_Block(found, interval, carried, extrapolates))
            yield corrected_table(table, robot, found, extrapolates, interval)
            if start + BLOCK < n_points:
                report("points corrected", start + BLOCK, n_points)

    def corrected(self) -> CorrectedPath:
        """Return the blocks as one path."""
        whole, interval = Compensation.joined([block.found for block in self.blocks]), None
        if self.coverage is not None:
            lower, upper = (
                np.concatenate([getattr(one.interval, end) for one in self.blocks])
                for end in ("lower", "upper")
            )
            interval = Interval(lower, upper, self.coverage)
        return CorrectedPath(self.table.path.name, whole, interval)

    def oddities(self) -> Iterator[str]:
        """Yield what is odd about the loads and the measured point."""
        if not self.table.path.wrench.any():
            yield f"{self.file}: every load is zero, so there is nothing to correct"
        if carried := max(block.carried for block in self.blocks):
            yield (
                f"{self.file}: the model was fitted to another point of the tool than the TCP; the "
                f"rotation of the tool, which was not measured, changes the deflections by up to "
                f"{MM_PER_M * carried:.3g} mm on the way to the TCP"
            )

    def warnings(self, whole: Compensation) -> Iterator[str]:
        """Yield which points are not corrected, and which lie beyond the training samples."""
        words = [text for block in self.blocks for text in block.extrapolates]
        known, wrench = self.model.training_range, self.table.path.wrench
        for warning, column in (
            (self._failures(whole, self.table.lines), "uncorrected"),
            (extrapolation_warning(known, self.robot, whole.q, wrench, words), "extrapolates"),
        ):
            if warning:
                yield f"{warning}; see the column {column}"

    def _predict(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection of the TCP, m; arguments as of a model's `predict`."""
        with blamed_on(self.model.file):
            return np.asarray(optional(self.model.fitted, "predict_at_tcp")(q, wrench))

    def _carried(self, q: FloatArray, wrench: FloatArray) -> float:
        """Return how much a deflection changes at most from the measured point to the TCP, m."""
        fitted = self.model.fitted
        if not offers(fitted, "predict_at_tcp"):
            return 0.0
        with blamed_on(self.model.file):
            change = self._predict(q, wrench) - np.asarray(fitted.predict(q, wrench))
        return float(np.linalg.norm(change, axis=1).max(initial=0.0))

    def _interval(self, q: FloatArray, wrench: FloatArray) -> Interval | None:
        """Return where the deflections of the TCP lie; None where no intervals are asked for."""
        if self.coverage is None:
            return None
        with blamed_on(self.model.file):
            interval = self.model.predict_interval(q, wrench, self.coverage)
            return interval_at_tcp(self.model.fitted, interval, q, wrench)

    def _failures(self, found: Compensation, lines: IntArray) -> str:
        """Say how many points were not corrected, and why not the first; "" where all were."""
        if found.converged.all():
            return ""
        first = np.argmin(found.converged)
        problem = Problem(
            f"{found.problem[first]} after {found.iterations[first]} iterations, contraction "
            f"{found.contraction[first]:.3g}",
            f"below 1, and {self.tolerance:g} mm within {self.iterations} iterations",
            int(lines[first]),
            self.table.pose_columns,
        )
        number = int((~found.converged).sum())
        points, robot = f"{number} of {len(self.table.lines)} points", self.robot
        text = f"{self.file}: {points} cannot be corrected, first {problem}"
        if robot.n_joints < 6:
            text += f"; {robot.name} has {robot.n_joints} joints, too few for every pose of a tool"
        return text


def held_positions(
    robot: Robot, hold: Mapping[str, float | None], start: FloatArray | None = None
) -> FloatArray:
    """Return (n_joints,) rad or m at which joints are held along a path, NaN for the others.

    Args:
        robot: whose joints these are.
        hold: joint by name or number -> deg or mm; None: where `start` has it.
        start: (n_joints,) rad or m.

    Raises:
        ConfigError: other than six joints of a larger robot are left, a joint is unknown or named
            twice, or a value is missing or beyond the joint's limits.
    """
    held, units = np.full(robot.n_joints, np.nan), file_units(robot)
    _check_number_held(robot, hold)
    for name, number in _numbers(robot, hold).items():
        value, unit = hold[name], _unit(robot, number)
        low, high = units[number] * robot.lower[number], units[number] * robot.upper[number]
        if value is None:
            if start is None:
                raise ConfigError(f"{name}: at which value? {name}=VALUE, in {unit}", "hold")
            held[number] = start[number]
        elif low <= value <= high:
            held[number] = value / units[number]
        else:
            raise ConfigError(f"{name}={value:g} (valid: {low:g}..{high:g} {unit})", "hold")
    return held


def held_along(
    robot: Robot, hold: Mapping[str, float | None], start: FloatArray | None, table: PathTable
) -> FloatArray:
    """Return `held_positions` along a path, whose own joint positions say them if it has some.

    Raises:
        ConfigError: as there, or an argument says again what the path does.
    """
    if table.q is None:
        return held_positions(robot, hold, start)
    if start is not None:
        raise ConfigError("the path has joint angles, which choose the configuration", "start")
    for name, value in hold.items():
        if value is not None:
            raise ConfigError(
                f"{name}={value:g}: the path has joint angles, which say where the joint is held "
                f"(valid: {name} without a value)",
                "hold",
            )
    return held_positions(robot, hold, table.q[0])


def _check_number_held(robot: Robot, hold: Mapping[str, float | None]) -> None:
    """Refuse more or fewer held joints than a robot has beyond six."""
    spare = max(robot.n_joints - 6, 0)
    if len(_numbers(robot, hold)) == spare:
        return
    has = f"{robot.name} has {robot.n_joints} joints, of which a pose of the tool determines"
    if not spare:
        raise ConfigError(f"{', '.join(hold)}: {has} all: none can be held", "hold")
    joints = ", ".join(
        f"{name} [{_unit(robot, number)}]" for number, name in enumerate(robot.joint_names)
    )
    text = f"{has} six: hold {spare}, not {len(hold)}, of {joints}, each by JOINT=VALUE"
    raise ConfigError(text, "hold")


def _numbers(robot: Robot, hold: Mapping[str, float | None]) -> dict[str, int]:
    """Return the number of each joint that is held, from 0.

    Raises:
        ConfigError: a joint is unknown, or named twice.
    """
    try:
        numbers = {name: joint_number(robot, name) for name in hold}
    except ConfigError as error:
        raise ConfigError(str(error), "hold") from error
    if len({*numbers.values()}) < len(numbers):
        raise ConfigError(f"{', '.join(hold)}: name each joint once", "hold")
    return numbers


def _unit(robot: Robot, number: int) -> str:
    return "deg" if robot.turns[number] else "mm"


def start_positions(robot: Robot, start: Sequence[float] | None) -> FloatArray | None:
    """Return the (n_joints,) joint positions, rad or m, that a user gave to begin with."""
    if start is None:
        return None
    if len(start) != robot.n_joints:
        raise ConfigError(
            f"{len(start)} joint positions (valid: the {robot.n_joints} of {robot.name})", "start"
        )
    return np.asarray(start) / file_units(robot)
