"""Rank postures for a task: turns of the tool and branches of the arm, by deflection."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pandas as pd

from stiff_apply.path_file import read_path
from stiff_apply.posture_math import (
    BRANCHES,
    Course,
    Direction,
    RatedPosture,
    all_postures,
    best_courses,
    branch_numbers,
    turned,
)
from stiff_apply.tool_task import LoadFrame, ToolTask, check_word, frame_matrix, tool_task
from stiff_bench.api.model import MEAN_ERROR, Model, half_width_name, wrap_model_errors
from stiff_bench.parameter_types import (
    Axis,
    Bounds,
    FilePath,
    Fraction,
    Frame,
    HeldJoints,
    JointPositions,
    Load,
    Picture,
)
from stiff_bench.plan.fits import DEFAULT_COVERAGE
from stiff_bench.run.progress import display
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    MM_PER_M,
    WRENCH_COLUMNS,
    counted,
    file_units,
    joint_columns,
)
from stiff_datasets.measured.table_reader import write_table
from stiff_protocols.contract.display import MOST_ROWS, Screen, ShownObject
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchError
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.stiffness_model import interval_at_tcp
from stiff_protocols.contract.types import FloatArray, IntArray, frozen_array
from stiff_protocols.paths.inverse import LIMIT_SLACK, SINGULAR, follow
from stiff_protocols.paths.path import ToolPath

if TYPE_CHECKING:
    from stiff_bench.figures.prepared_figure import Prepared

TURNS = 72
SAME_PLACE_MM, SAME_AXIS_DEG = 1.0, 0.5
"""Largest distance between the tool in the given posture and the point."""
FULL_TURN_DEG = 360.0
SAME_COST = 9
"""Decimals of compared deflections [m]: wrist branches have equal deflections."""
SCREEN_COLUMNS = (
    *("rank", "turn_deg", "branch", "along_mm", "across_mm", "extrapolates", "given"),
)
"""Columns of the table that fit a terminal."""


@dataclass(frozen=True, eq=False, repr=False)
class RankedPostures(ShownObject):
    """Postures for a task, with the smallest predicted deflection first.

    Attributes:
        title: model, robot and task.
        direction: "along" or "across" the axis of the tool.
        table: rows per posture (for a path: means over its points), in deg and mm.
        best: posture with the smallest deflection.
        given: posture to compare with; None if the robot cannot take it.
        given_words: origin of the given posture, or the reason why there is none.
        coverage: coverage of the intervals; None: no intervals.
        n_compared: number of postures inside the limits and away from singularities.
        mean_error: stored mean error of the model at left-out poses, m; None: not stored.
    """

    title: str
    direction: Direction
    table: pd.DataFrame
    best: RatedPosture
    given: RatedPosture | None
    given_words: str
    coverage: float | None
    n_compared: int
    mean_error: float | None

    @property
    def saving(self) -> float:
        """Return the mean deflection that the best posture saves, m; NaN if unknown."""
        return float(self.given.size.mean() - self.best.size.mean()) if self.given else np.nan

    @property
    def uncertainty(self) -> float:
        """Return the half width of the saving's interval, m; NaN if unknown.

        The errors of both postures are assumed to be independent.
        """
        if self.given is None or self.given.half_width is None or self.best.half_width is None:
            return np.nan
        return float(np.hypot(self.given.half_width.mean(), self.best.half_width.mean()))

    @property
    def is_within_uncertainty(self) -> bool:
        """Return True if the uncertainty exceeds the saving; False if it is unknown."""
        return bool(abs(self.saving) <= self.uncertainty)

    def view(self) -> Screen:
        """Return a screen with the best postures."""
        best = self.best
        mean = "" if len(best.q) == 1 else "mean "
        size = MM_PER_M * best.size.mean()
        title = (
            f"best posture: turn {best.turn:g} deg, {best.branch}; {size:.4g} mm {mean}"
            f"{self.direction} the axis"
        )
        if self.given is not None:
            old = self.given.size.mean()
            share = self.saving / old if old > 0.0 else 0.0
            saving = f"{MM_PER_M * abs(self.saving):.4f} mm ({abs(share):.0%})"
            word = "less" if self.saving >= 0.0 else "more"
            title += f", {saving} {word} than the {MM_PER_M * old:.4g} mm of the given one"
        columns = [name for name in self.table if name in SCREEN_COLUMNS]
        rows = [
            [_cell(name, row[name]) for name in columns]
            for row in self.table.head(MOST_ROWS).to_dict("records")
        ]
        n_more = len(self.table) - len(rows)
        notes = [f"... and {n_more} more; --output has the whole table"] if n_more else []
        return Screen(title, [*self._facts()], columns, rows, notes)

    def _facts(self) -> Iterator[tuple[str, str]]:
        best = self.best
        yield "task", self.title
        words = self.given_words
        if self.given is not None:
            words = f"turn {self.given.turn:g} deg, {self.given.branch}; {words}"
        yield "given posture", words
        if self.mean_error is not None:
            yield MEAN_ERROR, f"{MM_PER_M * self.mean_error:.3g} mm in 3-D"
        if self.coverage is None:
            yield half_width_name(DEFAULT_COVERAGE), "not computed; add --coverage 0.9"
        elif np.isfinite(self.uncertainty):
            half = MM_PER_M * self.uncertainty
            verdict = "is within it" if self.is_within_uncertainty else "is larger"
            yield (
                half_width_name(self.coverage),
                f"{half:.3g} mm, of the saving: the saving {verdict}",
            )
        if len(best.q) == 1:
            joints = self.table.filter(regex=r"^q\d+_").iloc[0]
            values = ", ".join(f"{value:.2f}" for value in joints)
            yield "joints", f"{values} ({', '.join(sorted({*joints.index.str.split('_').str[1]}))})"
        yield "extrapolates", self._extrapolation()
        yield "compared", f"{counted(self.n_compared, 'posture')} inside limits, not singular"

    def _extrapolation(self) -> str:
        """Return a text on postures beyond the training range."""
        words = [word for word in self.best.extrapolates if word]
        if not words:
            return "no, the best posture is inside the training range"
        kinds = ", ".join(sorted({*" ".join(words).split()}))
        text = f"the best posture is beyond the training range: {kinds}"
        if len(self.best.q) > 1:
            text += f" ({len(words)} of {len(self.best.q)} points)"
        alike = self.table[self.table["extrapolates"] == ""]
        if alike.empty:
            return f"{text}; all others are, too"
        first = alike.iloc[0]
        size = f"{first[f'{self.direction}_mm']:.4g} mm"
        return f"{text}; the best posture inside it has rank {first['rank']}, {size}"

    def plot(self) -> Prepared:
        """Return the picture: deflection over the turn."""
        from stiff_apply.figures.posture_picture import posture_picture

        words = f"{self.direction} the axis"
        return posture_picture(self.title, words, self.table, self.best, self.given)


def axial_compliance(
    model: Model, q: FloatArray, axis: Sequence[float], force: float
) -> FloatArray:
    """Return the (n,) predicted deflections along an axis per force along it, m/N.

    Args:
        model: fitted model.
        q: (n, n_joints) rad or m.
        axis: (3,) unit vector in the frame of the robot description's last link.
        force: size of the force, N; it matters for models without linear springs.
    """
    arm: Robot = model.fitted.robot_
    along = arm.forward(q).rotation @ (arm.flange[:3, :3] @ np.asarray(axis))
    wrench = np.hstack([force * along, np.zeros((len(q), 3))])
    deflection = model.predict_at_tcp(q, wrench)
    return np.asarray(np.einsum("ni,ni->n", deflection, along) / force)


def rank_postures(
    model: Model,
    *,
    point: Frame | None = None,
    path: FilePath | None = None,
    load: Load | None = None,
    frame: LoadFrame = "base",
    tool: Frame | None = None,
    tool_axis: Axis = (0.0, 0.0, 1.0),
    direction: Direction = "along",
    given: JointPositions | None = None,
    turns: Annotated[int, Bounds(at_least=1, at_most=3600)] = TURNS,
    workpiece: Frame | None = None,
    hold: HeldJoints | None = None,
    coverage: Fraction | None = None,
    sheet: str | None = None,
    output: FilePath | None = None,
    figure: Picture | None = None,
) -> RankedPostures:
    """Rank the postures of an arm at a point, or along a path, by the predicted deflection.

    The turn of the tool about its axis and the branch of the arm (shoulder, elbow, wrist) are free.
    Postures beyond joint limits or near singularities are left out. Collisions are not checked.

    Args:
        model: fitted model of an arm with six revolute joints, apart from held joints.
        point: pose of the tool at the task point: x, y, z in mm and a, b, c in deg; by default the
            pose of `given`.
        path: task of several points: a tool path.
        load: (3,) or (6,) process load on the tool, in N and N m; a path may have its own loads.
        frame: frame that loads are expressed in; a load in the tool frame turns with the tool.
        tool: tool frame in the frame of the last link: x, y, z in mm and a, b, c in deg; by default
            the model's TCP with the axes of the last link.
        tool_axis: (3,) axis that the tool may turn about, in the tool frame.
        direction: part of the deflection to rank by: along or across the axis.
        given: (n_joints,) joint positions to compare with, at the (first) point, in deg or mm; by
            default the orientation of the point, in the configuration nearest to the training
            poses.
        turns: number of turns over 360 deg, counted from the given posture; along a path all points
            have the same.
        workpiece: frame of the point or path in the base frame: x, y, z in mm and a, b, c in deg;
            by default the base frame.
        hold: joint of a robot with more than six joints that is held at a value in deg or mm, by
            name or number (rail, J3, 3); without a value at the position in `given` or in the path.
            May be repeated.
        coverage: add the model's uncertainty: prediction intervals of this coverage (0..1).
        sheet: sheet of an Excel file; by default the only one with a table.
        output: new .csv file: all postures at a point, or the best one along the path.
        figure: new picture: the deflection over the turn.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or the load is missing.
        DataError: the path cannot be read, or no posture reaches the points.
        StoreError: a file cannot be written, or exists.
    """
    check_word("direction", direction, ("along", "across"))
    task = tool_task(
        model,
        tool=tool,
        load=load,
        frame=frame,
        hold=hold,
        start=given,
        start_option="given",
        coverage=coverage,
        files=(output,),
        figure=figure,
    )
    _check_limits(task)
    arm, start, lines = task.robot, task.start, None
    if path is None:
        tool_path = _point(task, point, workpiece)
    elif point is not None:
        raise ConfigError("and path: give only one of them", "point")
    else:
        table = read_path(
            Path(path),
            arm,
            task.tool,
            sheet_name=sheet,
            load=load,
            frame=frame,
            workpiece=workpiece,
        )
        if table.q is not None and start is None:
            start = table.q[0]
        tool_path, lines = table.path, table.lines
    if not tool_path.wrench.any():
        raise ConfigError("is zero, so there is nothing to rank; give a load above 0", "load")
    if turns < 1:
        raise ConfigError(f"{turns} (valid: at least 1)", "turns")
    name = tool_path.name if path is None else str(path)
    search = _PostureSearch(
        task,
        name,
        tool_path,
        lines,
        task.held(start),
        start,
        task.tool[:3, :3] @ _unit(tool_axis),
        direction,
        coverage,
        turns,
    )
    with display(), wrap_model_errors(model.file, but=StiffBenchError):
        ranked = search.ranked()
    if output is not None:
        one_point = len(tool_path) == 1
        write_table(Path(output), [ranked.table if one_point else _course_table(arm, ranked)])
    if figure is not None:
        ranked.plot().save(Path(figure))
    return ranked


def _point(
    task: ToolTask, point: Sequence[float] | None, workpiece: Sequence[float] | None
) -> ToolPath:
    """Return the task at one point; by default at the given posture."""
    if task.load is None:
        raise ConfigError("is missing (valid: fx,fy,fz[,tx,ty,tz] in N and N m)", "load")
    if point is not None:
        pose = (np.eye(4) if workpiece is None else frame_matrix(workpiece)) @ frame_matrix(point)
        position, rotation = pose[None, :3, 3], pose[None, :3, :3] @ task.tool[:3, :3].T
    elif task.start is not None:
        poses = task.robot.forward(task.start[None])
        position, rotation = poses.points[:, -1], poses.rotation
    else:
        raise ConfigError(
            "is missing (valid: x,y,z,a,b,c in mm and deg, or --given, or --path)", "point"
        )
    place = ",".join(f"{length:.6g}" for length in MM_PER_M * position[0])
    return ToolPath(f"point {place} mm", position, rotation, task.in_base(task.load, rotation))


def _check_limits(task: ToolTask) -> None:
    """Check that the given posture lies inside the joint limits."""
    if task.start is None:
        return
    robot, units, q = task.robot, file_units(task.robot), task.start
    inside = (q >= robot.lower - LIMIT_SLACK) & (q <= robot.upper + LIMIT_SLACK)
    if not inside.all():
        joint = int(np.argmin(inside))
        low, high, value = (ends[joint] * units[joint] for ends in (robot.lower, robot.upper, q))
        raise ConfigError(
            f"joint {robot.joint_names[joint]} at {value:g} (valid: {low:g}..{high:g}, its limits)",
            "given",
        )


def _unit(axis: Sequence[float]) -> FloatArray:
    vector = frozen_array(axis, "tool_axis", (3,))
    length = np.linalg.norm(vector)
    if length < 1e-9:
        raise ConfigError("0,0,0 has no direction (valid: x,y,z of an axis)", "tool-axis")
    return np.asarray(vector / length)


@dataclass(frozen=True, eq=False)
class _PostureSearch:
    """One ranking.

    Attributes:
        task: model, robot, tool and frame of the loads.
        name: name of the points for messages.
        path: poses of the last joint's frame, and loads in the base frame.
        lines: (n,) line numbers of a file; None for a point.
        held: positions of held joints, see `free_joints`.
        start: (n_joints,) given posture, rad or m; None: the nearest to the training poses.
        axis: (3,) axis of the tool in the last joint's frame.
        direction: part of the deflection to rank by.
        coverage: coverage of intervals; None: no intervals.
        turns: number of turns over 360 deg.
    """

    task: ToolTask
    name: str
    path: ToolPath
    lines: IntArray | None
    held: FloatArray
    start: FloatArray | None
    axis: FloatArray
    direction: Direction
    coverage: float | None
    turns: int

    def _place(self, number: int) -> str:
        """Return a point's name for messages."""
        return self.name if self.lines is None else f"{self.name}: row {self.lines[number]}"

    def ranked(self) -> RankedPostures:
        """Return all postures in their order."""
        rotation, given_q, words = self._given()
        angles = 2.0 * np.pi * np.arange(self.turns) / self.turns
        rotations = turned(rotation, self.axis, angles)
        n, wrench = len(rotations), self._wrench(rotations)
        axis = rotations @ self.axis
        postures = all_postures(
            self.task.robot, self.path.position, rotations, near=self.task.near, held=self.held
        )
        if self.start is not None and n == 1:
            self._put_given(postures.q)
        rows = np.nonzero(~np.isnan(postures.q[..., 0]))
        size = np.full(postures.q.shape[:3], np.inf)
        if len(rows[0]):
            bent = self.task.model.predict_at_tcp(postures.q[rows], wrench[rows[:2]])
            size[rows] = _size(bent, axis[rows[:2]], self.direction)
        courses = best_courses(self.task.robot, postures.q, size, self.task.near)
        courses.sort(key=self._order)
        if not courses:
            raise DataError(self._reason(postures.n_reached, postures.n_inside, size))
        given = None
        if given_q is not None:
            number = int(branch_numbers(self.task.robot, given_q, self.held)[0])
            given = self._posture(Course(number, 0, given_q, 0.0), rotations)
        stored = getattr(self.task.model.fitted, "cross_validated_error_", None)
        robot_words = f"{self.task.model.name}, robot {self.task.robot.name}; {self.name}"
        return RankedPostures(
            robot_words,
            self.direction,
            self._table(courses, rotations, given),
            self._posture(courses[0], rotations),
            given,
            words,
            self.coverage,
            len(rows[0]),
            None if stored is None else stored.mean,
        )

    def _put_given(self, q: FloatArray) -> None:
        """Replace the posture at turn 0 by the given one, with its whole turns of joints."""
        if self.start is not None:
            number = branch_numbers(self.task.robot, self.start[None], self.held)[0]
            if not np.isnan(q[0, 0, number, 0]):
                q[0, 0, number] = self.start

    def _order(self, course: Course) -> tuple[float, float]:
        """Return the sort key of courses: cost, then distance of the joints from `near`."""
        return round(course.cost, SAME_COST), float(np.abs(course.q - self.task.near).mean())

    def _given(self) -> tuple[FloatArray, FloatArray | None, str]:
        """Return (n, 3, 3) orientations at turn 0, the given joint positions, and their origin."""
        path, robot = self.path, self.task.robot
        rotation, start = path.rotation, self.start
        words = "the point's own turn, configuration nearest to the training poses"
        if start is not None:
            turn = self._checked_start(start)
            rotation = turned(rotation, self.axis, np.array([turn]))[:, 0]
            words = "yours"
            if len(path) == 1:
                return rotation, start[None], words
        driven = follow(
            robot,
            path.position,
            rotation,
            start,
            near=self.task.near if start is None else start,
            held=self.held,
        )
        if driven.ok.all():
            return rotation, driven.q, words
        row = int(np.argmin(driven.ok))
        reason = "is singular" if driven.singular[row] else "changes the configuration"
        if not driven.reached[row]:
            reason = "is out of reach"
        elif driven.beyond[row].any():
            reason = "is beyond the joint limits"
        return rotation, None, f"none: {self._place(row)} {reason} without a turn"

    def _checked_start(self, start: FloatArray) -> float:
        """Return the turn [rad] of the given posture from the point's own orientation.

        Raises:
            ConfigError: it has the tool at another point or in another direction.
        """
        from scipy.spatial.transform import Rotation

        poses = self.task.robot.forward(start[None])
        away = MM_PER_M * np.linalg.norm(poses.points[0, -1] - self.path.position[0])
        start_rotation, point_rotation = poses.rotation[0], self.path.rotation[0]
        cosine = np.clip((start_rotation @ self.axis) @ (point_rotation @ self.axis), -1.0, 1.0)
        tilt = np.degrees(np.arccos(cosine))
        if away > SAME_PLACE_MM or tilt > SAME_AXIS_DEG:
            raise ConfigError(
                f"has the tool {away:.4g} mm from the point and its axis {tilt:.3g} deg from the "
                f"point's (valid: within {SAME_PLACE_MM:g} mm and {SAME_AXIS_DEG:g} deg)",
                "given",
            )
        between = Rotation.from_matrix(point_rotation.T @ start_rotation).as_rotvec()
        return float(between @ self.axis)

    def _wrench(self, rotations: FloatArray) -> FloatArray:
        """Return (n, m, 6) loads at each turn, base frame."""
        n, m = rotations.shape[:2]
        wrench = np.repeat(self.path.wrench[:, None], m, axis=1)
        if self.task.frame == "base":
            return wrench
        loaded_rotation = self.path.rotation  # for which the path has its loads
        change = rotations @ loaded_rotation.swapaxes(1, 2)[:, None]
        parts = wrench.reshape(n, m, 2, 3)
        return np.asarray(np.einsum("nmij,nmkj->nmki", change, parts).reshape(n, m, 6))

    def _posture(self, course: Course, rotations: FloatArray) -> RatedPosture:
        """Return a course with its predictions."""
        model, q = self.task.model, course.q
        wrench = self._wrench(rotations)[:, course.turn]
        axis = rotations[:, course.turn] @ self.axis
        bent, half = self.task.model.predict_at_tcp(q, wrench), None
        if self.coverage is not None:
            interval = model.predict_interval(q, wrench, self.coverage)
            interval = interval_at_tcp(model.fitted, interval, q, wrench)
            part = _part(bent, axis, self.direction)
            length = np.linalg.norm(part, axis=1, keepdims=True)
            unit = axis if self.direction == "along" else part / np.maximum(length, 1e-12)
            half = np.linalg.norm(0.5 * (interval.upper - interval.lower) * unit, axis=1)
        return RatedPosture(
            float(_signed_degrees(np.array(course.turn), self.turns)),
            BRANCHES[course.branch],
            q,
            wrench,
            bent,
            _size(bent, axis, self.direction),
            half,
            tuple(model.training_range.extrapolates(q, wrench)),
        )

    def _table(
        self,
        courses: Sequence[Course],
        rotations: FloatArray,
        given: RatedPosture | None,
    ) -> pd.DataFrame:
        """Return a row per course, in their order."""
        n, units = len(rotations), file_units(self.task.robot)
        turn = np.array([course.turn for course in courses])
        q = np.array([course.q for course in courses])  # (k, n, n_joints)
        wrench = self._wrench(rotations)[:, turn].swapaxes(0, 1).reshape(-1, 6)
        axis = (rotations @ self.axis)[:, turn].swapaxes(0, 1).reshape(-1, 3)
        every_q = q.reshape(-1, q.shape[-1])
        bent = self.task.model.predict_at_tcp(every_q, wrench)
        sizes = {
            f"{word}_mm": MM_PER_M * _size(bent, axis, word).reshape(-1, n).mean(axis=1)
            for word in ("along", "across")
        }
        words = self.task.model.training_range.extrapolates(every_q, wrench)
        beyond = [words[row * n : (row + 1) * n] for row in range(len(courses))]
        columns: dict[str, object] = {"rank": np.arange(1, len(courses) + 1)}
        columns["turn_deg"] = _signed_degrees(turn, self.turns)
        columns["branch"] = [BRANCHES[course.branch] for course in courses]
        columns |= {name: lengths.round(8) for name, lengths in sizes.items()}
        columns["extrapolates"] = [" ".join(sorted({*" ".join(row).split()})) for row in beyond]
        if n == 1:
            joints = (q[:, 0] * units).round(8) + 0.0
            columns |= dict(zip(joint_columns(self.task.robot), joints.T, strict=True))
            lengths = (MM_PER_M * bent).round(8) + 0.0
            columns |= dict(zip(DEFLECTION_COLUMNS, lengths.T, strict=True))
        if given is not None:
            branch = np.array(columns["branch"]) == given.branch
            columns["given"] = branch & (turn == 0)
        return pd.DataFrame(columns)

    def _reason(self, n_reached: IntArray, n_inside: IntArray, size: FloatArray) -> str:
        """Return the reason why no posture reaches all points, in one line."""
        there = np.isfinite(size).reshape(len(size), -1).any(axis=1)
        if there.all():
            return f"{self.name}: {self.task.robot.name}: no turn and branch serves all points"
        number = int(np.argmin(there))
        place, arm = self._place(number), self.task.robot.name
        if not n_reached[number]:
            return f"{place}: {arm} does not reach it at any of {self.turns} turns about the axis"
        if not n_inside[number]:
            return (
                f"{place}: {arm} reaches it beyond its joint limits only (valid: a point that it "
                "reaches inside them)"
            )
        return (
            f"{place}: singular at every turn and branch inside the joint limits (valid: a "
            f"condition of the Jacobian of at most {SINGULAR:g})"
        )


def _part(deflection: FloatArray, axis: FloatArray, direction: Direction) -> FloatArray:
    """Return the (n, 3) part of deflections along or across (n, 3) axes."""
    along = np.einsum("ni,ni->n", deflection, axis)[:, None] * axis
    return along if direction == "along" else np.asarray(deflection - along)


def _size(deflection: FloatArray, axis: FloatArray, direction: Direction) -> FloatArray:
    return np.asarray(np.linalg.norm(_part(deflection, axis, direction), axis=1))


def _signed_degrees(turn: IntArray, turns: int) -> FloatArray:
    """Return numbers of turns as deg, from above -180 to 180."""
    degrees = FULL_TURN_DEG / turns * turn
    return np.asarray(np.where(degrees > FULL_TURN_DEG / 2.0, degrees - FULL_TURN_DEG, degrees))


def _course_table(robot: Robot, ranked: RankedPostures) -> pd.DataFrame:
    """Return the best posture along a path, a row per point, which `read_path` reads."""
    best = ranked.best
    joints = (best.q * file_units(robot)).round(8) + 0.0
    lengths = (MM_PER_M * best.deflection).round(8) + 0.0
    columns: dict[str, object] = dict(zip(joint_columns(robot), joints.T, strict=True))
    columns |= dict(zip(WRENCH_COLUMNS, best.wrench.T.round(8) + 0.0, strict=True))
    columns |= {"turn_deg": best.turn, "branch": [best.branch] * len(best.q)}
    columns |= dict(zip(DEFLECTION_COLUMNS, lengths.T, strict=True))
    columns[f"{ranked.direction}_mm"] = (MM_PER_M * best.size).round(8)
    if ranked.given is not None:
        columns[f"given_{ranked.direction}_mm"] = (MM_PER_M * ranked.given.size).round(8)
    if best.half_width is not None:
        columns["half_width_mm"] = (MM_PER_M * best.half_width).round(8)
    return pd.DataFrame(columns).assign(extrapolates=list(best.extrapolates))


def _cell(name: str, value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return "given" if value else ""
    if isinstance(value, float):
        return f"{value:.4f}" if name in ("along_mm", "across_mm") else f"{value:.1f}"
    return str(value)
