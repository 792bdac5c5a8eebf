"""Postures for a task: the turn of the tool and the arm's branch with the smallest deflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from stiff_bench.api.model import Model, blamed_on
from stiff_bench.api.ranked_postures import RankedPostures
from stiff_bench.api.tool_paths import held_positions
from stiff_bench.console import say
from stiff_bench.run.progress import display
from stiff_bench.tables.picture_file import check_suffix
from stiff_datasets.measured.path_file import LoadFrame, frame_matrix, read_path, tool_of
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    MM_PER_M,
    WRENCH_COLUMNS,
    file_units,
    joint_columns,
)
from stiff_datasets.measured.sheet_files import write_table
from stiff_protocols.contract.errors import ConfigError, DataError, StiffBenchError, unknown_name
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.stiffness_model import interval_at_tcp, optional
from stiff_protocols.contract.types import FloatArray, IntArray, frozen_array
from stiff_protocols.paths.inverse import LIMIT_SLACK, SINGULAR, follow
from stiff_protocols.paths.path import ToolPath
from stiff_protocols.paths.postures import (
    BRANCHES,
    Course,
    Direction,
    RatedPosture,
    all_postures,
    best_courses,
    branch_numbers,
    turned,
)

SHIFTS_PER_AXIS = 5
"""Places of the workpiece along each edge of a box."""
TURNS = 72
SAME_PLACE_MM, SAME_AXIS_DEG = 1.0, 0.5
"""Between the tool in the given posture and the point, at most."""
FULL_TURN_DEG = 360.0
SAME_COST = 9
"""Decimals of a deflection [m] to which costs are compared: wrist branches have equal ones."""


def axial_compliance(
    model: Model, q: FloatArray, axis: Sequence[float], force: float
) -> FloatArray:
    """Return (n,) the predicted deflection along an axis per force along it, m/N.

    Args:
        model: fitted.
        q: (n, n_joints) rad or m.
        axis: (3,) unit vector in the frame of the robot description's last link.
        force: size, N; a model without linear springs depends on it.
    """
    arm: Robot = model.fitted.robot_
    along = arm.forward(q).rotation @ (arm.flange[:3, :3] @ np.asarray(axis))
    wrench = np.hstack([force * along, np.zeros((len(q), 3))])
    deflection = optional(model.fitted, "predict_at_tcp")(q, wrench)
    return np.asarray(np.einsum("ni,ni->n", deflection, along) / force)


def rank_postures(
    model: Model,
    *,
    point: Sequence[float] | None = None,
    path: Path | str | None = None,
    load: Sequence[float] | None = None,
    frame: LoadFrame = "base",
    tool: Sequence[float] | None = None,
    tool_axis: Sequence[float] = (0.0, 0.0, 1.0),
    direction: Direction = "along",
    given: Sequence[float] | None = None,
    turns: int = TURNS,
    turn: Literal["one", "smooth"] = "one",
    turn_step: float | None = None,
    place: Sequence[float] | None = None,
    workpiece: Sequence[float] | None = None,
    hold: Mapping[str, float | None] | None = None,
    coverage: float | None = None,
    sheet: str | None = None,
    output: Path | str | None = None,
    figure: Path | str | None = None,
) -> RankedPostures:
    """Rank the postures of an arm at a point, or along a path, by the predicted deflection.

    The turn of the tool about its axis and the branch of the arm (shoulder, elbow, wrist) are free.
    Postures beyond joint limits or near singularities are left out; collisions are not checked.

    Args:
        model: fitted, of an arm with six revolute joints, or whose other joints are held.
        point: x, y, z [mm], a, b, c [deg] of the tool; None with `given` or `path`.
        path: file of the points, see "Correct a tool path" in the docs.
        load: (6,) process load, N and N m; a path may have its own.
        frame: "base" or "tool", in which loads are expressed; a load in the tool frame turns with
            the tool.
        tool: x, y, z [mm], a, b, c [deg] of the tool in the frame of the robot description's last
            link; None: the model's TCP with the orientation of that link.
        tool_axis: (3,) axis that the tool may turn about, in the tool frame.
        direction: "along" or "across": the part of the deflection to rank by.
        given: (n_joints,) posture to compare with, at the (first) point, deg or mm; None: the
            point's own orientation, in the configuration nearest to the training poses.
        turns: number of turns, evenly spaced over 360 deg, counted from the given posture.
        turn: along a path: "one" for all points, or a "smooth" one that changes along it.
        turn_step: largest change of a smooth turn between two points, deg; None: one turn's step.
        place: x0, x1, y0, y1, z0, z1 [mm] of a box, base frame: the workpiece may be moved so that
            its (first) point lies inside.
        workpiece: x, y, z [mm], a, b, c [deg] of the frame of the point or path in the base frame.
        hold: as of `compensate_path`.
        coverage: of the deflections' intervals (0..1), which give the uncertainty; None: none.
        sheet: of an Excel file of a path.
        output: a new file: all postures at a point, or the best one along the path.
        figure: a new picture.

    Raises:
        NotFittedError: the model is not fitted.
        ConfigError: an option is wrong, or the load is missing.
        DataError: the path cannot be read, or no posture reaches the points.
        StoreError: a file cannot be written, or exists.
    """
    for kind, word, valid in (
        ("frame", frame, ("base", "tool")),
        ("direction", direction, ("along", "across")),
        ("turn", turn, ("one", "smooth")),
    ):
        if word not in valid:
            raise unknown_name(kind, word, valid)
    model.check_fitted()
    for file in (output, figure):
        if file is not None:
            check_new_file(Path(file))
    if figure is not None:
        check_suffix(Path(figure))
    model.check_coverage(coverage)
    arm: Robot = model.fitted.robot_
    start = _given_posture(arm, given)
    if path is None:
        task = _point_task(arm, point, start, load, frame, tool, workpiece, hold or {})
        if turn == "smooth":
            raise ConfigError("smooth requires a path (valid: one)", "turn")
    elif point is not None:
        raise ConfigError("and path: give only one of them", "point")
    else:
        table = read_path(
            Path(path),
            arm,
            tool_of(arm, tool),
            sheet_name=sheet,
            load=load,
            load_frame=frame,
            frame=workpiece,
        )
        for oddity in table.oddities:
            say(f"warning: {oddity}")
        if table.q is not None and start is None:
            start = table.q[0]
        held = held_positions(arm, hold or {}, start)
        task = _Task(str(path), table.path, held, table.tool, frame, table.lines.tolist())
    if not task.path.wrench.any():
        raise ConfigError("is zero, so there is nothing to rank (valid: a load above 0)", "load")
    search = _Search(
        model, arm, task, _unit(tool_axis), direction, coverage, start, _checked_turns(turns)
    )
    with display(), blamed_on(model.file, but=StiffBenchError):
        ranked = search.ranked(
            _change(turn, turn_step, turns), _shifts(place, task.path.position[0])
        )
    if output is not None:
        one_point = len(task.path) == 1
        write_table(Path(output), [ranked.table if one_point else search.course_table(ranked)])
    if figure is not None:
        ranked.plot().save(Path(figure))
    return ranked


@dataclass(frozen=True, eq=False)
class _Task:
    """Points with their loads.

    Attributes:
        name: for messages.
        path: poses of the last joint's frame and loads, base frame.
        held: see `free_joints`.
        tool: (4, 4) in the last joint's frame.
        frame: in which the loads stay the same while the tool turns.
        lines: (n,) numbers of the rows of a file; None of a point.
    """

    name: str
    path: ToolPath
    held: FloatArray
    tool: FloatArray
    frame: LoadFrame
    lines: Sequence[int] | None

    def place_of(self, number: int) -> str:
        """Return a point's name for messages."""
        if self.lines is not None:
            return f"{self.name}: row {self.lines[number]}"
        return self.name


def _point_task(
    robot: Robot,
    point: Sequence[float] | None,
    start: FloatArray | None,
    load: Sequence[float] | None,
    frame: LoadFrame,
    tool: Sequence[float] | None,
    workpiece: Sequence[float] | None,
    hold: Mapping[str, float | None],
) -> _Task:
    """Return the task at one point, which may be that of the given posture."""
    tool_frame = tool_of(robot, tool)
    if load is None:
        raise ConfigError("is missing (valid: fx,fy,fz,tx,ty,tz in N and N m)", "load")
    wrench = frozen_array(load, "load", (6,))
    if point is not None:
        pose = (np.eye(4) if workpiece is None else frame_matrix(workpiece)) @ frame_matrix(point)
        position, rotation = pose[:3, 3], pose[:3, :3] @ tool_frame[:3, :3].T
    elif start is not None:
        poses = robot.forward(start[None])
        position, rotation = poses.points[0, -1], poses.rotation[0]
    else:
        raise ConfigError(
            "is missing (valid: x,y,z,a,b,c in mm and deg, or --given, or --path)", "point"
        )
    if frame == "tool":
        wrench = (wrench.reshape(2, 3) @ (rotation @ tool_frame[:3, :3]).T).ravel()
    place = ",".join(f"{length:.6g}" for length in MM_PER_M * position)
    path = ToolPath("point", position[None], rotation[None], wrench[None])
    held = held_positions(robot, hold, start)
    return _Task(f"point {place} mm", path, held, tool_frame, frame, None)


@dataclass(frozen=True, eq=False)
class _Search:
    """One ranking; attributes as of `rank_postures`."""

    model: Model
    robot: Robot
    task: _Task
    axis_in_tool: FloatArray
    direction: Direction
    coverage: float | None
    start: FloatArray | None
    turns: int

    @property
    def near(self) -> FloatArray:
        """(n_joints,) middle of the training poses: whole turns of joints are next to it."""
        known = self.model.training_range
        return 0.5 * (known.lower + known.upper)

    @property
    def axis(self) -> FloatArray:
        """(3,) axis of the tool in the last joint's frame."""
        return np.asarray(self.task.tool[:3, :3] @ self.axis_in_tool)

    def ranked(self, max_change: int, shifts: FloatArray) -> RankedPostures:
        """Return all postures in their order."""
        rotation, given_q, words = self._given()
        angles = 2.0 * np.pi * np.arange(self.turns) / self.turns
        rotations = turned(rotation, self.axis, angles)
        n, wrench = len(rotations), self._wrench(rotations)
        axis = rotations @ self.axis
        courses: list[tuple[Course, FloatArray]] = []
        n_compared, reasons = 0, []
        for shift in shifts:
            position = self.task.path.position + shift
            found = all_postures(
                self.robot, position, rotations, near=self.near, held=self.task.held
            )
            if self.start is not None and n == 1 and not shift.any():
                self._put_given(found.q)
            rows = np.nonzero(~np.isnan(found.q[..., 0]))
            size = np.full(found.q.shape[:3], np.inf)
            if len(rows[0]):
                bent = self._predicted(found.q[rows], wrench[rows[:2]])
                size[rows] = _size(bent, axis[rows[:2]], self.direction)
            n_compared += len(rows[0])
            best = best_courses(self.robot, found.q, size, self.near, max_change)
            courses += [(course, shift) for course in best]
            if not best:
                reasons.append(self._reason(found.n_reached, found.n_inside, size, max_change))
        if not courses:
            raise DataError(reasons[0])
        courses.sort(key=lambda pair: self._order(pair[0]))
        given = None
        if given_q is not None:
            number = int(branch_numbers(self.robot, given_q, self.task.held)[0])
            still = Course(number, np.zeros(n, dtype=np.int64), given_q, 0.0)
            given = self._posture(still, np.zeros(3), rotations)
        steps = np.linalg.norm(np.diff(self.task.path.position, axis=0), axis=1)
        robot_words = f"{self.model.name}, robot {self.robot.name}; {self.task.name}"
        return RankedPostures(
            robot_words,
            self.direction,
            self._table(courses, rotations, given),
            self._posture(*courses[0], rotations),
            given,
            words,
            self.coverage,
            n_compared,
            np.r_[0.0, np.cumsum(steps)],
        )

    def _put_given(self, q: FloatArray) -> None:
        """Put the given posture, with its own whole turns of joints, in its place at turn 0."""
        if self.start is not None:
            number = branch_numbers(self.robot, self.start[None], self.task.held)[0]
            if not np.isnan(q[0, 0, number, 0]):
                q[0, 0, number] = self.start

    def _order(self, course: Course) -> tuple[float, float]:
        """Return what courses are sorted by: of equal costs the joints nearest to `near` win."""
        return round(course.cost, SAME_COST), float(np.abs(course.q - self.near).mean())

    def _given(self) -> tuple[FloatArray, FloatArray | None, str]:
        """Return (n, 3, 3) orientations at turn 0, the given joint positions, and their origin."""
        path, robot = self.task.path, self.robot
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
            near=self.near if start is None else start,
            held=self.task.held,
        )
        if driven.ok.all():
            return rotation, driven.q, words
        row = int(np.argmin(driven.ok))
        reason = "is singular" if driven.singular[row] else "changes the configuration"
        if not driven.reached[row]:
            reason = "is out of reach"
        elif driven.beyond[row].any():
            reason = "is beyond the joint limits"
        return rotation, None, f"none: {self.task.place_of(row)} {reason} without a turn"

    def _checked_start(self, start: FloatArray) -> float:
        """Return the turn [rad] of the given posture from the point's own orientation.

        Raises:
            ConfigError: it has the tool at another point or in another direction.
        """
        from scipy.spatial.transform import Rotation

        poses = self.robot.forward(start[None])
        away = MM_PER_M * np.linalg.norm(poses.points[0, -1] - self.task.path.position[0])
        own, wanted = poses.rotation[0], self.task.path.rotation[0]
        cosine = np.clip((own @ self.axis) @ (wanted @ self.axis), -1.0, 1.0)
        tilt = np.degrees(np.arccos(cosine))
        if away > SAME_PLACE_MM or tilt > SAME_AXIS_DEG:
            raise ConfigError(
                f"has the tool {away:.4g} mm from the point and its axis {tilt:.3g} deg from the "
                f"point's (valid: within {SAME_PLACE_MM:g} mm and {SAME_AXIS_DEG:g} deg)",
                "given",
            )
        between = Rotation.from_matrix(wanted.T @ own).as_rotvec()
        return float(between @ self.axis)

    def _wrench(self, rotations: FloatArray) -> FloatArray:
        """Return (n, m, 6) loads at each turn, base frame."""
        n, m = rotations.shape[:2]
        wrench = np.repeat(self.task.path.wrench[:, None], m, axis=1)
        if self.task.frame == "base":
            return wrench
        own = self.task.path.rotation  # for which the path has its loads
        change = rotations @ own.swapaxes(1, 2)[:, None]
        parts = wrench.reshape(n, m, 2, 3)
        return np.asarray(np.einsum("nmij,nmkj->nmki", change, parts).reshape(n, m, 6))

    def _predicted(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        predicted = optional(self.model.fitted, "predict_at_tcp")(q, wrench)
        return frozen_array(predicted, "the prediction", (len(q), 3))

    def _posture(self, course: Course, shift: FloatArray, rotations: FloatArray) -> RatedPosture:
        """Return a course with its predictions."""
        model, q, rows = self.model, course.q, np.arange(len(course.q))
        wrench = self._wrench(rotations)[rows, course.turn]
        axis = rotations[rows, course.turn] @ self.axis
        bent, half = self._predicted(q, wrench), None
        if self.coverage is not None:
            interval = model.predict_interval(q, wrench, self.coverage)
            interval = interval_at_tcp(model.fitted, interval, q, wrench)
            part = _part(bent, axis, self.direction)
            length = np.linalg.norm(part, axis=1, keepdims=True)
            unit = axis if self.direction == "along" else part / np.maximum(length, 1e-12)
            half = np.linalg.norm(0.5 * (interval.upper - interval.lower) * unit, axis=1)
        return RatedPosture(
            _signed_degrees(course.turn, self.turns),
            BRANCHES[course.branch],
            shift,
            q,
            wrench,
            bent,
            _size(bent, axis, self.direction),
            half,
            tuple(model.training_range.extrapolates(q, wrench)),
        )

    def _table(
        self,
        courses: Sequence[tuple[Course, FloatArray]],
        rotations: FloatArray,
        given: RatedPosture | None,
    ) -> pd.DataFrame:
        """Return a row for each course, in their order."""
        n, units = len(rotations), file_units(self.robot)
        turn = np.array([course.turn for course, _ in courses])  # (k, n)
        q = np.array([course.q for course, _ in courses])  # (k, n, n_joints)
        shift = np.array([shift for _, shift in courses])
        points = np.arange(n)
        wrench = self._wrench(rotations)[points, turn].reshape(-1, 6)
        axis = (rotations @ self.axis)[points, turn].reshape(-1, 3)
        every_q = q.reshape(-1, q.shape[-1])
        bent = self._predicted(every_q, wrench)
        sizes = {
            f"{word}_mm": MM_PER_M * _size(bent, axis, word).reshape(-1, n).mean(axis=1)
            for word in ("along", "across")
        }
        words = self.model.training_range.extrapolates(every_q, wrench)
        beyond = [words[row * n : (row + 1) * n] for row in range(len(courses))]
        columns: dict[str, object] = {"rank": np.arange(1, len(courses) + 1)}
        first = _signed_degrees(turn, self.turns)
        columns["turn_deg"] = first[:, 0]
        if (turn != turn[:, :1]).any():
            columns |= {"turn_deg": first.min(axis=1), "turn_to_deg": first.max(axis=1)}
        columns["branch"] = [BRANCHES[course.branch] for course, _ in courses]
        if shift.any():
            place = MM_PER_M * (self.task.path.position[0] + shift)
            columns |= dict(zip(("x_mm", "y_mm", "z_mm"), place.T.round(6), strict=True))
        columns |= {name: lengths.round(8) for name, lengths in sizes.items()}
        columns["extrapolates"] = [" ".join(sorted({*" ".join(row).split()})) for row in beyond]
        if n == 1:
            joints = (q[:, 0] * units).round(8) + 0.0
            columns |= dict(zip(joint_columns(self.robot), joints.T, strict=True))
            lengths = (MM_PER_M * bent).round(8) + 0.0
            columns |= dict(zip(DEFLECTION_COLUMNS, lengths.T, strict=True))
        if given is not None:
            branch = np.array(columns["branch"]) == given.branch
            columns["given"] = branch & (turn == 0).all(axis=1) & ~shift.any(axis=1)
        return pd.DataFrame(columns)

    def course_table(self, ranked: RankedPostures) -> pd.DataFrame:
        """Return the best posture along a path, a row per point, which `read_path` reads."""
        best, robot = ranked.best, self.robot
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

    def _reason(
        self, n_reached: IntArray, n_inside: IntArray, size: FloatArray, max_change: int
    ) -> str:
        """Say why no posture serves all points, in one line."""
        there = np.isfinite(size).reshape(len(size), -1).any(axis=1)
        if there.all():
            words = "one turn and branch serves all points (try a smooth turn)"
            if max_change:
                words = "smooth turn in one branch serves all points (try a larger turn-step)"
            return f"{self.task.name}: {self.robot.name}: no {words}"
        number = int(np.argmin(there))
        place, arm = self.task.place_of(number), self.robot.name
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


def _given_posture(robot: Robot, given: Sequence[float] | None) -> FloatArray | None:
    """Return the (n_joints,) given posture, rad or m, checked against the joints' limits."""
    if given is None:
        return None
    if len(given) != robot.n_joints:
        raise ConfigError(
            f"{len(given)} joint positions (valid: the {robot.n_joints} of {robot.name})", "given"
        )
    q, units = np.asarray(given, dtype=np.float64) / file_units(robot), file_units(robot)
    beyond = (q < robot.lower - LIMIT_SLACK) | (q > robot.upper + LIMIT_SLACK)
    if beyond.any() or not np.isfinite(q).all():
        joint = int(np.argmax(beyond | ~np.isfinite(q)))
        low, high = robot.lower[joint] * units[joint], robot.upper[joint] * units[joint]
        raise ConfigError(
            f"joint {robot.joint_names[joint]} at {given[joint]:g} (valid: {low:g}..{high:g}, its "
            "limits)",
            "given",
        )
    return q


def _unit(axis: Sequence[float]) -> FloatArray:
    vector = frozen_array(axis, "tool_axis", (3,))
    length = np.linalg.norm(vector)
    if length < 1e-9:
        raise ConfigError("0,0,0 has no direction (valid: x,y,z of an axis)", "tool-axis")
    return np.asarray(vector / length)


def _checked_turns(turns: int) -> int:
    if turns < 1:
        raise ConfigError(f"{turns} (valid: at least 1)", "turns")
    return turns


def _change(turn: str, turn_step: float | None, turns: int) -> int:
    """Return the largest change between two points, in steps of the turn."""
    step = FULL_TURN_DEG / turns
    if turn == "one":
        if turn_step is not None:
            raise ConfigError(f"{turn_step:g} requires --turn smooth", "turn-step")
        return 0
    if turn_step is None:
        return 1
    if not step <= turn_step <= FULL_TURN_DEG / 2.0:
        raise ConfigError(
            f"{turn_step:g} (valid: {step:g}..180 deg with {turns} turns)", "turn-step"
        )
    return int(turn_step / step + 1e-9)


def _shifts(place: Sequence[float] | None, first: FloatArray) -> FloatArray:
    """Return (k, 3) shifts of the workpiece, m, base frame."""
    if place is None:
        return np.zeros((1, 3))
    box = frozen_array(place, "place", (6,)).reshape(3, 2) / MM_PER_M
    for name, (low, high) in zip("xyz", MM_PER_M * box, strict=True):
        if low > high:
            raise ConfigError(f"{name}0 {low:g} is above {name}1 {high:g}", "place")
    edges = [np.unique(np.linspace(low, high, SHIFTS_PER_AXIS)) for low, high in box]
    places = np.array(list(product(*edges)))
    if ((box[:, 0] <= first) & (first <= box[:, 1])).all():
        places = np.unique(np.concatenate([first[None], places]).round(9), axis=0)
    shifts = places - first
    shifts[np.abs(shifts).max(axis=1) < 1e-8] = 0.0
    return np.asarray(shifts)
