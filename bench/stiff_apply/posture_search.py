"""Search for the best posture: predict and rank all turns and branches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stiff_apply.path_file import LoadFrame
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
from stiff_apply.ranked_postures import RankedPostures
from stiff_bench.api.model import Model
from stiff_datasets.measured.sample_columns import (
    DEFLECTION_COLUMNS,
    MM_PER_M,
    WRENCH_COLUMNS,
    file_units,
    joint_columns,
)
from stiff_protocols.contract.errors import ConfigError, DataError
from stiff_protocols.contract.robot import Robot
from stiff_protocols.contract.stiffness_model import interval_at_tcp
from stiff_protocols.contract.types import FloatArray, IntArray
from stiff_protocols.paths.inverse import SINGULAR, follow
from stiff_protocols.paths.path import ToolPath

SAME_PLACE_MM, SAME_AXIS_DEG = 1.0, 0.5
"""Largest distance between the tool in the given posture and the point."""
FULL_TURN_DEG = 360.0
SAME_COST = 9
"""Decimals of compared deflections [m]: wrist branches have equal deflections."""


@dataclass(frozen=True, eq=False)
class PostureTask:
    """Points with their loads.

    Attributes:
        name: name for messages.
        path: poses of the last joint's frame and loads, base frame.
        held: positions of held joints, see `free_joints`.
        tool: (4, 4) tool frame in the last joint's frame.
        frame: frame in which the loads are constant while the tool turns.
        lines: (n,) line numbers of a file; None for a point.
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


@dataclass(frozen=True, eq=False)
class PostureSearch:
    """One ranking; see `rank_postures` for the attributes."""

    model: Model
    robot: Robot
    task: PostureTask
    axis_in_tool: FloatArray
    direction: Direction
    coverage: float | None
    start: FloatArray | None
    turns: int

    @property
    def near(self) -> FloatArray:
        """Return the (n_joints,) middle of the training poses, the reference for whole turns."""
        trained = self.model.training_range
        return 0.5 * (trained.lower + trained.upper)

    @property
    def axis(self) -> FloatArray:
        """Return the (3,) axis of the tool in the last joint's frame."""
        return np.asarray(self.task.tool[:3, :3] @ self.axis_in_tool)

    def ranked(self) -> RankedPostures:
        """Return all postures in their order."""
        rotation, given_q, words = self._given()
        angles = 2.0 * np.pi * np.arange(self.turns) / self.turns
        rotations = turned(rotation, self.axis, angles)
        n, wrench = len(rotations), self._wrench(rotations)
        axis = rotations @ self.axis
        postures = all_postures(
            self.robot, self.task.path.position, rotations, near=self.near, held=self.task.held
        )
        if self.start is not None and n == 1:
            self._put_given(postures.q)
        rows = np.nonzero(~np.isnan(postures.q[..., 0]))
        size = np.full(postures.q.shape[:3], np.inf)
        if len(rows[0]):
            bent = self.model.predict_at_tcp(postures.q[rows], wrench[rows[:2]])
            size[rows] = _size(bent, axis[rows[:2]], self.direction)
        courses = sorted(best_courses(self.robot, postures.q, size, self.near), key=self._order)
        if not courses:
            raise DataError(self._reason(postures.n_reached, postures.n_inside, size))
        given = None
        if given_q is not None:
            number = int(branch_numbers(self.robot, given_q, self.task.held)[0])
            given = self._posture(Course(number, 0, given_q, 0.0), rotations)
        stored = getattr(self.model.fitted, "cross_validated_error_", None)
        robot_words = f"{self.model.name}, robot {self.robot.name}; {self.task.name}"
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
            number = branch_numbers(self.robot, self.start[None], self.task.held)[0]
            if not np.isnan(q[0, 0, number, 0]):
                q[0, 0, number] = self.start

    def _order(self, course: Course) -> tuple[float, float]:
        """Return the sort key of courses: cost, then distance of the joints from `near`."""
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
        start_rotation, point_rotation = poses.rotation[0], self.task.path.rotation[0]
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
        wrench = np.repeat(self.task.path.wrench[:, None], m, axis=1)
        if self.task.frame == "base":
            return wrench
        loaded_rotation = self.task.path.rotation  # for which the path has its loads
        change = rotations @ loaded_rotation.swapaxes(1, 2)[:, None]
        parts = wrench.reshape(n, m, 2, 3)
        return np.asarray(np.einsum("nmij,nmkj->nmki", change, parts).reshape(n, m, 6))

    def _posture(self, course: Course, rotations: FloatArray) -> RatedPosture:
        """Return a course with its predictions."""
        model, q = self.model, course.q
        wrench = self._wrench(rotations)[:, course.turn]
        axis = rotations[:, course.turn] @ self.axis
        bent, half = self.model.predict_at_tcp(q, wrench), None
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
        n, units = len(rotations), file_units(self.robot)
        turn = np.array([course.turn for course in courses])
        q = np.array([course.q for course in courses])  # (k, n, n_joints)
        wrench = self._wrench(rotations)[:, turn].swapaxes(0, 1).reshape(-1, 6)
        axis = (rotations @ self.axis)[:, turn].swapaxes(0, 1).reshape(-1, 3)
        every_q = q.reshape(-1, q.shape[-1])
        bent = self.model.predict_at_tcp(every_q, wrench)
        sizes = {
            f"{word}_mm": MM_PER_M * _size(bent, axis, word).reshape(-1, n).mean(axis=1)
            for word in ("along", "across")
        }
        words = self.model.training_range.extrapolates(every_q, wrench)
        beyond = [words[row * n : (row + 1) * n] for row in range(len(courses))]
        columns: dict[str, object] = {"rank": np.arange(1, len(courses) + 1)}
        columns["turn_deg"] = _signed_degrees(turn, self.turns)
        columns["branch"] = [BRANCHES[course.branch] for course in courses]
        columns |= {name: lengths.round(8) for name, lengths in sizes.items()}
        columns["extrapolates"] = [" ".join(sorted({*" ".join(row).split()})) for row in beyond]
        if n == 1:
            joints = (q[:, 0] * units).round(8) + 0.0
            columns |= dict(zip(joint_columns(self.robot), joints.T, strict=True))
            lengths = (MM_PER_M * bent).round(8) + 0.0
            columns |= dict(zip(DEFLECTION_COLUMNS, lengths.T, strict=True))
        if given is not None:
            branch = np.array(columns["branch"]) == given.branch
            columns["given"] = branch & (turn == 0)
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

    def _reason(self, n_reached: IntArray, n_inside: IntArray, size: FloatArray) -> str:
        """Return the reason why no posture reaches all points, in one line."""
        there = np.isfinite(size).reshape(len(size), -1).any(axis=1)
        if there.all():
            return f"{self.task.name}: {self.robot.name}: no turn and branch serves all points"
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
